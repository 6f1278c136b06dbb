"""``camrig resume``: heads may move, drones in the air follow plans."""

from __future__ import annotations

from typing import Annotated

import typer

from camrig.cli.console import people, results
from camrig.cli.operating import Answer, RigOption, SocketOption, check_fit, names, part, socket_of, watch_drone
from camrig.clock import RealClock
from camrig.runtime.operator_client import ask


def resume(
    devices: Annotated[
        list[str] | None, typer.Argument(metavar="[DEVICE]...", help="Which heads and drones; none = all heads.")
    ] = None,
    rig: RigOption = None,
    socket: SocketOption = None,
) -> None:
    """Let heads move, after `hold` or where the file does not say `enable: auto`; let drones in the air follow plans.

    A drone needs it after `hold`, after a fault, after somebody else flew it, and when the daemon was started anew
    while it flew. It must be named: it moves from where it hovers to where the plan wants it.
    """
    path = socket_of(rig, socket)
    flying = part(ask(path, {"command": "status"}), "drones")
    drones = [name for name in devices or [] if name in flying]
    heads = [name for name in devices or [] if name not in flying]
    for drone in drones:
        check_fit(path, drone)
    began_s = RealClock().now_s()
    answer = ask(path, {"command": "resume", "heads": heads, "drones": drones})
    if heads or not drones:
        results.print(f"may move: {names(answer, 'heads')}", markup=False, highlight=False)
    for name, reason in part(answer, "unreached").items():
        people.print(f"{name}: {reason}; it may move once it is up again", markup=False, highlight=False)
    for drone in drones:
        watch_drone(path, began_s, "resume", drone, _follows)
        results.print(f"{drone}: follows plans", markup=False, highlight=False)


def _follows(told: Answer) -> bool:
    """Whether a drone follows plans; one whose driver does not say more is believed to."""
    return told.get("control") == "planner" and told.get("activity", "flying") == "flying"
