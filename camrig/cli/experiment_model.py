"""``camrig experiment model``: whether predicted quality predicts real error."""

from __future__ import annotations

import itertools
from importlib import metadata
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from camrig.cli.console import note
from camrig.cli.experiment_common import Out, Processes, folder_of, hand_out, results_of
from camrig.experiments import machine
from camrig.experiments.kept import Kept
from camrig.experiments.model import CORNERS, MODES, QUALITIES, Setup, Sighted, jobs, work
from camrig.experiments.model_report import Report, as_json, as_markdown
from camrig.experiments.photographs import detector, painter
from camrig.experiments.scenes import LAB_LENS


def model(
    pictures: Annotated[int, typer.Option(min=2, help="Random pictures of heads, and as many of drones.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of the first picture; the next one's is one more.")] = 0,
    processes: Processes = 0,
    out: Out = None,
    figures: Annotated[bool, typer.Option(help="Draw figures into the folder as well, as PNG and SVG.")] = True,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object, with every tag.")] = False,
) -> None:
    """Compare what each quality model promises of tags with how far off single pictures have them."""
    setup = Setup(pictures, seed)
    folder = folder_of(out)
    painter()  # what is not installed is said before anything is done
    detector()
    kept = Kept(None if folder is None else folder / "model.jsonl", f"model of camrig {metadata.version('camrig')}")
    found = results_of("taking pictures", work, list(jobs(setup)), kept, processes, hidden=as_json_object)
    command = f"{machine.THREADS}=1 camrig experiment model --pictures {pictures} --seed {seed}"
    sightings = [Sighted(**each) for picture in found for each in picture]
    report = Report(setup, command, machine.machine(), machine.versions(), sightings)
    if folder is not None and figures:
        _draw(sightings, folder)
    hand_out("model", folder, as_markdown(report), as_json(report), as_json=as_json_object)


def _draw(sightings: list[Sighted], folder: Path) -> None:
    try:
        from camrig.report.model_figures import floor_maps, promises  # noqa: PLC0415 - matplotlib is an extra
    except ImportError:
        note("no figures without matplotlib; install camrig[pictures]")
        return
    panels = {}
    for mode, corners, quality in itertools.product(MODES, CORNERS, QUALITIES):
        pairs = [
            (each.promised_m[corners][quality], float(np.linalg.norm(each.error_m[corners])))
            for each in sightings
            if each.mode == mode
        ]
        if pairs:
            panels[f"{mode}, {corners} corners, {quality}"] = 1e3 * np.array(pairs)
    promises([folder / f"model-promises.{ending}" for ending in ("png", "svg")], panels)
    floor_maps([folder / f"model-maps.{ending}" for ending in ("png", "svg")], LAB_LENS)
