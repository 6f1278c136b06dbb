"""An operator's aim of one head, for as long as it stands: when the head is to be told, and told again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from camrig.geometry.rotation import wrap_angle
from camrig.messages import AxisReading, HeadAim

ARRIVED_RAD = math.radians(0.3)
TELL_AGAIN_S = 2.0
TELLS = 5
"""How often a head is told at most: one that cannot come there is not urged for ever."""


@dataclass
class StandingAim:
    """Used by the head's worker; ``aim`` may be read by any thread."""

    aim: HeadAim
    _tells_left: int = TELLS
    _told_s: float | None = None
    """The stamp of the first reading after it was told last."""

    @property
    def untold(self) -> bool:
        """Whether the head is to be told for the first time."""
        return self._tells_left == TELLS

    def told(self) -> None:
        """Note that the head was told."""
        self._tells_left -= 1
        self._told_s = None

    def give_up(self) -> None:
        """Never tell the head again: its link was lost, and nothing is replayed."""
        self._tells_left = 0

    def due(self, readings: Sequence[AxisReading]) -> bool:
        """Tell whether the head, by its newest readings, has not come there in a while and is to be told again."""
        if not readings:
            return False
        stamp_s = readings[-1].stamp_s
        if self._told_s is None:
            self._told_s = stamp_s
        late = self._tells_left > 0 and stamp_s >= self._told_s + TELL_AGAIN_S
        return late and not all(self._near(reading) for reading in readings)

    def _near(self, reading: AxisReading) -> bool:
        wanted_rad = self.aim.pan_rad if reading.axis == "pan" else self.aim.tilt_rad
        return abs(wrap_angle(reading.angle_rad - wanted_rad)) <= ARRIVED_RAD
