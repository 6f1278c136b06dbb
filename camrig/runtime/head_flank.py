"""On which side of its play an axis is, by the course of its motor's reports. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

STILL_RAD = math.radians(0.03)
"""By so little reports of an axis at rest differ."""
_WIDEST_PLAY_RAD = math.radians(1.5)
"""On which side of its play an axis is, is taken for known once it came so far in one direction."""
_SWALLOWED_RAD = math.radians(0.12)
"""So little of a way back the play of any head worth calibrating swallows."""


@dataclass(slots=True)
class Flank:
    """On which side of any likely play an axis is: follows its reports."""

    low_rad: float = -math.inf
    high_rad: float = math.inf

    def follow(self, reported_rad: float) -> None:
        """Take a report."""
        half_rad = 0.5 * _WIDEST_PLAY_RAD
        self.low_rad = min(max(self.low_rad, reported_rad - half_rad), reported_rad + half_rad)
        self.high_rad = min(max(self.high_rad, reported_rad - half_rad), reported_rad + half_rad)

    def at(self, reported_rad: float) -> tuple[float, float]:
        """Return where the motor was when it last dragged the optics along, and towards which reports that was.

        It may have come back a little since, which the play swallows. 0 where it is not known.
        """
        for travel in (1.0, -1.0):
            dragged_rad = self.low_rad + travel * 0.5 * _WIDEST_PLAY_RAD
            back_rad = travel * (dragged_rad - reported_rad)
            if self.high_rad - self.low_rad < 1e-9 and -STILL_RAD < back_rad < _SWALLOWED_RAD:
                return dragged_rad, travel
        return reported_rad, 0.0
