"""What camrig makes of it: where cameras were, what they saw, where targets are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from camrig.geometry.arrays import Array, Transform


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Where a camera was at ``stamp_s``; covariance (6, 6) in the convention of geometry.pose."""

    camera_id: str
    stamp_s: float
    T_world_camera: Transform
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One body seen by one camera at one instant.

    ``covariance`` (6, 6) is of the corner noise, new in every frame; ``camera_covariance`` (6, 6) is what the
    camera's pose adds, shared by many frames, never to be averaged away. ``quality_m`` is the paper's Q.
    """

    target_id: str
    camera_id: str
    stamp_s: float
    T_world_body: Transform
    covariance: Array
    camera_covariance: Array
    quality_m: float
    tags: int


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How a body moves as far as is known: ``T_world_body`` at ``stamp_s`` (None = not known where), velocity (3,) with
    its (3, 3) covariance, the density (3,) of its acceleration in m2/s3, the variance (3,) that each second adds to
    its orientation, by world axis, and how fast its way and its heading turn together about the vertical, with the
    variance of that.
    """

    stamp_s: float
    T_world_body: Transform | None
    velocity_m_s: Array
    velocity_covariance: Array
    acceleration_m2_s3: Array
    turn_rad2_s: Array
    turn_rate_rad_s: float = 0.0
    turn_rate_rad2_s2: float = 0.0

    def shift_m(self, dt_s: float) -> Array:
        """Return by what (3,) it is further on ``dt_s`` later or, negative, earlier."""
        vx, vy, vz = self.velocity_m_s
        bend = 0.5 * self.turn_rate_rad_s * dt_s
        return np.array([vx - bend * vy, vy + bend * vx, vz]) * dt_s

    def turn_rad(self, dt_s: float) -> Array:
        """Return the rotation vector (3,) by which it has turned on meanwhile."""
        return np.array([0.0, 0.0, self.turn_rate_rad_s * dt_s])

    def spread(self, dt_s: float) -> Array:
        """Return the (6, 6) covariance (geometry.pose) of its pose ``dt_s`` later or earlier, given what it is now."""
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = self.velocity_covariance * dt_s**2 + np.diag(self.acceleration_m2_s3) * abs(dt_s) ** 3 / 3
        covariance[3:, 3:] = np.diag(self.turn_rad2_s) * abs(dt_s)
        covariance[5, 5] += self.turn_rate_rad2_s2 * dt_s**2
        return covariance


@dataclass(frozen=True, slots=True)
class Seen:
    """By which camera, when, and with which of the paper's Q a body was seen."""

    camera_id: str
    stamp_s: float
    quality_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """Where a body was at ``stamp_s`` by what one or more cameras saw of it: what tracks are made of.

    ``covariance`` (6, 6) is of the corner noise alone. What every camera adds with errors that stay (its pose, its
    lens) are k factors: ``factors`` (k, 6, 10) times unit normal numbers, one row for each of ``sources``.
    """

    target_id: str
    stamp_s: float
    T_world_body: Transform
    covariance: Array
    sources: tuple[str, ...]
    factors: Array
    seen: tuple[Seen, ...]

    @property
    def order(self) -> tuple[float, tuple[str, ...]]:
        """Its place among the fixes of its body."""
        return self.stamp_s, tuple(sorted(each.camera_id for each in self.seen))

    @property
    def whole(self) -> Array:
        """The (6, 6) covariance of all its errors."""
        return np.asarray(self.covariance + (self.factors @ self.factors.swapaxes(1, 2)).sum(axis=0))


class TargetStatus(StrEnum):
    """How well a target is known now."""

    TRACKED = "tracked"
    LOST = "lost"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A target as published: position (3,) m, velocity (3,) m/s, covariance (3, 3) m2 at ``stamp_s``.

    Achieved against predicted: ``planned_covariance_m2`` (3, 3) is what the plan in force promised from one picture of
    each camera (None: it does not cover the target); ``innovation`` the mean of the last fixes' squared Mahalanobis
    distances from where they were predicted, by degree of freedom: 1 expected, less where errors stay the same.
    """

    id: str
    stamp_s: float
    status: TargetStatus
    position_m: Array
    velocity_m_s: Array
    covariance_m2: Array
    R_world_body: Array
    seen_by: tuple[str, ...]
    last_seen_s: float
    quality_m: float | None = None
    innovation: float | None = None
    planned_covariance_m2: Array | None = None

    @property
    def planned_sigma_m(self) -> list[float] | None:
        """One sigma by axis that the plan promised."""
        if self.planned_covariance_m2 is None:
            return None
        return [round(float(value), 6) for value in np.sqrt(np.diag(self.planned_covariance_m2))]
