"""One Pelco-D head: what each command does to its axes, and what it answers. Pure: commands carry their stamps."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_motion import AxisMotion
from camrig_emulators.pelco_d_settings import AxisMap, Limits, PelcoDHeadSettings
from camrig_emulators.pelco_d_wire import (
    DOWN,
    FULL_SPEED,
    LEFT,
    RIGHT,
    UP,
    Command,
    extended_reply,
    general_reply,
    query_reply,
)

CIRCLE = 36000
ROUNDING_S = 1e-6
QUERY = 0x45
PART_NUMBER = b"CAMRIG PELCO-D"
FLIP_PRESET, ZERO_PAN_PRESET = 33, 34


@dataclass(frozen=True, slots=True)
class Answer:
    """Bytes that begin on the wire at ``start_s`` if it is free by then."""

    start_s: float
    data: bytes


class Axis:
    """One axis on the wire: its motion, and the hundredths of a degree by which the protocol names its angle."""

    def __init__(
        self, start_deg: float, limits_deg: Limits | None, axis: AxisMap, settings: PelcoDHeadSettings
    ) -> None:
        self._axis = axis
        self._settings = settings
        self._zero_raw_deg = 0.0
        self.last_read: int | None = None
        self.motion = AxisMotion(
            start_deg,
            limits=limits_deg,
            speed=settings.max_speed_deg_s,
            acceleration=settings.acceleration_deg_s2,
            start_latency_s=settings.start_latency_s,
            play=settings.backlash_deg,
        )

    def raw(self, stamp_s: float) -> int:
        """Return what the head reports, 0 to 35999."""
        step_deg = self._settings.readback_step_deg
        steps = round((self._raw_deg(stamp_s) - self._zero_raw_deg) / step_deg)
        return round(steps * step_deg * 100.0) % CIRCLE

    def go_to(self, raw: int, at_s: float) -> None:
        """Move to a position of the wire; the turn that is nearest, within the limits."""
        target_deg = self._target(raw, at_s)
        if target_deg is not None:
            self.motion.go_to(target_deg, at_s)

    def jog(self, direction: int, speed_byte: int, at_s: float) -> None:
        """Turn towards growing (+1) or falling (-1) raw, or not at all (0). Speed 0 stops, above 3F is full speed."""
        speed = direction * self._axis.sign * self._settings.max_speed_deg_s * min(speed_byte, FULL_SPEED) / FULL_SPEED
        dead_man_s = self._settings.dead_man_s
        self.motion.jog(speed, at_s, until_s=math.inf if dead_man_s is None else at_s + dead_man_s)

    def set_zero(self, at_s: float) -> None:
        """Call the present angle raw 0 from now on."""
        self._zero_raw_deg = self._raw_deg(at_s)

    def _raw_deg(self, stamp_s: float) -> float:
        return (self.motion.motor(stamp_s) - self._axis.offset_deg) / (self._axis.sign * self._axis.scale)

    def _target(self, raw: int, at_s: float) -> float | None:
        raw_deg = raw / 100.0 + self._zero_raw_deg
        turn_deg = 360.0 * self._axis.scale
        now_deg = self.motion.motor(at_s)
        wanted_deg = self._axis.sign * self._axis.scale * raw_deg + self._axis.offset_deg
        nearest_deg = now_deg + math.remainder(wanted_deg - now_deg, turn_deg)
        if self.motion.limits is None:
            return nearest_deg
        low, high = self.motion.limits
        turns = [nearest_deg + k * turn_deg for k in (0, -1, 1)]
        clamped = [min(max(angle, low), high) for angle in turns]
        off_deg = [abs(math.remainder(angle - wanted_deg, turn_deg)) for angle in clamped]
        best = min(range(len(turns)), key=lambda k: round(off_deg[k], 6))  # a tie goes to the nearest turn
        return None if off_deg[best] > 1e-6 and self._settings.out_of_range == "ignore" else clamped[best]


class PelcoDHead:
    """The state of one head and its answers to commands, which come in the order of their stamps."""

    def __init__(self, settings: PelcoDHeadSettings, rng: random.Random) -> None:
        self.settings = settings
        self.faults = Faults()
        self.pan = Axis(settings.start_pan_deg, settings.pan_limits_deg, settings.axes.pan, settings)
        self.tilt = Axis(settings.start_tilt_deg, settings.tilt_limits_deg, settings.axes.tilt, settings)
        self._rng = rng
        self._zoom = 0
        self._presets: dict[int, tuple[int, int]] = {}
        self._last_end_s = -math.inf
        self._deaf_until_s = -math.inf

    def true_angles_deg(self, stamp_s: float) -> tuple[float, float]:
        """Return where the optics truly pointed: pan and tilt of docs/frames-and-units.md, in degrees."""
        pan_error, tilt_error = self.settings.zero_error_deg
        return self.pan.motion.load(stamp_s) + pan_error, self.tilt.motion.load(stamp_s) + tilt_error

    def handle(self, command: Command, *, frozen: bool = False) -> Answer | None:
        """Do what a command says; answer where this head answers such commands, read-back ``frozen`` or alive."""
        if command.address != self.settings.address and command.opcode != QUERY:
            return None
        gap_s, self._last_end_s = command.start_s - self._last_end_s, command.end_s
        if (
            gap_s < self.settings.min_gap_s - ROUNDING_S
            or command.start_s < self._deaf_until_s
            or self.faults.take_drop()
        ):
            return None
        if command.opcode is None:
            self._move(command)
        else:
            self._extended(command.opcode, command)
        data = self._reply(command, frozen or self.faults.freeze)
        return Answer(command.end_s + self.settings.reply_latency_s, data) if data else None

    def _move(self, command: Command) -> None:
        """Obey a standard command: it says what both axes do from now on, so no direction bits mean stop."""
        pan = bool(command.bits & RIGHT) - bool(command.bits & LEFT)
        tilt = bool(command.bits & DOWN) - bool(command.bits & UP)
        self.pan.jog(pan, command.data[0], command.end_s)
        self.tilt.jog(tilt, command.data[1], command.end_s)

    def _extended(self, opcode: int, command: Command) -> None:
        at_s = command.end_s
        match opcode:
            case 0x03:
                self._presets[command.data[1]] = (self.pan.raw(at_s), self.tilt.raw(at_s))
            case 0x05:
                self._presets.pop(command.data[1], None)
            case 0x07:
                self._call_preset(command.data[1], at_s)
            case 0x0F:
                self._reset(at_s)
            case 0x49:
                self.pan.set_zero(at_s)
            case 0x4B:
                self.pan.go_to(command.value, at_s)
            case 0x4D:
                self.tilt.go_to(command.value, at_s)
            case 0x4F:
                self._zoom = command.value

    def _call_preset(self, number: int, at_s: float) -> None:
        """Go to a stored position; 33 and 34 are the built-in ones: half a turn, and pan 0."""
        if number == FLIP_PRESET:
            self.pan.go_to(self.pan.raw(at_s) + CIRCLE // 2, at_s)
        elif number == ZERO_PAN_PRESET:
            self.pan.go_to(0, at_s)
        elif number in self._presets:
            pan, tilt = self._presets[number]
            self.pan.go_to(pan, at_s)
            self.tilt.go_to(tilt, at_s)

    def _reset(self, at_s: float) -> None:
        self.pan.motion.stop(at_s)
        self.tilt.motion.stop(at_s)
        self._deaf_until_s = at_s + self.settings.reset_s

    def _reply(self, command: Command, frozen: bool) -> bytes:
        """Return the answer's bytes, empty where this head does not answer such a command."""
        answers, address = self.settings.answers, self.settings.address
        if answers in {"queries", "full"}:
            match command.opcode:
                case 0x45:
                    return query_reply(address, command.checksum, PART_NUMBER)
                case 0x51:
                    return extended_reply(address, 0x59, self._read(self.pan, command, frozen))
                case 0x53:
                    return extended_reply(address, 0x5B, self._read(self.tilt, command, frozen))
                case 0x55:
                    return extended_reply(address, 0x5D, self._zoom)
                case 0x6B:
                    return extended_reply(address, 0x6D, 0x0001)
        return general_reply(address, command.checksum) if answers in {"general", "full"} else b""

    def _read(self, axis: Axis, query: Command, frozen: bool) -> int:
        """Sample an axis somewhere between the query's end and the answer's start."""
        fraction = self.settings.sample_fraction
        if fraction is None:
            fraction = self._rng.random()
        if axis.last_read is None or not frozen:
            axis.last_read = axis.raw(query.end_s + fraction * self.settings.reply_latency_s)
        return axis.last_read
