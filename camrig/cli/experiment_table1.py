"""``camrig experiment table1``: the paper's first table, through pictures."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.choice import choices
from camrig.cli.console import note, people
from camrig.cli.experiment_common import Out, Processes, folder_of, hand_out, results_of, sizes_of, tell_left_out
from camrig.cli.kernels import load_daemons_kernels, load_kernels
from camrig.config.models import PlannerModel
from camrig.errors import InputError
from camrig.experiments import machine
from camrig.experiments.configurations import CONFIGURATIONS, of_quality, running_settings
from camrig.experiments.kept import Kept
from camrig.experiments.photographs import detector, painter
from camrig.experiments.table1 import CONDITIONS, MODES, SIZES, Setup, Trial, jobs, unable, work
from camrig.experiments.table1_report import Report, as_json, as_markdown

_ALL_SIZES = ",".join(f"{cameras}x{targets}" for cameras, targets in SIZES)
_OWN = of_quality(PlannerModel().quality)


def table1(
    sizes: Annotated[str, typer.Option(help="Cameras x targets, several with commas.")] = _ALL_SIZES,
    modes: Annotated[str, typer.Option(help="ptz, drone or both.")] = ",".join(MODES),
    runs: Annotated[int, typer.Option(min=1, help="Random rooms of every mode and size.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first room; the next one's is one more.")] = 0,
    conditions: Annotated[
        str, typer.Option(help="What is wrong with cameras: exact, off, anchored (off, with four anchors).")
    ] = ",".join(CONDITIONS),
    configurations: Annotated[
        str | None, typer.Option(help=f"Some of {','.join(CONFIGURATIONS)}; all where not given.")
    ] = None,
    quick: Annotated[
        bool, typer.Option(help="One room of three cameras and bodies a mode: does it work at all?")
    ] = False,
    processes: Processes = 0,
    out: Out = None,
    figures: Annotated[bool, typer.Option(help="Draw figures into the folder as well, as PNG and SVG.")] = True,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object, with every room.")] = False,
) -> None:
    """Make the paper's first table again: random rooms, pictures, detection, estimates, errors against the truth."""
    asked = Setup(
        sizes=sizes_of(sizes),
        modes=choices("--modes", modes, MODES),
        runs=runs,
        seed=seed,
        conditions=choices("--conditions", conditions, CONDITIONS),
        configurations=CONFIGURATIONS
        if configurations is None
        else choices("--configurations", configurations, CONFIGURATIONS),
    )
    if quick:
        asked = replace(asked, sizes=SIZES[:1], runs=1)
    report = _report(asked, folder_of(out), processes, hidden=as_json_object)
    if out is not None and figures:
        _draw(report, out)
    hand_out("table1", out, as_markdown(report), as_json(report), as_json=as_json_object)
    tell_left_out(report.left_out.values(), by_name=configurations is not None)


def _draw(report: Report, folder: Path) -> None:
    try:
        from camrig.cli.experiment_table1_figures import draw  # noqa: PLC0415 - matplotlib is an extra
    except ImportError:
        note("no figures without matplotlib; install camrig[pictures]")
        return
    with people.status("drawing figures"):
        draw(report, folder)


def _report(asked: Setup, folder: Path | None, processes: int, *, hidden: bool) -> Report:
    painter()  # what is not installed is said before anything is done
    detector()
    load_kernels(running_settings(PlannerModel().quality))
    load_daemons_kernels()
    left_out = unable(asked)
    setup = replace(asked, configurations=tuple(each for each in asked.configurations if each not in left_out))
    if not setup.configurations:
        raise InputError("\n".join(left_out.values()))
    kept = Kept(None if folder is None else folder / "table1.jsonl", f"table1 of camrig {metadata.version('camrig')}")
    found = results_of("photographing rooms", work, list(jobs(setup)), kept, processes, hidden=hidden)
    trials = [Trial(**trial) for room in found for trial in room]
    return Report(setup, _OWN, _command(asked), machine.machine(), machine.versions(), left_out, trials)


def _command(asked: Setup) -> str:
    """Return the command that makes the same table."""
    options: dict[str, object] = {
        "sizes": ",".join(f"{cameras}x{targets}" for cameras, targets in asked.sizes),
        "modes": ",".join(asked.modes),
        "runs": asked.runs,
        "seed": asked.seed,
        "conditions": ",".join(asked.conditions),
    }
    if asked.configurations != CONFIGURATIONS:
        options["configurations"] = ",".join(asked.configurations)
    words = " ".join(f"--{name} {value}" for name, value in options.items())
    return f"{machine.THREADS}=1 camrig experiment table1 {words}"
