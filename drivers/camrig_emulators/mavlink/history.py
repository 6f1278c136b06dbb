"""What the emulated drone did in the last seconds: the truth at any stamp, and what telemetry says of it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig_emulators.mavlink.dynamics import Airframe, Motion
from camrig_emulators.mavlink.frames import turn

STEP_S = 0.01
_KEPT_S = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One step: how the body truly moved, and the estimator's errors (``Airframe``'s) at that instant."""

    stamp_s: float
    truth: Motion
    position_error_m: Array
    velocity_error_m_s: Array
    attitude_error_rad: Array

    @property
    def position_m(self) -> Array:
        """(3,) estimated, in the world."""
        return np.asarray(self.truth.position_m + self.position_error_m)

    @property
    def velocity_m_s(self) -> Array:
        """(3,) estimated, in the world."""
        return np.asarray(self.truth.velocity_m_s + self.velocity_error_m_s)

    @property
    def R_world_body(self) -> Array:
        """(3, 3) estimated attitude."""
        return np.asarray(turn(self.attitude_error_rad) @ self.truth.T_world_body()[:3, :3])


class History:
    """Samples every ``STEP_S`` from ``start_s`` on, of which the last 20 s are kept."""

    def __init__(self, start_s: float, airframe: Airframe) -> None:
        self.start_s = start_s
        self._airframe = airframe
        self._count = 0
        self._samples: deque[Sample] = deque(maxlen=round(_KEPT_S / STEP_S))
        self.append()

    @property
    def latest(self) -> Sample:
        """The newest sample."""
        return self._samples[-1]

    @property
    def next_stamp_s(self) -> float:
        """The stamp of the sample that ``append`` takes next."""
        return self.start_s + self._count * STEP_S

    def append(self) -> None:
        """Sample the airframe."""
        body = self._airframe
        errors = (body.position_error_m, body.velocity_error_m_s, body.attitude_error_rad)
        self._samples.append(Sample(self.next_stamp_s, body.truth, *errors))
        self._count += 1

    def before(self, stamp_s: float) -> tuple[Sample, Sample]:
        """Return the newest sample not after ``stamp_s`` and its predecessor, as far back as there are any."""
        index = self._index(stamp_s)
        return self._samples[index], self._samples[max(0, index - 1)]

    def truth(self, stamp_s: float) -> Motion:
        """Return the true motion at a stamp between two samples; before the start it stood still.

        Raises ValueError for a stamp that is no longer kept, or not reached yet.
        """
        if stamp_s > self.latest.stamp_s:
            raise ValueError(
                f"the emulated drone has not reached {stamp_s:.3f} s yet (now {self.latest.stamp_s:.3f} s)"
            )
        oldest = self._samples[0]
        if stamp_s < oldest.stamp_s:
            if oldest.stamp_s > self.start_s:
                raise ValueError(f"the truth at {stamp_s:.3f} s is gone: kept since {oldest.stamp_s:.3f} s")
            return oldest.truth
        index = min(self._index(stamp_s), len(self._samples) - 2)
        if index < 0:
            return oldest.truth
        earlier, later = self._samples[index], self._samples[index + 1]
        return _blend(earlier.truth, later.truth, (stamp_s - earlier.stamp_s) / (later.stamp_s - earlier.stamp_s))

    def _index(self, stamp_s: float) -> int:
        first = self._count - len(self._samples)
        index = math.floor((stamp_s - self.start_s) / STEP_S + 1e-6) - first
        return max(0, min(len(self._samples) - 1, index))


def _blend(a: Motion, b: Motion, part: float) -> Motion:
    def mix(x: Array, y: Array) -> Array:
        return np.asarray(x + part * (y - x))

    return Motion(
        mix(a.position_m, b.position_m),
        mix(a.velocity_m_s, b.velocity_m_s),
        mix(a.acceleration_m_s2, b.acceleration_m_s2),
        a.yaw_rad + part * (b.yaw_rad - a.yaw_rad),
        a.yaw_rate_rad_s + part * (b.yaw_rate_rad_s - a.yaw_rate_rad_s),
    )
