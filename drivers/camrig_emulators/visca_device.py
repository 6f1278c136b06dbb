"""One VISCA head: what each command does to its axes, and what it answers. Pure: messages carry their stamps."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_motion import AxisMotion
from camrig_emulators.visca_settings import Limits, ViscaAxisMap, ViscaHeadSettings
from camrig_emulators.visca_wire import (
    BUFFER_FULL,
    CANCELLED,
    LONGEST,
    NO_SOCKET,
    NOT_EXECUTABLE,
    WRONG_LENGTH,
    WRONG_SYNTAX,
    Message,
    acknowledge,
    completion,
    error,
    gathered,
    spread,
)
from camrig_emulators.visca_zoom import Zoom

SOCKETS = (1, 2)
LOOK_S = 1.0 / 60.0
"""How often a head looks whether a motion has ended: once a field."""
PAN_STEPS, TILT_STEPS = 0x18, 0x14
MODEL = bytes.fromhex("0001 040e 0100 02")
TIGHTEST = 1e-9


@dataclass(frozen=True, slots=True)
class Answer:
    """Bytes that begin on the wire at ``start_s`` if it is free by then."""

    start_s: float
    data: bytes


class Axis:
    """One axis: its motion, and the counts by which the protocol names its angle."""

    def __init__(self, start_deg: float, limits_deg: Limits, axis: ViscaAxisMap, settings: ViscaHeadSettings) -> None:
        self.map = axis
        self.limits_deg = limits_deg
        self.target_deg = start_deg
        self._settings = settings
        self.motion = AxisMotion(
            start_deg,
            limits=limits_deg,
            speed=settings.max_speed_deg_s,
            acceleration=settings.acceleration_deg_s2,
            start_latency_s=settings.start_latency_s,
            play=settings.backlash_deg,
        )

    def count(self, stamp_s: float) -> int:
        """Return what the head reports."""
        truthful = self._settings.reports == "position" or self.motion.at_rest(stamp_s)
        angle_deg = self.motion.motor(stamp_s) if truthful else self.target_deg
        return round((angle_deg - self.map.offset_deg) / (self.map.sign * self.map.deg_per_count))

    def target_of(self, count: int) -> float | None:
        """Return the angle of a position command; None where it is refused."""
        low, high = self.limits_deg
        wanted_deg = self.map.sign * self.map.deg_per_count * count + self.map.offset_deg
        inside_deg = min(max(wanted_deg, low), high)
        # The limits themselves need not be whole counts: one count beyond them still means them.
        refused = abs(inside_deg - wanted_deg) > self.map.deg_per_count and self._settings.out_of_range == "refuse"
        return None if refused else inside_deg

    def go_to(self, target_deg: float, at_s: float) -> None:
        self.target_deg = target_deg
        self.motion.go_to(target_deg, at_s)

    def jog(self, direction: int, share: float, at_s: float) -> None:
        """Turn towards growing (+1) or falling (-1) angles at a share of the full speed, or not at all (0)."""
        self.motion.jog(direction * share * self._settings.max_speed_deg_s, at_s)
        self.target_deg = self.motion.motor(at_s)


@dataclass(slots=True)
class Running:
    """A position command that holds a socket until both axes are at rest."""

    socket: int
    targets_deg: tuple[float, float]
    started_s: float | None
    """None while it waits for the one before it."""


class ViscaHead:
    """The state of one head and its answers to messages, which come in the order of their stamps."""

    def __init__(self, settings: ViscaHeadSettings, rng: random.Random) -> None:
        self.settings = settings
        self.address = settings.address
        self.faults = Faults()
        self.pan = Axis(settings.start_pan_deg, settings.pan_limits_deg, settings.axes.pan, settings)
        self.tilt = Axis(settings.start_tilt_deg, settings.tilt_limits_deg, settings.axes.tilt, settings)
        self.zoom = Zoom(settings.zoom_s)
        self._rng = rng
        self._running: list[Running] = []
        self._deaf_until_s = -math.inf
        self._last_read: bytes | None = None

    def true_angles_deg(self, stamp_s: float) -> tuple[float, float]:
        """Return where the optics truly pointed: pan and tilt of docs/frames-and-units.md, in degrees."""
        pan_error, tilt_error = self.settings.zero_error_deg
        return self.pan.motion.load(stamp_s) + pan_error, self.tilt.motion.load(stamp_s) + tilt_error

    def next_s(self, now_s: float) -> float:
        """Return when ``settle`` should be called next."""
        return now_s + LOOK_S if self._running or self.zoom.socket else math.inf

    def settle(self, now_s: float) -> list[Answer]:
        """Return the completions of the motions that have ended by now, and begin what has waited for them."""
        zoomed = self.zoom.settle(now_s)
        answers = [] if zoomed is None else [Answer(now_s, completion(self.address, zoomed))]
        while self._running and self._at_rest(now_s):
            done = [running for running in self._running if running.started_s is not None]
            answers += [Answer(now_s, completion(self.address, each.socket)) for each in done]
            self._running = [running for running in self._running if running.started_s is None]
            if self._running:
                self._begin(self._running[0], now_s)
        return answers

    def handle(self, message: Message, *, frozen: bool = False) -> list[Answer]:
        """Do what a message to this head says; return the answers, read-back ``frozen`` or alive."""
        if message.start_s < self._deaf_until_s or self.faults.take_drop():
            return []
        settled = self.settle(message.end_s)
        replies = self._obey(message, frozen or self.faults.freeze)
        return [*settled, *(Answer(message.end_s + self.settings.reply_latency_s, reply) for reply in replies)]

    def _obey(self, message: Message, frozen: bool) -> list[bytes]:
        body, at_s = message.body, message.end_s
        if len(message.raw) > LONGEST:
            return [error(self.address, 0, WRONG_LENGTH)]
        if len(body) == 1 and body[0] & 0xF0 == 0x20:
            return [self._cancel(body[0] & 0x0F, at_s)]
        if body == b"\x01\x00\x01":  # clear the interface
            self._running.clear()
            self.zoom.cancel(at_s)
            return [completion(self.address, 0)]
        if body[:1] == b"\x09":
            return [self._tell(body[1:], at_s, frozen)]
        for prefix, obey in self._commands.items():
            if body.startswith(prefix):
                if self.settings.standby:
                    return [error(self.address, 1, NOT_EXECUTABLE)]
                if not self._free_sockets:
                    return [error(self.address, 0, BUFFER_FULL)]
                return obey(body[len(prefix) :], at_s)
        return [error(self.address, 0, WRONG_SYNTAX)]

    @property
    def _commands(self) -> dict[bytes, Callable[[bytes, float], list[bytes]]]:
        return {
            b"\x01\x06\x01": self._drive,
            b"\x01\x06\x02": self._absolute,
            b"\x01\x06\x03": self._relative,
            b"\x01\x06\x04": self._home,
            b"\x01\x06\x05": self._reset,
            b"\x01\x04\x47": self._zoom_to,
        }

    # --- commands -------------------------------------------------------------------------------------------

    def _drive(self, data: bytes, at_s: float) -> list[bytes]:
        ways = {1: 1, 2: -1, 3: 0}
        if len(data) != 4 or data[2] not in ways or data[3] not in ways:
            return [error(self.address, 0, WRONG_SYNTAX)]
        ended = [completion(self.address, running.socket) for running in self._running]
        self._running.clear()
        self.pan.jog(ways[data[2]], min(data[0], PAN_STEPS) / PAN_STEPS, at_s)
        self.tilt.jog(ways[data[3]], min(data[1], TILT_STEPS) / TILT_STEPS, at_s)
        return [*self._done_at_once(), *ended]

    def _absolute(self, data: bytes, at_s: float) -> list[bytes]:
        counts = self._counts(data)
        if counts is None:
            return [error(self.address, 0, WRONG_SYNTAX)]
        return self._move(self.pan.target_of(counts[0]), self.tilt.target_of(counts[1]), at_s)

    def _relative(self, data: bytes, at_s: float) -> list[bytes]:
        counts = self._counts(data)
        if counts is None:
            return [error(self.address, 0, WRONG_SYNTAX)]
        pan, tilt = self.pan.count(at_s) + counts[0], self.tilt.count(at_s) + counts[1]
        return self._move(self.pan.target_of(pan), self.tilt.target_of(tilt), at_s)

    def _home(self, _: bytes, at_s: float) -> list[bytes]:
        return self._move(self.pan.target_of(0), self.tilt.target_of(0), at_s)

    def _reset(self, _: bytes, at_s: float) -> list[bytes]:
        self._deaf_until_s = at_s + self.settings.reset_s
        self._running.clear()
        self.pan.go_to(0.0, at_s)
        self.tilt.go_to(0.0, at_s)
        return []

    def _zoom_to(self, data: bytes, at_s: float) -> list[bytes]:
        value = gathered(data) if len(data) == 4 else None
        if value is None:
            return [error(self.address, 0, WRONG_SYNTAX)]
        socket = min(self._free_sockets)
        self.zoom.go_to(value, socket, at_s)
        return [acknowledge(self.address, socket)] if self.settings.acknowledges else []

    def _counts(self, data: bytes) -> tuple[int, int] | None:
        pan_digits, tilt_digits = self.pan.map.digits, self.tilt.map.digits
        if len(data) != 2 + pan_digits + tilt_digits:
            return None
        pan, tilt = gathered(data[2 : 2 + pan_digits]), gathered(data[2 + pan_digits :])
        return None if pan is None or tilt is None else (pan, tilt)

    def _move(self, pan_deg: float | None, tilt_deg: float | None, at_s: float) -> list[bytes]:
        socket = min(self._free_sockets)
        busy = bool(self._running)
        if pan_deg is None or tilt_deg is None or (busy and self.settings.overtaking == "refuse"):
            return [error(self.address, socket, NOT_EXECUTABLE)]
        running = Running(socket, (pan_deg, tilt_deg), None)
        self._running.append(running)
        if not (busy and self.settings.overtaking == "queue"):
            self._begin(running, at_s)
        return [acknowledge(self.address, socket)] if self.settings.acknowledges else []

    def _begin(self, running: Running, at_s: float) -> None:
        running.started_s = at_s
        for axis, target_deg in zip((self.pan, self.tilt), running.targets_deg, strict=True):
            low, high = axis.limits_deg
            beside_deg = self._rng.uniform(-1.0, 1.0) * self.settings.rest_error_deg
            axis.go_to(min(max(target_deg + beside_deg, low), high), at_s)

    @property
    def _free_sockets(self) -> set[int]:
        return set(SOCKETS) - {running.socket for running in self._running} - {self.zoom.socket or 0}

    def _cancel(self, socket: int, at_s: float) -> bytes:
        if socket and socket == self.zoom.socket:
            self.zoom.cancel(at_s)
            return error(self.address, socket, CANCELLED)
        found = [running for running in self._running if running.socket == socket]
        if not found:
            return error(self.address, socket, NO_SOCKET)
        self._running = [running for running in self._running if running.socket != socket]
        if found[0].started_s is not None:
            self.pan.motion.stop(at_s)
            self.tilt.motion.stop(at_s)
        return error(self.address, socket, CANCELLED)

    def _done_at_once(self) -> list[bytes]:
        socket = min(self._free_sockets)
        first = [acknowledge(self.address, socket)] if self.settings.acknowledges else []
        return [*first, completion(self.address, socket)]

    def _at_rest(self, now_s: float) -> bool:
        """Tell whether what was begun last has ended; a start that is still pending has not."""
        started_s = max((each.started_s for each in self._running if each.started_s is not None), default=-math.inf)
        pending = now_s < started_s + self.settings.start_latency_s + TIGHTEST
        return not pending and self.pan.motion.at_rest(now_s) and self.tilt.motion.at_rest(now_s)

    # --- inquiries ------------------------------------------------------------------------------------------

    def _tell(self, inquiry: bytes, asked_s: float, frozen: bool) -> bytes:
        if inquiry == b"\x00\x02":
            return completion(self.address, 0, MODEL)
        if inquiry == b"\x04\x00":
            return completion(self.address, 0, b"\x03" if self.settings.standby else b"\x02")
        if inquiry not in {b"\x06\x12", b"\x04\x47"}:
            return error(self.address, 0, WRONG_SYNTAX)
        if self.settings.standby:
            return error(self.address, 0, NOT_EXECUTABLE)
        if inquiry == b"\x04\x47":
            return completion(self.address, 0, spread(self.zoom.at(asked_s), 4))
        return completion(self.address, 0, self._read(asked_s, frozen))

    def _read(self, asked_s: float, frozen: bool) -> bytes:
        """Sample both axes somewhere between the inquiry's end and the answer's start."""
        fraction = self.settings.sample_fraction
        if fraction is None:
            fraction = self._rng.random()
        if self._last_read is None or not frozen:
            stamp_s = asked_s + fraction * self.settings.reply_latency_s
            digits = (self.pan.map.digits, self.tilt.map.digits)
            counts = (self.pan.count(stamp_s), self.tilt.count(stamp_s))
            self._last_read = b"".join(spread(count, each) for count, each in zip(counts, digits, strict=True))
        return self._last_read
