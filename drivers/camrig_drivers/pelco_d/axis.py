"""One axis of one head: its counting, its play, its speeds. Pure; radians outside, the head's own degrees inside."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Literal

from camrig.rig import Interval
from camrig_drivers.limits import check_within
from camrig_drivers.pelco_d.codec import FULL_TURN_RAW
from camrig_drivers.pelco_d.section import AxisSection

_DIGIT_DEG = 0.01
_BEND_ROUNDS = 6
_TAKE_UP = 1.5
"""How far before its target, in widths of the play, a move from the wrong side turns round."""


@dataclass(frozen=True, slots=True)
class AxisScale:
    """Between the raw hundredths of a degree of an axis and our radians, within its limits."""

    name: Literal["pan", "tilt"]
    section: AxisSection
    limits_rad: Interval
    readback_sigma_deg: float

    def raw(self, angle_rad: float) -> int:
        """Return 0..35999 for an angle; raises InputError outside the limits (or for NaN)."""
        self.check(angle_rad)
        return self.raw_unchecked(angle_rad)

    def check(self, angle_rad: float) -> None:
        """Raise InputError outside the limits (or for NaN)."""
        check_within(self.name, angle_rad, self.limits_rad)

    def raw_unchecked(self, angle_rad: float) -> int:
        """Return 0..35999 for an angle of the motor, which is ahead of the optics by half the play."""
        raw_deg = (self._line_deg(math.degrees(angle_rad)) - self.section.offset_deg) / self._signed_scale
        return round(100.0 * raw_deg) % FULL_TURN_RAW

    def angle_rad(self, raw: int) -> float:
        """Return the angle of a raw report, of all that look alike the one nearest to the middle of the limits."""
        raw_deg = math.remainder(raw / 100.0, 360.0)
        line_deg = self._signed_scale * raw_deg + self.section.offset_deg
        middle_deg = math.degrees(0.5 * (self.limits_rad[0] + self.limits_rad[1]))
        line_deg = middle_deg + math.remainder(line_deg - middle_deg, 360.0 * self.section.scale)
        return math.radians(line_deg + self._bend_deg(line_deg))

    @property
    def _signed_scale(self) -> float:
        return self.section.sign * self.section.scale

    def _bend_deg(self, line_deg: float) -> float:
        line_rad = math.radians(line_deg)
        return self.section.sine_deg * math.sin(line_rad) + self.section.cosine_deg * math.cos(line_rad)

    def _line_deg(self, angle_deg: float) -> float:
        """Undo the bend, by iteration: it changes by less than a tenth of what it is asked at."""
        line_deg = angle_deg
        for _ in range(_BEND_ROUNDS):
            line_deg = angle_deg - self._bend_deg(line_deg)
        return line_deg

    @property
    def play_rad(self) -> float:
        return math.radians(self.section.backlash_deg)

    @property
    def digit_rad(self) -> float:
        """Return the step of a report."""
        return math.radians(max(_DIGIT_DEG, self.section.resolution_deg) * self.section.scale)

    @property
    def arrival_rad(self) -> float:
        """Return how close to its target counts as there."""
        step_rad = math.radians(max(_DIGIT_DEG, self.section.resolution_deg)) * self.section.scale
        noise_rad = 2.0 * math.radians(self.readback_sigma_deg)
        return max(math.radians(self.section.arrival_deg), 1.5 * step_rad + noise_rad)

    def sigma_rad(self, play_width_rad: float) -> float:
        """Return one sigma of a report: its step and what is unknown of the play are uniform, width over sqrt(12)."""
        uniform_rad = math.hypot(self.digit_rad, play_width_rad) / math.sqrt(12.0)
        return math.hypot(uniform_rad, math.radians(self.readback_sigma_deg))

    def way(self, target_rad: float, present_rad: float | None) -> tuple[float, ...]:
        """Return the motor's angles on the way to where the optics shall look, arriving from the section's side.

        A move from the other side first goes past its target and turns round, so the play is always on one flank;
        at a limit there is no room for that, and the play is reckoned with instead.
        """
        play_rad = self.play_rad
        side = {"rising": 1.0, "falling": -1.0, "any": 0.0}[self.section.approach]
        if play_rad == 0.0:
            return (target_rad,)
        travel = 1.0 if present_rad is None or target_rad >= present_rad else -1.0
        if side in (0.0, travel):
            return (target_rad + 0.5 * travel * play_rad,)
        final_rad = target_rad + 0.5 * side * play_rad
        turn_rad = final_rad - side * _TAKE_UP * play_rad
        low_rad, high_rad = self.limits_rad
        if not low_rad <= turn_rad - side * 0.5 * play_rad <= high_rad:
            return (target_rad + 0.5 * travel * play_rad,)
        return turn_rad, final_rad


@dataclass(slots=True)
class Play:
    """Where, within its play, the optics are behind the motor: an interval that every travel of the motor narrows."""

    width_rad: float
    low_rad: float = -math.inf
    high_rad: float = math.inf

    def loosen(self) -> None:
        """Forget on which flank it is: a new command may take the motor to and fro between two reports."""
        self.low_rad, self.high_rad = -math.inf, math.inf

    def follow(self, motor_rad: float) -> tuple[float, float]:
        """Take where the motor was; return the middle of where the optics can be, and the width of that."""
        half_rad = 0.5 * self.width_rad
        self.low_rad = min(max(self.low_rad, motor_rad - half_rad), motor_rad + half_rad)
        self.high_rad = min(max(self.high_rad, motor_rad - half_rad), motor_rad + half_rad)
        return 0.5 * (self.low_rad + self.high_rad), self.high_rad - self.low_rad


class SpeedTable:
    """What speed a speed byte means on one axis, measured: monotone, straight between its entries."""

    def __init__(self, deg_s: dict[int, float]) -> None:
        """Take ``{byte: deg/s}`` with at least one entry, both growing; ``AxisSection`` has checked it."""
        self._entries = sorted(deg_s.items())
        first, last = self._entries[0][0], self._entries[-1][0]
        self._speeds = [math.radians(self._between(byte)) for byte in range(first, last + 1)]
        self._first = first

    @property
    def slowest_rad_s(self) -> float:
        return self._speeds[0]

    @property
    def fastest_rad_s(self) -> float:
        return self._speeds[-1]

    def byte_for(self, speed_rad_s: float) -> int:
        """Return the byte of the greatest speed that is not above the wanted one; 0 where even the slowest is."""
        place = bisect_right(self._speeds, speed_rad_s * (1.0 + 1e-9))
        return self._first + place - 1 if place else 0

    def speed_rad_s(self, byte: int) -> float:
        """Return the speed of a byte; 0 is standstill."""
        return self._speeds[byte - self._first] if byte else 0.0

    def _between(self, byte: int) -> float:
        place = max(1, bisect_right([entry[0] for entry in self._entries], byte))
        if place == len(self._entries):
            return self._entries[-1][1]
        (low, slow), (high, fast) = self._entries[place - 1], self._entries[place]
        return slow + (fast - slow) * (byte - low) / (high - low)
