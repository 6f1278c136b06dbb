"""What the commands of ``camrig experiment`` share."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import typer

from camrig.cli.console import finite, note, people, print_json, progress_bar
from camrig.cli.signals import interrupting
from camrig.errors import InputError, PartialError
from camrig.experiments.kept import Kept
from camrig.experiments.work import done


class Keyed(Protocol):
    """A job that has a name among kept results."""

    @property
    def key(self) -> str: ...


KeyedT = TypeVar("KeyedT", bound=Keyed)

Out = Annotated[
    Path | None,
    typer.Option(
        help="Write Markdown, JSON and figures into this folder; a run that was interrupted goes on from there."
    ),
]
Processes = Annotated[int, typer.Option("--jobs", min=0, help="Processes at work; 0 is one for every core.")]


def results_of(
    title: str,
    work: Callable[[KeyedT], Any],
    jobs: Sequence[KeyedT],
    kept: Kept,
    processes: int,
    *,
    hidden: bool,
) -> Iterable[Any]:
    """Return the results of all jobs in their order, doing those that are not kept yet, with a progress bar."""
    missing = [job for job in jobs if job.key not in kept]
    if len(missing) < len(jobs):
        people.print(f"{len(jobs) - len(missing)} of {len(jobs)} parts were done before", highlight=False)
    bar = progress_bar(title, len(jobs), hidden=hidden)
    with bar as progress, interrupting(time.perf_counter) as now_s:
        progress.update(progress.task_ids[0], completed=len(jobs) - len(missing))
        for job, result in done(work, missing, processes or len(os.sched_getaffinity(0)), now_s):
            kept.add(job.key, result)
            progress.advance(progress.task_ids[0])
    return [kept[job.key] for job in jobs]


def folder_of(out: Path | None) -> Path | None:
    """Return the folder to write to, made where it was not there. Raises InputError where it cannot be."""
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{out}: --out takes a folder, and this cannot be one: {error.strerror}") from error
    return out


def sizes_of(text: str) -> tuple[tuple[int, int], ...]:
    """Return cameras and targets as ``--sizes`` has them; raises InputError where it makes no sense."""
    found = []
    for size in text.split(","):
        cameras, _, targets = size.strip().partition("x")
        if not (cameras.isdecimal() and targets.isdecimal() and int(cameras) and int(targets)):
            raise InputError(f"--sizes takes cameras x targets with commas between, as in 3x3,5x10, not '{size}'")
        found.append((int(cameras), int(targets)))
    return tuple(dict.fromkeys(found))


def write(path: Path, text: str) -> None:
    """Write a file; raises InputError where it cannot be written."""
    try:
        path.write_text(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def hand_out(name: str, folder: Path | None, markdown: str, answer: Mapping[str, object], *, as_json: bool) -> None:
    """Write what came of an experiment into its folder, where there is one, and print what was asked for: its answer as
    JSON, or, if it is nowhere else, its Markdown. Raises InputError where a file cannot be written.
    """
    if folder is not None:
        write(folder / f"{name}.md", markdown)
        write(folder / f"{name}.json", json.dumps(finite(answer), indent=1) + "\n")
    if as_json:
        print_json(answer)
    elif folder is None:
        typer.echo(markdown, nl=False)


def tell_left_out(reasons: Collection[str], *, by_name: bool) -> None:
    """Raise PartialError where what was asked for by name was left out; else only say so."""
    if not reasons:
        return
    text = "\n".join(reasons)
    if by_name:
        raise PartialError(text)
    note(text)
