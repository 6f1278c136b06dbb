"""What every command shares: JSON lines on standard output, everything for people on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

people = Console(stderr=True)
"""Tables, progress and messages go here; standard output is for results."""

results = Console()
"""Human-readable results, where no ``--json`` was asked for."""


COLOURS: Mapping[str, str] = {"green": "green", "amber": "yellow", "red": "red"}
"""In which a verdict (messages.Verdict) is printed."""


def print_json(answer: Mapping[str, object]) -> None:
    """Write one JSON object on a line of standard output; NaN and infinity become null."""
    sys.stdout.write(json.dumps(finite(answer), ensure_ascii=False, allow_nan=False) + "\n")
    sys.stdout.flush()


def note(text: str) -> None:
    """Tell people something beside the answer, in its own words: brackets are no markup."""
    people.print(f"[yellow]note:[/yellow] {escape(text)}", soft_wrap=True, highlight=False)


@contextmanager
def progress_bar(description: str, total: float, *, hidden: bool = False) -> Iterator[Progress]:
    """Show a progress bar on standard error while inside; its task is ``progress.task_ids[0]``."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=people, transient=True, disable=hidden or not people.is_terminal) as progress:
        progress.add_task(description, total=total)
        yield progress


def finite(value: object) -> object:
    """Return what JSON can say of a value: NaN and infinity become null, tuples lists."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
