"""Pointing by speed bytes with read-back: a servo loop over a slow line.

A command is in force until the next one, so every speed is chosen such that the target is not passed before the next
command is due, judged by how long a round took so far; should that one not come, the motion is ended in time anyhow.
The rest of the way, shorter than the slowest speed covers in a round, is gone in pulses whose length is learnt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig_drivers.pelco_d.axis import SpeedTable
from camrig_drivers.pelco_d.codec import Axis
from camrig_drivers.pelco_d.commands import STOP, drive
from camrig_drivers.pelco_d.steering import DisobeyedError, Parts, RunawayError, Wire

_ROUNDS_TO_TARGET = 1.4
_ROUND_GAIN = 0.25
_ANSWERS_BY_S = 0.03
_LAG_S = 0.05
"""From a report to a command in force, besides what the head takes to begin: the rest of a round trip, a gap."""
_MOVES_BY_S = 5.0
_TURNS_BY_S = 0.7
_AWAY_RAD = math.radians(2.0)
_MOVED_RAD = math.radians(0.05)
_SEEN_RAD = math.radians(1.0)
"""Over a way longer than this a head that is driven must soon be seen to move."""
_LONGEST_PULSE_S = 0.3
_LONGEST_EXTRA_S = 0.4
_PULSE_GAIN = 0.5


@dataclass(slots=True)
class _Loop:
    """One axis: what it is after, what it was last told, and how it took to that."""

    speeds: SpeedTable
    ahead: list[float] = field(default_factory=list)
    motor_rad: float | None = None
    stamp_s: float = -math.inf
    byte: int = 0
    """Signed: what is in force, growing angles positive."""
    turned_s: float = -math.inf
    """Since when it has been in force in that direction."""
    stop_by_s: float = math.inf
    since_s: float = math.inf
    """Since when it has been told to move, and from where."""
    from_rad: float = 0.0
    nearest_rad: float = math.inf
    extra_s: float = 0.05
    """What a pulse needs beyond distance over speed."""
    idle: bool = False
    """The last motion was ended before it had begun: a head with a long dead time needs a pulse instead."""
    pulse: tuple[float, float] | None = None
    """Where the last pulse began and how far it was to go."""


class VelocityPointing:
    """``Steering`` by standard commands."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self._loops: dict[Axis, _Loop] = {}
        for axis, scale in parts.axes.items():
            if scale.section.speeds is not None:
                self._loops[axis] = _Loop(SpeedTable(scale.section.speeds))
        self._sent_s = -math.inf
        gap_s, frame_s = parts.section.gap_s, parts.frame_s
        self._round_s = self._least_round_s = 2.0 * (3.0 * frame_s + 2.0 * gap_s + _ANSWERS_BY_S)

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        for axis, angle_rad in angles_rad.items():
            loop = self._loops[axis]
            ahead = list(self.parts.axes[axis].way(angle_rad, loop.motor_rad))
            if loop.ahead and abs(loop.ahead[-1] - ahead[-1]) < self.parts.axes[axis].arrival_rad:
                continue
            loop.ahead, loop.nearest_rad, loop.since_s = ahead, math.inf, math.inf

    def observe(self, axis: Axis, motor_rad: float, stamp_s: float, wire: Wire) -> None:
        loop = self._loops[axis]
        if loop.byte and stamp_s - loop.stamp_s < 2.0:  # both axes asked, and driven anew after each
            took_s = stamp_s - loop.stamp_s
            self._round_s = max(self._least_round_s, self._round_s + _ROUND_GAIN * (took_s - self._round_s), took_s)
        before_rad, loop.motor_rad, loop.stamp_s = loop.motor_rad, motor_rad, stamp_s
        self._learn_pulse(loop)
        if not loop.ahead:
            return
        self._watch_obedience(axis, loop)
        rested = before_rad is not None and abs(motor_rad - before_rad) < 0.5 * _MOVED_RAD
        error_rad = loop.ahead[0] - motor_rad
        if loop.byte == 0 and rested and abs(error_rad) <= self.parts.axes[axis].arrival_rad:
            del loop.ahead[0]
            loop.nearest_rad = math.inf
            self.parts.watches[axis].stood()
            return
        byte = self._wanted(axis, loop)
        loop.idle |= rested and byte == 0 != loop.byte
        if (byte == 0 or loop.idle) and rested and not any(other.byte for other in self._loops.values()):
            self._pulse(axis, loop, error_rad, wire)
        elif byte != loop.byte or self._refresh_due():
            self._drive({axis: byte}, wire)

    def begin(self, axis: Axis, motor_rad: float) -> None:
        self._loops[axis].motor_rad = motor_rad

    def tend(self, wire: Wire, *, blind: bool) -> None:
        now_s = self.parts.clock.now_s()
        late = {axis: 0 for axis, loop in self._loops.items() if loop.byte and (blind or now_s >= loop.stop_by_s)}
        if late or self._refresh_due():
            self._drive(late, wire)

    def forget(self) -> None:
        for axis, loop in self._loops.items():
            loop.ahead, loop.byte, loop.pulse = [], 0, None
            loop.stamp_s, loop.since_s, loop.stop_by_s = -math.inf, math.inf, math.inf
            self.parts.watches[axis].stood()

    def _wanted(self, axis: Axis, loop: _Loop) -> int:
        """Return the signed byte of the greatest speed that does not pass the target before the next round.

        What counts is where the axis will be when the command is in force, and how far it then coasts to that speed.
        """
        assert loop.motor_rad is not None
        acceleration = math.radians(self.parts.axes[axis].section.acceleration_deg_s2)
        moving_rad_s = math.copysign(loop.speeds.speed_rad_s(abs(loop.byte)), loop.byte)
        ahead_s = self.parts.clock.now_s() - loop.stamp_s + _LAG_S + self.parts.section.start_s
        error_rad = loop.ahead[0] - loop.motor_rad - moving_rad_s * ahead_s
        way_rad, towards = abs(error_rad), math.copysign(1.0, error_rad)
        forward_rad_s = max(0.0, towards * moving_rad_s)
        byte = loop.speeds.byte_for(way_rad / (_ROUNDS_TO_TARGET * self._round_s))
        while byte:
            speed_rad_s = loop.speeds.speed_rad_s(byte)
            coast_rad = max(0.0, forward_rad_s - speed_rad_s) ** 2 / (2.0 * acceleration)
            if coast_rad + speed_rad_s * _ROUNDS_TO_TARGET * self._round_s <= way_rad:
                break
            byte = loop.speeds.byte_for(0.9 * speed_rad_s)
        return int(math.copysign(byte, error_rad))

    def _drive(self, wanted: Mapping[Axis, int], wire: Wire) -> None:
        """Put new speeds into force, those of the other axis unchanged."""
        bytes_ = {axis: wanted.get(axis, loop.byte) for axis, loop in self._loops.items()}
        pan, tilt = (bytes_[axis] * self.parts.axes[axis].section.drive_sign for axis in (Axis.PAN, Axis.TILT))
        command = drive(pan, -tilt, self.parts.section.dialect) if pan or tilt else STOP
        wire.send(command)
        self._sent_s = now_s = self.parts.clock.now_s()
        for axis, loop in self._loops.items():
            self._in_force(axis, loop, bytes_[axis], now_s)

    def _in_force(self, axis: Axis, loop: _Loop, byte: int, now_s: float) -> None:
        if byte == loop.byte:
            return
        error_rad = loop.ahead[0] - loop.motor_rad if loop.ahead and loop.motor_rad is not None else 0.0
        if byte and not loop.byte and loop.motor_rad is not None:
            if loop.since_s == math.inf:
                loop.since_s, loop.from_rad = now_s, loop.motor_rad
            if abs(error_rad) > _SEEN_RAD:
                self.parts.watches[axis].told(loop.motor_rad + error_rad, now_s)
        if byte * loop.byte <= 0:
            loop.turned_s = now_s
        if byte * loop.byte < 0:
            self.parts.plays[axis].loosen()
        loop.byte = byte
        speed_rad_s = loop.speeds.speed_rad_s(abs(byte))
        loop.stop_by_s = now_s + abs(error_rad) / speed_rad_s if byte else math.inf

    def _pulse(self, axis: Axis, loop: _Loop, error_rad: float, wire: Wire) -> None:
        """Turn at the slowest speed for as long as the rest of the way takes."""
        clock = self.parts.clock
        first = loop.speeds.byte_for(loop.speeds.slowest_rad_s)
        self._drive({axis: int(math.copysign(first, error_rad))}, wire)
        clock.sleep_s(min(_LONGEST_PULSE_S, abs(error_rad) / loop.speeds.slowest_rad_s + loop.extra_s))
        assert loop.motor_rad is not None
        loop.pulse, loop.idle = (loop.motor_rad, error_rad), False
        self._drive({axis: 0}, wire)

    def _learn_pulse(self, loop: _Loop) -> None:
        if loop.pulse is None or loop.motor_rad is None:
            return
        (from_rad, wanted_rad), loop.pulse = loop.pulse, None
        short_rad = math.copysign(1.0, wanted_rad) * (from_rad + wanted_rad - loop.motor_rad)
        extra_s = loop.extra_s + _PULSE_GAIN * short_rad / loop.speeds.slowest_rad_s
        loop.extra_s = min(max(extra_s, 0.0), _LONGEST_EXTRA_S)

    def _watch_obedience(self, axis: Axis, loop: _Loop) -> None:
        """Raise DisobeyedError where the axis runs away from its target, or does not move at all."""
        assert loop.motor_rad is not None
        error_rad, now_s = loop.ahead[0] - loop.motor_rad, self.parts.clock.now_s()
        off_rad = abs(error_rad)
        loop.nearest_rad = min(loop.nearest_rad, off_rad)
        driven_there = loop.byte * error_rad > 0.0 and now_s - loop.turned_s > _TURNS_BY_S
        where = f"head {self.parts.name} at address {self.parts.section.address} on {self.parts.section.port}"
        if driven_there and off_rad > loop.nearest_rad + _AWAY_RAD:
            raise RunawayError(
                f"{where} turns its {axis.name.lower()} the wrong way; check the axis's sign and drive_sign"
            )
        if abs(loop.motor_rad - loop.from_rad) > _MOVED_RAD:
            loop.since_s = math.inf
        elif now_s - loop.since_s > _MOVES_BY_S:
            raise DisobeyedError(f"{where} answers, and its {axis.name.lower()} does not turn when it is driven")

    def _refresh_due(self) -> bool:
        moving = any(loop.byte for loop in self._loops.values())
        return moving and self.parts.clock.now_s() - self._sent_s >= self.parts.section.refresh_s
