"""How far a camera is from where its calibration and its head's reports put it, by all else there is. Pure.

Anchors, and the bodies that other cameras see too, correct a camera in every frame. By how much is remembered: what is
new in each frame averages out, a camera that was knocked, a head that lost its zero or a mount measured wrong stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.pose import difference
from camrig.messages import CameraPose

MEMORY_S = 20.0
"""The mean is over about so long, and says nothing before."""
GATE_CHI2 = 27.9
"""chi2 of 6 numbers that chance exceeds once in 10 000: a camera further off is not where its calibration says."""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """The mean (6,) of [dx dy dz rx ry rz] by which a camera was corrected, in the world (geometry.pose), since
    ``since_s``; ``chi2`` is its squared Mahalanobis distance under what its calibration and readings allow.
    """

    since_s: float
    stamp_s: float
    mean: Array
    chi2: float

    @property
    def alarming(self) -> bool:
        """Whether the camera is not where its calibration says."""
        return self.stamp_s - self.since_s >= MEMORY_S and self.chi2 > GATE_CHI2

    @property
    def turned_rad(self) -> float:
        """By which angle it looks elsewhere."""
        return float(np.linalg.norm(self.mean[3:]))

    @property
    def moved_m(self) -> float:
        """By how much it stands elsewhere."""
        return float(np.linalg.norm(self.mean[:3]))


def with_correction(before: Drift | None, carried: CameraPose, found: CameraPose) -> Drift:
    """Return the drift after a frame that ``carried`` alone, and everything together, places so."""
    correction = difference(found.T_world_camera, carried.T_world_camera)
    if before is None or found.stamp_s - before.stamp_s > MEMORY_S:
        before = Drift(found.stamp_s, found.stamp_s, correction, 0.0)
    share = -math.expm1(-max(found.stamp_s - before.stamp_s, 0.0) / MEMORY_S)
    mean = before.mean + share * (correction - before.mean)
    chi2 = float(mean @ np.linalg.solve(carried.covariance, mean))
    return Drift(before.since_s, max(found.stamp_s, before.stamp_s), mean, chi2)
