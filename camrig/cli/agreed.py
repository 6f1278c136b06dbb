"""Nothing that people may stand beside is moved before somebody has agreed to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import typer

from camrig.cli.console import people
from camrig.errors import InputError


def agreed(motions: Iterable[str], heads: Sequence[str], *, yes: bool) -> None:
    """Say what will move, and ask; without a terminal ``--yes`` is needed. Raises InputError, and typer.Abort on no."""
    for motion in motions:
        people.print(motion, highlight=False, markup=False)
    if yes:
        return
    names = ", ".join(heads)
    if not people.is_terminal:
        raise InputError(f"this moves head{'s' if len(heads) > 1 else ''} {names}: say --yes where nobody can be asked")
    typer.confirm("Is nobody in the way, and are cables long enough?", abort=True, err=True)
