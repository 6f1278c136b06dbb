"""``camrig scan``: look for the targets on the whole floor again."""

from __future__ import annotations

from camrig.cli.console import results
from camrig.cli.operating import RigOption, SocketOption, order


def scan(rig: RigOption = None, socket: SocketOption = None) -> None:
    """Have a running rig scan the whole floor again."""
    order(rig, socket, "scan")
    results.print("scanning")
