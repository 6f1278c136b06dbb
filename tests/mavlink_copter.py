"""A small scripted copter with the measured habits of both autopilots, flown by the vehicle logic in simulated time."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from camrig.rig import DroneSpec
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.frames import Vector, ned_from_world, world_from_ned, yaw_enu_from_ned, yaw_ned_from_enu
from camrig_drivers.mavlink.packets import (
    Attitude,
    Command,
    CommandAck,
    Estimator,
    ExtendedState,
    GlobalOrigin,
    Heard,
    Heartbeat,
    LocalPosition,
    ParamRead,
    ParamValue,
    PositionTarget,
    Said,
    SetOrigin,
    StatusText,
    SystemStatus,
    TimeSync,
    Version,
)
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import VehicleSettings
from camrig_drivers.mavlink.telemetry import Telemetry
from camrig_drivers.mavlink.vehicle import Vehicle

ORIGIN_M = (0.5, 0.2, 0.0)
SPEC = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=0.8)
STEP_S = 0.01
BOTH = pytest.mark.parametrize("flavour", [ARDUCOPTER, PX4], ids=lambda flavour: str(flavour.name))
LOITER = 5
_ACCELERATION_M_S2 = 2.5
HEALTHY = 1 | 2 | 4 | 8 | 16 | 32
PARAMETERS = {
    "ArduCopter": {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 5.0, "GUID_TIMEOUT": 1.0, "MAV_GCS_SYSID": 255.0},
    "PX4": {"COM_OBL_RC_ACT": 4.0, "NAV_DLL_ACT": 3.0, "COM_OF_LOSS_T": 1.0},
}
UPKEEP = {511, 512}
"""Commands that ask for messages, and move nothing."""
ORDERS = (Command, PositionTarget)


@dataclass
class Copter:
    """A point that follows set-points at 2 m/s at most, and what an autopilot makes of packets."""

    flavour: Flavour
    position_m: Vector = (1.0, 1.0, 0.0)
    yaw_rad: float = 0.3
    mode: int = 0
    armed: bool = False
    landed_state: int = 1
    tells_landed: bool = True
    accepts_arming: bool = True
    deaf: bool = False
    silent: bool = False
    prearm_ok: bool = True
    battery: float | None = 0.9
    estimator: int = HEALTHY
    blind: bool = False
    mute_status: bool = False
    bias_m: Vector = (0.0, 0.0, 0.0)
    """What its estimate is off by."""
    parameters: dict[str, float] = field(default_factory=dict)
    origin: SetOrigin | None = None
    climb_to_m: float | None = None
    target_m: Vector | None = None
    booted_s: float = 0.0
    now_s: float = 0.0
    last_set_point_s: float = -1e9
    set_points_since_s: float = 0.0
    armed_s: float = 0.0
    failed_s: float | None = None
    """Since when PX4 is in the failsafe of missing set-points."""
    fence_ok: bool = True
    reported_m_s: Vector | None = None
    """What it says of its speed, where that is not the truth."""
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    gain_hz: float | None = None
    """It comes nearer to its set-point by this share of the gap in a second, and takes time to accelerate; None: at
    once at full speed.
    """
    speeds: list[tuple[int, float]] = field(default_factory=list)
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
            case ParamRead(name=name):
                known = {**PARAMETERS[self.flavour.name], **self.parameters}
                if name in known:
                    self.queue.append(param_value(name, known[name], raw=self.flavour.raw_integers))
            case TimeSync(tc1=0, ts1=asked_ns):
                self.queue.append(TimeSync(round((now_s - self.booted_s) * 1e9), asked_ns))
            case SetOrigin():
                self.origin = said
                self.queue.append(GlobalOrigin(said.latitude_deg, said.longitude_deg, said.altitude_m))

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
                self.climb_to_m = self.estimate_m[2] + params[6]
        elif command == 21:
            self.enter(self.flavour.land)
        elif command == 512 and params[0] == 148.0:
            self.queue.append(Version(0xFFFF, 0x04070000))
        elif command == 178:
            self.speeds.append((int(params[0]), params[1]))
        elif command in {1000, 1001} and self.flavour is PX4:
            return  # no gimbal module: no answer at all
        self.queue.append(CommandAck(command, result, (255, 190)))

    def _miss_set_points(self, now_s: float) -> None:
        """PX4 without set-points: hold, land after 5 s (COM_OBL_RC_ACT 4); with them again it flies them, unasked."""
        missing = now_s - self.last_set_point_s > 1.0
        if self.flavour is PX4 and self.mode == PX4.ours and missing and self.armed:
            self.enter(PX4.brake)
            self.failed_s = now_s
        elif self.failed_s is not None and not missing:
            self.enter(PX4.ours)
        elif self.failed_s is not None and now_s - self.failed_s > 5.0 and self.mode != PX4.land:
            failed_s = self.failed_s
            self.enter(PX4.land)
            self.failed_s = failed_s

    def enter(self, mode: int) -> None:
        self.failed_s = None
        self.mode, self.climb_to_m, self.target_m = mode, None, self.estimate_m
        self.queue.append(self.heartbeat())

    def heartbeat(self) -> Heartbeat:
        return Heartbeat(self.flavour.autopilot, 1 | 128 * self.armed, self.mode)

    def fly(self, dt_s: float, now_s: float) -> None:
        self._miss_set_points(now_s)
        if self.mode == self.flavour.land:
            self.target_m = (*self.estimate_m[:2], self.bias_m[2])
        if self.armed and self.climb_to_m is not None and now_s - self.armed_s > 0.5:
            self.target_m = (*self.estimate_m[:2], self.climb_to_m)
        if not self.armed or self.target_m is None:
            self.velocity_m_s = (0.0, 0.0, 0.0)
            return
        gap_m = minus(minus(self.target_m, self.bias_m), self.position_m)
        distance_m = math.hypot(*gap_m)
        share = min(1.0 / dt_s, self._speed_m_s(distance_m) / max(distance_m, 1e-9))
        change = [share * gap - speed for gap, speed in zip(gap_m, self.velocity_m_s, strict=True)]
        most_m_s = math.inf if self.gain_hz is None else _ACCELERATION_M_S2 * dt_s
        kept = min(1.0, most_m_s / max(math.hypot(*change), 1e-9))
        x, y, z = (speed + kept * part for speed, part in zip(self.velocity_m_s, change, strict=True))
        self.velocity_m_s = (x, y, z)
        east, north, up = (place + speed * dt_s for place, speed in zip(self.position_m, (x, y, z), strict=True))
        self.position_m = (east, north, max(0.0, up))
        if self.position_m[2] > 0.05:
            self.landed_state = 4 if self.mode == self.flavour.land else 2
        elif self.mode == self.flavour.land:
            self.landed_state, self.armed = 1, False

    @property
    def estimate_m(self) -> Vector:
        """Where it believes it is; set-points are of this frame."""
        return minus(self.position_m, minus((0.0, 0.0, 0.0), self.bias_m))

    def _speed_m_s(self, gap_m: float) -> float:
        if self.mode == self.flavour.land:
            return 0.5
        told = [speed_m_s for kind, speed_m_s in self.speeds if kind == 1][-1:] if self.flavour.keeps_speed else []
        limit_m_s = min([2.0, *told])
        return limit_m_s if self.gain_hz is None else min(limit_m_s, self.gain_hz * gap_m)

    def telemetry(self, step: int, now_s: float) -> Iterator[Heard]:
        boot_ms = round((now_s - self.booted_s) * 1e3)
        yield from self.queue
        self.queue = []
        if step % 4 == 0:
            yield Attitude(boot_ms, 0.0, 0.0, yaw_ned_from_enu(self.yaw_rad))
            if not self.blind:
                east, north, up = self.reported_m_s or self.velocity_m_s
                yield LocalPosition(boot_ms, ned_from_world(self.estimate_m, ORIGIN_M), (north, east, -up))
        if step % 20 == 0:
            if self.tells_landed:
                yield ExtendedState(self.landed_state)
            prearm, fence = 0x10000000, 0x100000
            healthy = prearm * self.prearm_ok | fence * self.fence_ok
            if not self.mute_status:
                yield SystemStatus(prearm | fence, prearm | fence, healthy, self.battery)
            yield Estimator(self.estimator, 0.1)
        if step % 100 == 0:
            yield self.heartbeat()


def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def param_value(name: str, value: float, *, raw: bool) -> ParamValue:
    """Return a value as each firmware squeezes it into a float; times are reals."""
    if raw and not name.endswith("_T"):
        return ParamValue(name, float(struct.unpack("<f", struct.pack("<i", int(value)))[0]), 6)
    return ParamValue(name, value, 9)


class Flight:
    """A vehicle, a copter and a clock that only this moves."""

    def __init__(
        self, flavour: Flavour, settings: VehicleSettings | None = None, spec: DroneSpec = SPEC, **copter: Any
    ) -> None:
        self.copter = Copter(flavour, **copter)
        self.now_s = 100.0
        self.step = 0
        self.said: list[tuple[float, Said]] = []
        self.delay_s = 0.0
        """How long the link holds back what the copter says."""
        self._coming: list[tuple[float, Heard]] = []
        seen = Telemetry(spec.id, ORIGIN_M, self.copter.heartbeat(), self.now_s)
        self.vehicle = Vehicle(spec, flavour, seen, settings or VehicleSettings())

    def run(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time go by, at most ``duration_s``; return whether ``until`` came true."""
        for _ in range(round(duration_s / STEP_S)):
            self.advance(STEP_S)
            if until():
                return True
        return False

    def advance(self, dt_s: float, *, hangs: bool = False) -> None:
        """Let ``dt_s`` go by; the vehicle's thread hangs or does its work."""
        self.now_s += dt_s
        self.step += round(dt_s / STEP_S)
        self.copter.fly(dt_s, self.now_s)
        packets = list(self.copter.telemetry(self.step, self.now_s))
        if hangs:
            return
        self._coming += [(self.now_s + self.delay_s, packet) for packet in packets if not self.copter.silent]
        while self._coming and self._coming[0][0] <= self.now_s:
            self.vehicle.hear(self._coming.pop(0)[1], self.now_s)
        for said in self.vehicle.tick(self.now_s):
            self.said.append((self.now_s, said))
            self.copter.take(said, self.now_s)

    def reaches(self, phase: Phase, within_s: float = 20.0) -> bool:
        return self.run(within_s, lambda: self.vehicle.phase is phase)

    def take_off(self) -> None:
        self.run(2.0)
        self.vehicle.arm(self.now_s)
        assert self.reaches(Phase.FLYING)

    def set_points(self, since_s: float = 0.0) -> list[tuple[float, Vector]]:
        return [
            (stamp_s, world_from_ned(said.position_ned_m, ORIGIN_M))
            for stamp_s, said in self.said
            if isinstance(said, PositionTarget) and stamp_s > since_s
        ]

    def commands(self, since_s: float = 0.0) -> list[int]:
        """Everything asked for but messages."""
        commands = [said.command for stamp_s, said in self.said if isinstance(said, Command) and stamp_s > since_s]
        return [command for command in commands if command not in UPKEEP]
