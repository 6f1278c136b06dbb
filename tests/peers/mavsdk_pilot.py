"""Flies one vehicle with MAVSDK, in a process of its own: URL in, one JSON line a step out."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

from mavsdk import ComponentType, Configuration, Mavsdk, System
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import LandedState, Telemetry

TARGET_NED_M = (1.0, 2.0, -2.0)
START_S = time.monotonic()


def tell(step: str, **facts: object) -> None:
    print(json.dumps({"step": step, "s": round(time.monotonic() - START_S, 2), **facts}), flush=True)


def wait(what: str, holds: Callable[[], bool], limit_s: float = 15.0) -> None:
    end_s = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > end_s:
            sys.exit(f"{what}: not within {limit_s} s")
        time.sleep(0.02)


def place(telemetry: Telemetry) -> tuple[float, float, float]:
    at = telemetry.position_velocity_ned().position
    return at.north_m, at.east_m, at.down_m


def fly(system: System) -> None:
    telemetry, action, offboard, param = Telemetry(system), Action(system), Offboard(system), Param(system)
    telemetry.set_rate_position_velocity_ned(20.0)
    telemetry.set_rate_landed_state(5.0)
    telemetry.set_rate_health(2.0)
    wait("health_all_ok", telemetry.health_all_ok)
    tell("healthy")
    names = [parameter.name for parameter in param.get_all_params().int_params]
    tell("parameters", names=names)
    action.set_takeoff_altitude(2.0)
    action.arm()
    wait("armed", telemetry.armed)
    tell("armed")
    action.takeoff()
    wait("in the air", lambda: telemetry.landed_state() == LandedState.IN_AIR)
    wait("2 m up", lambda: place(telemetry)[2] < -1.8)
    tell("up", place_ned_m=place(telemetry))
    offboard.set_position_ned(PositionNedYaw(*TARGET_NED_M, 0.0))
    offboard.start()
    wait("at the target", lambda: max(abs(a - b) for a, b in zip(place(telemetry), TARGET_NED_M, strict=True)) < 0.1)
    time.sleep(0.5)
    tell("there", place_ned_m=place(telemetry), flight_mode=telemetry.flight_mode().name)
    action.land()
    wait("disarmed on the floor", lambda: not telemetry.armed() and not telemetry.in_air())
    tell("landed", place_ned_m=place(telemetry))


def main(url: str) -> None:
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(url)
    system = mavsdk.first_autopilot(10.0)
    if system is None:
        sys.exit("no autopilot within 10 s")
    tell("connected", system=system.get_system_id())
    fly(system)
    mavsdk.destroy()


if __name__ == "__main__":
    main(sys.argv[1])
