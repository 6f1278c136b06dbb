"""Where an axis is that tells nothing: a time model of its speed commands, and how far it can be off. Pure.

Speeds ramp with one acceleration up and down, so that a motion of duration t at speed v ends v t further on whatever
the acceleration is. A motion's speed is off by a factor of its own, and its start and end by some time; what these
cost adds up in squares over all motions since the axis was last zeroed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TimeModel:
    """How one axis takes commands; sigmas are one sigma of each motion."""

    start_s: float
    start_sigma_s: float
    stop_sigma_s: float
    acceleration_rad_s2: float
    speed_sigma: float


@dataclass(slots=True)
class Reckoning:
    """One axis since it was last zeroed; stamps asked for never lie before the last command."""

    model: TimeModel
    angle_rad: float
    variance: float
    """Of what lies behind the present motion."""
    begun_s: float = -math.inf
    """When the present ramp began; the axis was at ``angle_rad`` with ``speed_rad_s`` then."""
    speed_rad_s: float = 0.0
    wanted_rad_s: float = 0.0
    from_rad: float | None = None
    """Where the present motion started."""
    fastest_rad_s: float = 0.0

    def command(self, speed_rad_s: float, at_s: float) -> None:
        """Take a command that the head has heard by ``at_s``; 0 stops."""
        if speed_rad_s == self.wanted_rad_s:
            return
        if self.begun_s > at_s:  # a start that was still pending never happens
            self._begin(at_s, self.angle_rad, 0.0, speed_rad_s)
            self.from_rad = self.angle_rad if speed_rad_s else None
            return
        angle_rad, now_rad_s = self._state(at_s)
        if speed_rad_s and now_rad_s == 0.0:
            self.variance = self.sigma_rad(at_s) ** 2
            self.from_rad, self.fastest_rad_s = angle_rad, 0.0
            at_s += self.model.start_s
        self._begin(at_s, angle_rad, now_rad_s, speed_rad_s)

    def at(self, stamp_s: float) -> float:
        """Return the angle at a stamp."""
        return self._state(stamp_s)[0]

    def rests(self, stamp_s: float) -> bool:
        """Tell whether the axis stands and is to stand at the stamp."""
        return self.wanted_rad_s == 0.0 and self._state(stamp_s)[1] == 0.0

    def sigma_rad(self, stamp_s: float) -> float:
        """Return one sigma of the angle at a stamp."""
        if self.from_rad is None:
            return math.sqrt(self.variance)
        angle_rad, speed_rad_s = self._state(stamp_s)
        model, ended = self.model, self.wanted_rad_s == 0.0
        speed_part = model.speed_sigma * (angle_rad - self.from_rad)
        start_part = model.start_sigma_s * (self.fastest_rad_s if ended else speed_rad_s)
        stop_part = model.stop_sigma_s * (self.fastest_rad_s if ended else 0.0)
        return math.sqrt(self.variance + speed_part**2 + start_part**2 + stop_part**2)

    def correct(self, shift_rad: float, gain: float) -> None:
        """Shift the whole motion by what a measurement showed, and keep ``1 - gain`` of the variance."""
        moved_rad = shift_rad * gain
        self.angle_rad += moved_rad
        if self.from_rad is not None:
            self.from_rad += moved_rad
        self.variance *= 1.0 - gain

    def settle(self, stamp_s: float) -> None:
        """Make all uncertainty so far that of the past: what follows is a motion of its own."""
        self.variance = self.sigma_rad(stamp_s) ** 2
        if self.from_rad is not None:
            self.from_rad = self.at(stamp_s)

    def _begin(self, at_s: float, angle_rad: float, now_rad_s: float, wanted_rad_s: float) -> None:
        self.begun_s, self.angle_rad = at_s, angle_rad
        self.speed_rad_s, self.wanted_rad_s = now_rad_s, wanted_rad_s
        self.fastest_rad_s = max(self.fastest_rad_s, abs(now_rad_s), abs(wanted_rad_s))

    def _state(self, stamp_s: float) -> tuple[float, float]:
        """Return angle and speed at a stamp."""
        passed_s = stamp_s - self.begun_s
        if not 0.0 < passed_s < math.inf:
            return self.angle_rad, self.speed_rad_s
        change = self.wanted_rad_s - self.speed_rad_s
        ramp_s = min(passed_s, abs(change) / self.model.acceleration_rad_s2)
        speed = self.speed_rad_s + math.copysign(self.model.acceleration_rad_s2 * ramp_s, change)
        if ramp_s < passed_s:
            speed = self.wanted_rad_s
        angle = self.angle_rad + 0.5 * (self.speed_rad_s + speed) * ramp_s + self.wanted_rad_s * (passed_s - ramp_s)
        return angle, speed
