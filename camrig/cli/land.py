"""``camrig land``: land a drone where it is."""

from __future__ import annotations

from camrig.cli.console import results
from camrig.cli.operating import DroneArgument, RigOption, SocketOption, order_flight, socket_of
from camrig.messages import FlightState


def land(drone: DroneArgument, rig: RigOption = None, socket: SocketOption = None) -> None:
    """Land a drone of a running rig where it is."""
    flight = order_flight(socket_of(rig, socket), "land", drone, {FlightState.LANDING, FlightState.GROUND})
    results.print(f"{drone}: {flight}", markup=False, highlight=False)
