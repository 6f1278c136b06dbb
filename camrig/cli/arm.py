"""``camrig arm``: the operator's order without which no drone flies."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from camrig.cli.console import results
from camrig.cli.operating import DroneArgument, RigOption, SocketOption, check_fit, order_flight, socket_of
from camrig.errors import InputError
from camrig.messages import FlightState


def arm(
    drone: DroneArgument,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask: the room is clear.")] = False,
    rig: RigOption = None,
    socket: SocketOption = None,
) -> None:
    """Check a drone, arm it and let it climb to the lowest height of its box, where it follows plans.

    Where it is not fit, every reason is named with its cure, and nothing is armed. `camrig status` shows them before.
    In the air it is `camrig resume` that lets a drone follow plans again. `camrig takeoff` is the same order.
    """
    path = socket_of(rig, socket)
    check_fit(path, drone)
    if not yes:
        _ask_person(drone)
    flight = order_flight(path, "arm", drone, {FlightState.TAKING_OFF, FlightState.FLYING})
    results.print(f"{drone}: {flight}", markup=False, highlight=False)


def _ask_person(drone: str) -> None:
    if not sys.stdin.isatty():
        raise InputError(f"arming {drone} makes its propellers turn: confirm on a terminal, or say --yes")
    typer.confirm(f"{drone}: propellers will turn and it will climb. Is the room clear?", abort=True, err=True)
