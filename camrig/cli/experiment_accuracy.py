"""``camrig experiment accuracy``: what costs accuracy, one thing at a time."""

from __future__ import annotations

from importlib import metadata
from typing import Annotated

import typer

from camrig.cli.experiment_common import Out, Processes, folder_of, hand_out, results_of
from camrig.cli.kernels import load_daemons_kernels, load_kernels
from camrig.experiments import machine
from camrig.experiments.accuracy import Track, jobs, work
from camrig.experiments.accuracy_report import Report, as_json, as_markdown
from camrig.experiments.configurations import running_settings
from camrig.experiments.kept import Kept
from camrig.experiments.photographs import detector, painter


def accuracy(
    rooms: Annotated[int, typer.Option(min=1, help="Random rooms of every case.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Of the first room; the next one's is one more.")] = 0,
    processes: Processes = 0,
    out: Out = None,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object, with every body.")] = False,
) -> None:
    """Measure published positions and their NEES against noise, blur, motion, pointing errors and anchors."""
    folder = folder_of(out)
    painter()  # what is not installed is said before anything is done
    detector()
    load_kernels(running_settings("fisher"))
    load_daemons_kernels()
    made_by = f"accuracy of camrig {metadata.version('camrig')}"
    kept = Kept(None if folder is None else folder / "accuracy.jsonl", made_by)
    found = results_of("running rooms", work, list(jobs(rooms, seed)), kept, processes, hidden=as_json_object)
    tracks = [Track(**track) for room in found for track in room]
    command = f"{machine.THREADS}=1 camrig experiment accuracy --rooms {rooms} --seed {seed}"
    report = Report(rooms, seed, command, machine.machine(), machine.versions(), tracks)
    hand_out("accuracy", folder, as_markdown(report), as_json(report), as_json=as_json_object)
