"""One Pelco-D head: what each command does to its axes, and what it answers. Pure: commands carry their stamps."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_axis import CIRCLE, Axis
from camrig_emulators.pelco_d_optics import Optics
from camrig_emulators.pelco_d_settings import PelcoDHeadSettings
from camrig_emulators.pelco_d_wire import (
    CAMERA,
    DOWN,
    LEFT,
    RIGHT,
    SENSE,
    TELE,
    UP,
    WIDE,
    Command,
    extended_reply,
    general_reply,
    query_reply,
)

ROUNDING_S = 1e-6
QUERY = 0x45
PART_NUMBER = b"CAMRIG PELCO-D"
FLIP_PRESET, ZERO_PAN_PRESET = 33, 34


@dataclass(frozen=True, slots=True)
class Answer:
    """Bytes that begin on the wire at ``start_s`` if it is free by then."""

    start_s: float
    data: bytes


class PelcoDHead:
    """The state of one head and its answers to commands, which come in the order of their stamps."""

    def __init__(self, settings: PelcoDHeadSettings, rng: random.Random) -> None:
        self.settings = settings
        self.faults = Faults()
        self.pan = Axis(settings.start_pan_deg, settings.pan_limits_deg, settings.axes.pan, settings, rng, turbo=True)
        self.tilt = Axis(settings.start_tilt_deg, settings.tilt_limits_deg, settings.axes.tilt, settings, rng)
        self.optics = Optics(settings)
        self.camera_on = True
        self.alarms: set[int] = set()
        self._rng = rng
        self._presets: dict[int, tuple[int, int]] = {}
        self._last_end_s = -math.inf
        self._deaf_until_s = -math.inf

    def true_angles_deg(self, stamp_s: float) -> tuple[float, float]:
        """Return where the optics truly pointed: pan and tilt of docs/frames-and-units.md, in degrees."""
        pan_error, tilt_error = self.settings.zero_error_deg
        return self.pan.true_deg(stamp_s) + pan_error, self.tilt.true_deg(stamp_s) + tilt_error

    def handle(self, command: Command, *, frozen: bool = False) -> Answer | None:
        """Do what a command says; answer where this head answers such commands, read-back ``frozen`` or alive."""
        if not self._is_for_us(command):
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

    def power_cut(self, at_s: float) -> None:
        """Brown out: stand still, be deaf for ``reset_s``, and drive to where it started."""
        at_s = max(at_s, self._last_end_s)
        self.pan.reset(at_s)
        self.tilt.reset(at_s)
        self._presets.clear()
        self._deaf_until_s = at_s + self.settings.reset_s

    def _is_for_us(self, command: Command) -> bool:
        settings = self.settings
        zero = settings.hears_zero and command.address == 0
        return settings.hears_all or zero or command.address == settings.address or command.opcode == QUERY

    def _move(self, command: Command) -> None:
        """Obey a standard command: it says what both axes do from now on, so no direction bits mean stop."""
        at_s = command.end_s
        pan = bool(command.bits & RIGHT) - bool(command.bits & LEFT)
        tilt = bool(command.bits & DOWN) - bool(command.bits & UP)
        zoomed = self.optics.zoom_share(at_s)
        self.pan.jog(pan, command.data[0], at_s, zoomed)
        self.tilt.jog(tilt, command.data[1], at_s, zoomed)
        self.optics.jog(bool(command.bits & TELE) - bool(command.bits & WIDE), at_s)
        if command.switches & CAMERA:
            self.camera_on = bool(command.switches & SENSE)

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
                self.power_cut(at_s)
            case 0x19:
                self.alarms.discard(command.data[1])
            case 0x49:
                self.pan.set_zero(at_s)
            case 0x4B | 0x4D:
                self._go_to(opcode, command.value, at_s)
            case 0x4F:
                self.optics.zoom_to(command.value, at_s)
            case 0x5F:
                self.optics.set_5f(command.value, at_s)

    def _go_to(self, opcode: int, raw: int, at_s: float) -> None:
        mode = self.settings.absolute
        axis, other, name = (self.pan, self.tilt, "pan") if opcode == 0x4B else (self.tilt, self.pan, "tilt")
        if mode not in {"both", "race", name}:
            return
        if mode == "race" and not other.motion.at_rest(at_s):
            other.motion.stop(at_s)
        if name == "tilt" and self.settings.auto_flip and CIRCLE // 4 < raw <= CIRCLE // 2:
            self.pan.go_to((self.pan.raw(at_s) + CIRCLE // 2) % CIRCLE, at_s)
            raw = CIRCLE // 2 - raw
        axis.go_to(raw, at_s)

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

    def _reply(self, command: Command, frozen: bool) -> bytes:
        """Return the answer's bytes, empty where this head does not answer such a command."""
        answers, address = self.settings.answers, self.settings.address
        alarms = sum(1 << number - 1 for number in self.alarms)
        if answers in {"queries", "full"}:
            match command.opcode:
                case 0x45:
                    return query_reply(address, command.checksum, PART_NUMBER)
                case 0x51:
                    return extended_reply(address, 0x59, self._read(self.pan, command, frozen))
                case 0x53:
                    return extended_reply(address, 0x5B, self._read(self.tilt, command, frozen))
                case 0x55:
                    return extended_reply(address, 0x5D, self.optics.zoom(command.end_s))
                case 0x61:
                    return extended_reply(address, 0x63, self.optics.get_61(command.end_s))
                case 0x6B:
                    return extended_reply(address, 0x6D, 0x0001)
        if answers not in {"general", "full"}:
            return b""
        return general_reply(address, command.checksum, alarms, own_sum=self.settings.own_sum)

    def _read(self, axis: Axis, query: Command, frozen: bool) -> int:
        """Sample an axis somewhere between the query's end and the answer's start."""
        fraction = self.settings.sample_fraction
        if fraction is None:
            fraction = self._rng.random()
        if axis.last_read is None or not frozen:
            axis.last_read = axis.report(query.end_s + fraction * self.settings.reply_latency_s)
        return axis.last_read
