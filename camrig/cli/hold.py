"""``camrig hold``: every head stops, every drone holds, until an operator says otherwise."""

from __future__ import annotations

from camrig.cli.console import results
from camrig.cli.operating import RigOption, SocketOption, names, order


def hold(rig: RigOption = None, socket: SocketOption = None) -> None:
    """Stop every head and hold every drone of a running rig; they stay so until `resume`."""
    answer = order(rig, socket, "hold")
    text = f"heads stopped: {names(answer, 'heads')}; drones told to hold: {names(answer, 'drones')}"
    results.print(text, markup=False, highlight=False)
    if answer.get("lent"):
        text = f"taken back from the program that has it, which stops it within two seconds: {names(answer, 'lent')}"
        results.print(text, markup=False, highlight=False)
