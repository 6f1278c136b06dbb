"""What the commands that talk to a running daemon share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, InputError
from camrig.messages import FlightState, Level
from camrig.runtime.operator_client import ask, find_socket

RigOption = Annotated[str | None, typer.Option("--rig", help="The running rig; needed only where several run.")]
SocketOption = Annotated[Path | None, typer.Option("--socket", help="The daemon's socket, instead of --rig.")]
DroneArgument = Annotated[str, typer.Argument(help="The drone's id.")]

FLIGHT_TIMEOUT_S = 10.0
"""How long a drone may take to begin what it was told."""
_FIRST_LOOK_S = 0.5
_LOOK_S = 0.25

Answer = Mapping[str, object]


def socket_of(rig: str | None, socket: Path | None) -> Path:
    """Return the socket that the options mean; raises the errors of ``find_socket``."""
    if rig is not None and socket is not None:
        raise InputError("--rig and --socket name the same thing: give one of them")
    return socket or find_socket(rig)


def order(rig: str | None, socket: Path | None, command: str, **parameters: object) -> Answer:
    """Send one command to the daemon and return its answer; raises the CamrigError that the daemon answered."""
    return ask(socket_of(rig, socket), {"command": command, **parameters})


def check_fit(path: Path, drone: str) -> None:
    """Raise HardwareError with all reasons where a drone that the daemon knows is not fit to be armed or resumed."""
    told = part(part(ask(path, {"command": "status"}), "drones"), drone)
    unfit = told.get("unfit")
    if isinstance(unfit, list) and unfit:
        raise HardwareError(f"{drone} is not fit to fly: {'; '.join(map(str, unfit))}")


def order_flight(path: Path, command: str, drone: str, wanted: Collection[FlightState]) -> str:
    """Send a drone's order and return the flight state in which it begins to obey; raises as ``watch_drone``."""
    began_s = RealClock().now_s()
    ask(path, {"command": command, "drone": drone})
    return str(watch_drone(path, began_s, command, drone, lambda told: told.get("flight") in wanted).get("flight"))


def watch_drone(path: Path, began_s: float, command: str, drone: str, obeys: Callable[[Answer], bool]) -> Answer:
    """Return a drone's status once it obeys a command that was sent at ``began_s``.

    The daemon answers before the drone does, so its status is watched; raises HardwareError with the reason where the
    order is refused or nothing comes of it.
    """
    clock: Clock = RealClock()
    clock.sleep_s(_FIRST_LOOK_S)  # a refusal comes by itself; a drone in the air looks obedient before it
    while True:
        status = ask(path, {"command": "status"})
        said = list(_warnings(status, drone))
        for stamp_s, text in said:
            if stamp_s >= began_s:
                raise HardwareError(f"{drone}: {text}")
        told = part(part(status, "drones"), drone)
        if obeys(told):
            return told
        if clock.now_s() > began_s + FLIGHT_TIMEOUT_S:
            last = f"; the last that was said of it: {said[-1][1]}" if said else ""
            flight = told.get("flight")
            raise HardwareError(f"{drone} does not obey: {flight} {FLIGHT_TIMEOUT_S:g} s after '{command}'{last}")
        clock.sleep_s(_LOOK_S)


def part(answer: Answer, key: str) -> Answer:
    """Return an object within an answer; empty where there is none."""
    found = answer.get(key)
    return found if isinstance(found, dict) else {}


def parts(answer: Answer, key: str) -> list[Answer]:
    """Return a list of objects within an answer."""
    found = answer.get(key)
    return [item for item in found if isinstance(item, dict)] if isinstance(found, list) else []


def names(answer: Answer, key: str) -> str:
    """Return the names in a list of an answer, for a sentence."""
    found = answer.get(key)
    return ", ".join(map(str, found)) if isinstance(found, list) and found else "none"


def _warnings(status: Answer, about: str) -> Iterator[tuple[float, str]]:
    """Yield stamp and text of the warnings about a device, oldest first; the clock is this host's, as ours."""
    now_s = status.get("stamp_s")
    for event in parts(status, "events"):
        age_s = event.get("age_s")
        if event.get("about") == about and event.get("level") == Level.WARNING:
            assert isinstance(now_s, float)
            assert isinstance(age_s, float)
            yield now_s - age_s, str(event.get("text"))
