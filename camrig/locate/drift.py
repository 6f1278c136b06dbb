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
_LEAST_LEFT = 0.9
"""A frame that leaves more than this part of the variance of where a camera looks has told nothing of it; one that is
placed against its carrier, by anchors alone, may leave more than all of it.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """The mean (6,) of [dx dy dz rx ry rz] by which a camera was corrected, in the world (geometry.pose), since
    ``since_s``, and the mean (6, 6) of what its calibration and readings allow; ``chi2`` is the squared Mahalanobis
    distance of the one under the other.
    """

    since_s: float
    stamp_s: float
    mean: Array
    covariance: Array

    @property
    def chi2(self) -> float:
        """The squared Mahalanobis distance of the mean correction."""
        return float(self.mean @ np.linalg.solve(self.covariance, self.mean))

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


def with_correction(before: Drift | None, carried: CameraPose, found: CameraPose) -> Drift | None:
    """Return the drift after a frame that ``carried`` alone, and everything together, places so.

    A frame in which nothing but the carrier told where the camera was leaves it as it is. Errors of a head's angles
    turn with the head, so what they allow is averaged as the corrections are.
    """
    if _LEAST_LEFT < np.trace(found.covariance[3:, 3:]) / np.trace(carried.covariance[3:, 3:]) <= 1.0 + 1e-9:
        return before
    correction = difference(found.T_world_camera, carried.T_world_camera)
    if before is None or found.stamp_s - before.stamp_s > MEMORY_S:
        before = Drift(found.stamp_s, found.stamp_s, correction, carried.covariance)
    share = -math.expm1(-max(found.stamp_s - before.stamp_s, 0.0) / MEMORY_S)
    mean = before.mean + share * (correction - before.mean)
    covariance = before.covariance + share * (carried.covariance - before.covariance)
    return Drift(before.since_s, max(found.stamp_s, before.stamp_s), mean, covariance)
