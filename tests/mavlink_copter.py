"""A small scripted copter with the measured habits of both autopilots, flown by the vehicle logic in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from camrig.rig import DroneSpec
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.frames import Vector, ned_from_world, world_from_ned, yaw_enu_from_ned, yaw_ned_from_enu
from camrig_drivers.mavlink.packets import (
    Attitude,
    Command,
    CommandAck,
    ExtendedState,
    Heard,
    Heartbeat,
    LocalPosition,
    PositionTarget,
    Said,
    StatusText,
    SystemStatus,
)
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.telemetry import Telemetry
from camrig_drivers.mavlink.vehicle import Vehicle

ORIGIN_M = (0.5, 0.2, 0.0)
SPEC = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=0.8)
STEP_S = 0.01
BOTH = pytest.mark.parametrize("flavour", [ARDUCOPTER, PX4], ids=lambda flavour: str(flavour.name))
LOITER = 5


@dataclass
class Copter:
    """A point that follows set-points at 2 m/s at most, and what an autopilot makes of packets."""

    flavour: Flavour
    position_m: Vector = (1.0, 1.0, 0.0)
    yaw_rad: float = 0.3
    mode: int = 0
    armed: bool = False
    landed_state: int = 1
    accepts_arming: bool = True
    deaf: bool = False
    silent: bool = False
    prearm_ok: bool = True
    climb_to_m: float | None = None
    target_m: Vector | None = None
    booted_s: float = 0.0
    last_set_point_s: float = -1e9
    set_points_since_s: float = 0.0
    armed_s: float = 0.0
    queue: list[Heard] = field(default_factory=list)

    def take(self, said: Said, now_s: float) -> None:
        if self.deaf:
            return
        match said:
            case PositionTarget(position_ned_m=point, yaw_ned_rad=yaw):
                if now_s - self.last_set_point_s > 1.0:
                    self.set_points_since_s = now_s
                self.last_set_point_s = now_s
                if self.mode == self.flavour.ours:
                    self._aim(world_from_ned(point, ORIGIN_M), yaw_enu_from_ned(yaw))
            case Command(command=command, params=params):
                self._command(command, params, now_s)

    def _aim(self, point_m: Vector, yaw_rad: float) -> None:
        if self.landed_state == 1 and self.climb_to_m is not None:
            self.climb_to_m = None  # measured: a set-point before lift-off cancels the take-off, silently
        if self.landed_state != 1 or self.flavour is PX4:
            self.target_m, self.yaw_rad, self.climb_to_m = point_m, yaw_rad, None

    def _command(self, command: int, params: tuple[float, ...], now_s: float) -> None:
        result = 0
        if command == 176:
            mode = int(params[1]) << 16 | int(params[2]) << 24 if self.flavour is PX4 else int(params[1])
            streamed = now_s - self.last_set_point_s < 0.5 and now_s - self.set_points_since_s > 0.5
            if mode != PX4.ours or streamed:  # PX4 accepts all the same
                self.enter(mode)
        elif command == 400:
            result = 0 if self.accepts_arming else 4
            self.armed, self.armed_s = self.armed or self.accepts_arming, now_s
            if result:
                self.queue.append(StatusText(2, "Arm: battery low"))
        elif command == 22:
            fit = self.mode == self.flavour.ours and self.armed and self.landed_state == 1
            result = 0 if fit else 4
            if fit:
                self.climb_to_m = self.position_m[2] + params[6]
        elif command == 21:
            self.enter(self.flavour.land)
        self.queue.append(CommandAck(command, result, (255, 190)))

    def enter(self, mode: int) -> None:
        self.mode, self.climb_to_m, self.target_m = mode, None, self.position_m
        self.queue.append(self.heartbeat())

    def heartbeat(self) -> Heartbeat:
        return Heartbeat(self.flavour.autopilot, 1 | 128 * self.armed, self.mode)

    def fly(self, dt_s: float, now_s: float) -> None:
        if self.flavour is PX4 and self.mode == PX4.ours and now_s - self.last_set_point_s > 1.0 and self.armed:
            self.enter(0x05040000)  # return to launch
        if self.mode == self.flavour.land:
            self.target_m = (*self.position_m[:2], 0.0)
        if self.armed and self.climb_to_m is not None and now_s - self.armed_s > 0.5:
            self.target_m = (*self.position_m[:2], self.climb_to_m)
        if not self.armed or self.target_m is None:
            return
        speed_m_s = 0.5 if self.mode == self.flavour.land else 2.0
        self.position_m = towards(self.position_m, self.target_m, speed_m_s * dt_s)
        if self.position_m[2] > 0.05:
            self.landed_state = 4 if self.mode == self.flavour.land else 2
        elif self.mode == self.flavour.land:
            self.landed_state, self.armed = 1, False

    def telemetry(self, step: int, now_s: float) -> Iterator[Heard]:
        boot_ms = round((now_s - self.booted_s) * 1e3)
        yield from self.queue
        self.queue = []
        if step % 3 == 0:
            yield Attitude(boot_ms, 0.0, 0.0, yaw_ned_from_enu(self.yaw_rad))
            yield LocalPosition(boot_ms, ned_from_world(self.position_m, ORIGIN_M))
        if step % 20 == 0:
            yield ExtendedState(self.landed_state)
            prearm = 0x10000000
            yield SystemStatus(prearm, prearm, prearm if self.prearm_ok else 0)
        if step % 100 == 0:
            yield self.heartbeat()


def towards(a: Vector, b: Vector, step_m: float) -> Vector:
    fraction = min(1.0, step_m / max(math.dist(a, b), 1e-9))
    x, y, z = (p + fraction * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z


class Flight:
    """A vehicle, a copter and a clock that only this moves."""

    def __init__(self, flavour: Flavour, **copter: object) -> None:
        self.copter = Copter(flavour, **copter)  # type: ignore[arg-type]
        self.now_s = 100.0
        self.step = 0
        self.said: list[tuple[float, Said]] = []
        seen = Telemetry(SPEC.id, ORIGIN_M, self.copter.heartbeat(), self.now_s)
        self.vehicle = Vehicle(SPEC, flavour, seen, stream_hz=30.0)

    def run(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time go by, at most ``duration_s``; return whether ``until`` came true."""
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            self.step += 1
            self.copter.fly(STEP_S, self.now_s)
            for packet in [] if self.copter.silent else list(self.copter.telemetry(self.step, self.now_s)):
                self.vehicle.hear(packet, self.now_s)
            for said in self.vehicle.tick(self.now_s):
                self.said.append((self.now_s, said))
                self.copter.take(said, self.now_s)
            if until():
                return True
        return False

    def reaches(self, phase: Phase, within_s: float = 20.0) -> bool:
        return self.run(within_s, lambda: self.vehicle.phase is phase)

    def take_off(self) -> None:
        self.run(1.5)
        self.vehicle.arm(self.now_s)
        assert self.reaches(Phase.FLYING)

    def set_points(self, since_s: float = 0.0) -> list[tuple[float, Vector]]:
        return [
            (stamp_s, world_from_ned(said.position_ned_m, ORIGIN_M))
            for stamp_s, said in self.said
            if isinstance(said, PositionTarget) and stamp_s > since_s
        ]

    def commands(self, since_s: float = 0.0) -> list[int]:
        """Everything asked for but message rates."""
        commands = [said.command for stamp_s, said in self.said if isinstance(said, Command) and stamp_s > since_s]
        return [command for command in commands if command != 511]
