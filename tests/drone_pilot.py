"""A hand-written ground station for the emulated drone: pymavlink's dialect class, simulated time, no socket."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.frames import R_ned_frd, euler, quaternion
from camrig_emulators.mavlink.protocol import MavlinkProtocol
from camrig_emulators.mavlink.troubles import Troubles
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.mavlink_drone import MavlinkDroneSettings

START_S = 1000.0
HERE = ("here", 1)
POSITION, POSITION_ONLY, VELOCITY = 0x9F8, 0xDF8, 0xDC7  # type masks
SET_MODE, ARM, TAKE_OFF, LAND, SET_INTERVAL, REQUEST = 176, 400, 22, 21, 511, 512
GUIDED = 4
ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED, FAILED = 0, 1, 3, 4  # results of commands
_TICK_S = 0.02


def set_point(
    position: Sequence[float] = (0.0, 0.0, 0.0),
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    mask: int = POSITION,
    frame: int = 1,
    yaw: float = 0.0,
    system: int = 1,
) -> Any:
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, 0.0
    )


def command_long(number: int, *params: float, system: int = 1) -> Any:
    padded = [*params, *[0.0] * (7 - len(params))]
    return dialect.MAVLink_command_long_message(system, 1, number, 0, *padded)


class Pilot:
    """Flies one vehicle in simulated time; ``beats`` is whether its 1 Hz heartbeat goes out."""

    def __init__(self, flavour: str, *, seed: int = 0, system: int = 255, **settings: Any) -> None:
        self.faults = Faults()
        self.settings = MavlinkDroneSettings.model_validate({"flavour": flavour, **settings})
        self.vehicle = Vehicle(self.settings, START_S, seed)
        self.protocol = MavlinkProtocol(self.vehicle, self.faults, seed)
        self.troubles = Troubles(self.vehicle, self.faults, [self.protocol], seed)
        self.troubles.schedule(self.settings.script, START_S)
        self.now_s = START_S
        self.beats = True
        self.heard: list[tuple[float, Any]] = []
        self._packer = dialect.MAVLink(None, srcSystem=system, srcComponent=190)
        self._parsers: dict[Any, Any] = {}
        self._beat_s = -math.inf
        self.wait(0.02)

    def say(self, message: Any, address: tuple[str, int] = HERE) -> None:
        self._take(self.protocol.receive(self.now_s, address, bytes(message.pack(self._packer))))

    def command(self, number: int, *params: float) -> list[int]:
        """Send a COMMAND_LONG; returns the results of its acknowledgements."""
        count = len(self.heard)
        self.say(command_long(number, *params))
        answers = [message for _, message in self.heard[count:] if message.get_type() == "COMMAND_ACK"]
        return [message.result for message in answers if message.command == number]

    def wait(self, duration_s: float, message: Any = None, rate_hz: float = 20.0) -> None:
        """Let time pass, sending ``message``, or what it returns then, at a rate."""
        end_s, next_s = self.now_s + duration_s, self.now_s
        while self.now_s < end_s - 1e-9:
            if self.beats and self.now_s - self._beat_s >= 1.0:
                self._beat_s = self.now_s
                self.say(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
            if message is not None and self.now_s >= next_s - 1e-9:
                next_s += 1.0 / rate_hz
                self.say(message() if callable(message) else message)
            self.now_s += _TICK_S
            self._take(self.protocol.poll(self.now_s))

    def until(self, holds: Callable[[], bool], message: Any = None, limit_s: float = 60.0) -> float:
        """Wait until ``holds()``; returns how long that took."""
        start_s = self.now_s
        while not holds():
            assert self.now_s - start_s < limit_s, "it never came true"
            self.wait(0.1, message)
        return self.now_s - start_s

    def happen(self, fault: str) -> None:
        self.troubles.now(fault, self.now_s)

    def pose(self, *, shift_m: Sequence[float] = (0.0, 0.0, 0.0), turn_rad: float = 0.0, reset: int = 0) -> Any:
        """Return a VISION_POSITION_ESTIMATE of the truth, shifted and turned."""
        truth = self.vehicle.history.latest.truth
        roll, pitch, yaw = euler(R_ned_frd(truth.T_world_body()[:3, :3]))
        place = [float(a + b) for a, b in zip(self.ned, shift_m, strict=True)]
        return dialect.MAVLink_vision_position_estimate_message(
            0, *place, roll, pitch, yaw + turn_rad, reset_counter=reset
        )

    def odometry(self, frame: int, child: int = 12, *, time_us: int = 0, quality: int = 0) -> Any:
        """Return an ODOMETRY of the truth."""
        q = quaternion(R_ned_frd(self.vehicle.history.latest.truth.T_world_body()[:3, :3]))
        unknown = [math.nan] * 21
        return dialect.MAVLink_odometry_message(
            time_us, frame, child, *map(float, self.ned), q, *[0.0] * 6, unknown, unknown, quality=quality
        )

    def since(self, stamp_s: float, name: str) -> list[Any]:
        return [message for heard_s, message in self.heard if heard_s >= stamp_s and message.get_type() == name]

    def texts(self, stamp_s: float = 0.0) -> list[tuple[int, str]]:
        return [(message.severity, message.text) for message in self.since(stamp_s, "STATUSTEXT")]

    def last(self, name: str) -> Any:
        return next(message for _, message in reversed(self.heard) if message.get_type() == name)

    @property
    def mode(self) -> int:
        return int(self.last("HEARTBEAT").custom_mode)

    @property
    def armed(self) -> bool:
        return self.vehicle.cockpit.armed

    @property
    def ned(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """True place in local NED (origin at the world's)."""
        x, y, z = self.vehicle.history.latest.truth.position_m
        return np.array([y, x, -z])

    @property
    def height_m(self) -> float:
        return -float(self.ned[2])

    @property
    def speed_m_s(self) -> float:
        return float(np.linalg.norm(self.vehicle.history.latest.truth.velocity_m_s))

    def quiet(self) -> None:
        """Ask for three telemetry messages and no others, which saves time."""
        for number in self.vehicle.firmware.default_streams_hz.keys() - {0, 111}:
            self.command(SET_INTERVAL, number, -1)
        for number, rate_hz in ((32, 10.0), (245, 4.0), (1, 2.0)):
            self.command(SET_INTERVAL, number, 1e6 / rate_hz)

    def take_off(self, height_m: float = 2.0) -> None:
        """Fly to a height over the start by each firmware's documented recipe."""
        self.quiet()
        if self.settings.flavour == "ardupilot":
            assert self.command(SET_MODE, 1, GUIDED) == [0]
            assert self.command(ARM, 1) == [0]
            assert self.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, height_m) == [0]
            self.until(lambda: abs(self.height_m - height_m) < 0.1)
        else:
            point = set_point((0.0, 0.0, -height_m))
            self.wait(0.5, point)
            self.command(SET_MODE, 1, 6)
            self.until(lambda: self.mode == 6 << 16, point)
            assert self.command(ARM, 1) == [0]
            self.until(lambda: abs(self.height_m - height_m) < 0.1, point)
        self.wait(1.0, None if self.settings.flavour == "ardupilot" else point)

    def _take(self, datagrams: list[tuple[Any, bytes]]) -> None:
        for address, data in datagrams:
            if address not in self._parsers:
                self._parsers[address] = dialect.MAVLink(None)
                self._parsers[address].robust_parsing = True
            for message in self._parsers[address].parse_buffer(data) or ():
                if address == HERE:
                    self.heard.append((self.now_s, message))
