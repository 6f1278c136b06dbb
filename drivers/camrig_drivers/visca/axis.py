"""One axis of a VISCA head: between its counts and our radians, within its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from camrig.rig import Interval
from camrig_drivers.limits import check_within
from camrig_drivers.visca.section import ViscaAxisSection

_ROUNDING_COUNTS = 1e-6


@dataclass(frozen=True, slots=True)
class AxisScale:
    """How one axis counts."""

    name: Literal["pan", "tilt"]
    section: ViscaAxisSection
    limits_rad: Interval
    readback_sigma_deg: float

    def count(self, angle_rad: float) -> int:
        """Return the count nearest to an angle that is not beyond a limit; raises InputError outside (or for NaN)."""
        check_within(self.name, angle_rad, self.limits_rad)
        ends = sorted(map(self._counts, self.limits_rad))
        lowest, highest = math.ceil(ends[0] - _ROUNDING_COUNTS), math.floor(ends[1] + _ROUNDING_COUNTS)
        return min(max(round(self._counts(angle_rad)), lowest), highest)

    def angle_rad(self, count: int) -> float:
        """Return the angle of a reported count."""
        return math.radians(self.section.sign * self.section.deg_per_count * count + self.section.offset_deg)

    @property
    def sigma_rad(self) -> float:
        """One sigma of a report: its last digit and the play are uniform, so their width over sqrt(12) counts."""
        return math.hypot(self.noise_rad, math.radians(self.section.backlash_deg) / math.sqrt(12.0))

    @property
    def noise_rad(self) -> float:
        """One sigma of what of that is another for each report: all but the play."""
        digit_deg = self.section.deg_per_count / math.sqrt(12.0)
        return math.radians(math.hypot(digit_deg, self.readback_sigma_deg))

    def _counts(self, angle_rad: float) -> float:
        return (math.degrees(angle_rad) - self.section.offset_deg) / (self.section.sign * self.section.deg_per_count)
