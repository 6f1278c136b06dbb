"""``camrig resume``: heads may move."""

from __future__ import annotations

from typing import Annotated

import typer

from camrig.cli.console import people, results
from camrig.cli.operating import RigOption, SocketOption, names, order, part


def resume(
    heads: Annotated[list[str] | None, typer.Argument(metavar="[HEAD]...", help="Which heads; none = all.")] = None,
    rig: RigOption = None,
    socket: SocketOption = None,
) -> None:
    """Let the heads of a running rig move: after `hold`, or where the file does not say `enable: auto`."""
    answer = order(rig, socket, "resume", heads=heads or [])
    results.print(f"may move: {names(answer, 'heads')}", markup=False, highlight=False)
    for name, reason in part(answer, "unreached").items():
        people.print(f"{name}: {reason}; it may move once it is up again", markup=False, highlight=False)
