"""MAVSDK's server side as a vehicle, in a process of its own: URL in, one JSON line for every order it takes.

Its plugins speak: modes, arming, acknowledgements, parameters, telemetry. They have no physics and no set-points, so a
point that flies to the last set-point stands for the aircraft.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import dataclass, field

from mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action_server import ActionServer, AllowableFlightModes, ArmDisarm, FlightMode
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkMessage
from mavsdk.plugins.param_server import ParamServer
from mavsdk.plugins.telemetry_server import (
    AngularVelocityBody,
    Battery,
    EulerAngle,
    LandedState,
    PositionNed,
    PositionVelocityNed,
    TelemetryServer,
    VelocityNed,
    VtolState,
)

PERIOD_S = 0.04
SPEED_M_S = 1.0
NAV_LAND = 21


def tell(order: str, **facts: object) -> None:
    print(json.dumps({"order": order, **facts}), flush=True)


@dataclass
class Point:
    """What flies: NED, metres."""

    place_m: list[float] = field(default_factory=lambda: [1.0, 2.0, 0.0])
    target_m: list[float] | None = None
    yaw_deg: float = 0.0
    armed: bool = False
    mode: FlightMode = FlightMode.HOLD
    set_points: int = 0

    def fly(self) -> None:
        goal_m = self.target_m if self.mode == FlightMode.OFFBOARD else None
        if self.mode == FlightMode.LAND:
            goal_m = [*self.place_m[:2], 0.0]
        if self.armed and goal_m is not None:
            gap_m = sum((b - a) ** 2 for a, b in zip(self.place_m, goal_m, strict=True)) ** 0.5
            share = min(1.0, SPEED_M_S * PERIOD_S / max(gap_m, 1e-9))
            self.place_m = [a + share * (b - a) for a, b in zip(self.place_m, goal_m, strict=True)]

    @property
    def aloft(self) -> bool:
        return self.place_m[2] < -0.05


class Vehicle:
    """The plugins of one server component around a ``Point``."""

    def __init__(self, mavsdk: Mavsdk) -> None:
        component = mavsdk.server_component()
        self._booted_s = time.monotonic()
        self.point = Point()
        self.parameters = ParamServer(component)
        self.parameters.provide_param_int("COM_OBL_RC_ACT", 4)
        self.parameters.provide_param_int("NAV_DLL_ACT", 3)
        self.parameters.provide_param_float("COM_OF_LOSS_T", 1.0)
        self.telemetry = TelemetryServer(component)
        self.actions = ActionServer(component)
        self.actions.set_armable(True, False)
        self.actions.set_disarmable(True, False)
        self.actions.set_allow_takeoff(True)
        self.actions.set_allowable_flight_modes(AllowableFlightModes(True, True, True, False, True, True, True))
        self.actions.subscribe_arm_disarm(self._arm)
        self.actions.subscribe_flight_mode_change(self._change)
        self.direct = MavlinkDirectServer(component)
        self.direct.subscribe_message("SET_POSITION_TARGET_LOCAL_NED", self._aim)
        self.direct.subscribe_message("COMMAND_LONG", self._command)

    def _arm(self, _result: object, order: ArmDisarm, _data: object) -> None:
        if order.arm != self.point.armed:  # what the server changes itself comes back, too
            tell("arm", arm=order.arm, force=order.force)
        self.point.armed = order.arm

    def _change(self, _result: object, mode: FlightMode, _data: object) -> None:
        if mode != self.point.mode:
            tell("mode", mode=FlightMode(mode).name)
        self.point.mode = mode

    def _command(self, message: MavlinkMessage, _data: object) -> None:
        """MAVSDK 4.1's ActionServer neither takes nor answers NAV_LAND (21), which it has a subscription for."""
        if json.loads(message.fields_json)["command"] == NAV_LAND and self.point.mode != FlightMode.LAND:
            tell("land")
            self.point.mode = FlightMode.LAND
            self.actions.set_flight_mode(FlightMode.LAND)

    def _aim(self, message: MavlinkMessage, _data: object) -> None:
        said = json.loads(message.fields_json)
        self.point.target_m = [said["x"], said["y"], said["z"]]
        self.point.yaw_deg = said["yaw"] * 57.29577951
        self.point.set_points += 1

    def live(self) -> None:
        """Fly and speak for one period."""
        point = self.point
        was_aloft = point.aloft
        point.fly()
        if was_aloft and not point.aloft and point.mode == FlightMode.LAND:
            point.armed = False
            self.actions.set_armed_state(False)
            tell("landed", set_points=point.set_points, place_ned_m=point.place_m)
        self.telemetry.publish_position_velocity_ned(
            PositionVelocityNed(PositionNed(*point.place_m), VelocityNed(0.0, 0.0, 0.0))
        )
        boot_us = round(1e6 * (time.monotonic() - self._booted_s))  # of LOCAL_POSITION_NED MAVSDK tells it itself
        attitude = EulerAngle(0.0, 0.0, point.yaw_deg, boot_us)
        self.telemetry.publish_attitude(attitude, AngularVelocityBody(0.0, 0.0, 0.0))
        self.telemetry.publish_sys_status(Battery(16.0, 0.9), False, True, True, True, True)
        landed = LandedState.IN_AIR if point.aloft else LandedState.ON_GROUND
        self.telemetry.publish_extended_sys_state(VtolState.UNDEFINED, landed)


def main() -> None:
    mavsdk = Mavsdk(Configuration.create_manual(1, 1, True))
    mavsdk.add_any_connection(sys.argv[1])
    vehicle = Vehicle(mavsdk)
    ended = threading.Event()

    def end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=end, daemon=True).start()
    while not ended.is_set():
        vehicle.live()
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
