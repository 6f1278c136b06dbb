"""The time between a camera's stamps and its head's reports, learnt from anchors while the head moves. Pure.

A frame stamped ``t`` shows the head where its reports have it at ``t + offset``. While an axis turns at a rate w, the
angle that anchors show differs from the reported one by w * offset; at rest by the axis's bias alone. Both are the
state of a Kalman filter: [offset, pan bias, tilt bias]. Heads whose reports lag, cameras whose stamps do, and drivers
that think otherwise all come out in the one number that matters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.rotation import wrap_angle
from camrig.messages import AxisReading

PRIOR_S = 0.005
"""One sigma of the offset before anything is learnt: drivers stamp as well as they can."""
MOST_S = 0.25
"""Further apart no driver's stamps are: beyond it something else is wrong."""
_WALK_S2_S = 0.001**2 / 60.0
"""The offset drifts by a millisecond in a minute."""
_BIAS_RAD = math.radians(0.3)
_BIAS_WALK_RAD2_S = math.radians(0.03) ** 2
"""An axis's bias before anything is learnt, and by what it changes in a second: play, and where on its way it is."""
_REPEATING = 4.0
"""Neighbouring frames hang on the same readings: each counts for a quarter."""
_SLOW_RAD_S = math.radians(2.0)
"""Slower the reports' own noise may look like a motion, and that motion tells nothing of the offset."""
_GATE = 5.0
"""An angle further from what is expected, in sigmas, tells that less is known than was thought."""


@dataclass(frozen=True, slots=True, eq=False)
class TimeOffset:
    """What is known of one camera on a head: [offset_s, pan bias, tilt bias] and its (3, 3) covariance."""

    stamp_s: float
    mean: Array
    covariance: Array

    @property
    def offset_s(self) -> float:
        """By how much later the head's reports have it where a frame shows it."""
        return float(self.mean[0])

    @property
    def sigma_s(self) -> float:
        """One sigma of it."""
        return math.sqrt(float(self.covariance[0, 0]))


def begin() -> TimeOffset:
    """Return what is known before any anchor was seen."""
    return TimeOffset(-math.inf, np.zeros(3), np.diag([PRIOR_S**2, _BIAS_RAD**2, _BIAS_RAD**2]))


def learn(
    offset: TimeOffset, shown: Sequence[AxisReading], told_rad: Array, variance: Array, rate_rad_s: Array
) -> TimeOffset:
    """Return the offset after one frame's pan and tilt by anchors (``shown``, as ``head_angles`` returns them).

    ``told_rad`` (2,) is where the head's reports have it at the frame's stamp plus the offset known so far,
    ``variance`` (2,) of that between its readings, ``rate_rad_s`` (2,) how fast it turned. A frame older than the
    newest one used changes nothing.
    """
    dt_s = max(shown[0].stamp_s - offset.stamp_s, 0.0) if math.isfinite(offset.stamp_s) else 0.0
    if shown[0].stamp_s < offset.stamp_s:
        return offset
    mean, P = offset.mean.copy(), offset.covariance + dt_s * np.diag([_WALK_S2_S, _BIAS_WALK_RAD2_S, _BIAS_WALK_RAD2_S])
    turning = np.where(np.abs(rate_rad_s) < _SLOW_RAD_S, 0.0, rate_rad_s)
    for axis, reading in enumerate(shown):
        H = np.zeros(3)
        # The frame was at told + rate * (true offset - offset known so far) + bias.
        H[0], H[1 + axis] = turning[axis], 1.0
        expected = told_rad[axis] + mean[1 + axis] + turning[axis] * (mean[0] - offset.mean[0])
        S = float(H @ P @ H) + _REPEATING * (reading.sigma_rad**2 + float(variance[axis]))
        innovation = wrap_angle(reading.angle_rad - expected)
        if (beyond := innovation**2 / (_GATE**2 * S)) > 1.0:
            P *= beyond
            S *= beyond
        K = P @ H / S
        mean = mean + K * innovation
        P = P - np.outer(K, H @ P)
    mean[0] = min(max(float(mean[0]), -MOST_S), MOST_S)
    return replace(offset, stamp_s=shown[0].stamp_s, mean=mean, covariance=0.5 * (P + P.T))
