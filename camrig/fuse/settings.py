"""How targets move, and when a track is born, doubted and lost."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np

from camrig.geometry.arrays import Array

Estimator = Literal["joint", "covariance", "quality", "mean"]


@dataclass(frozen=True, slots=True, eq=False)
class MotionModel:
    """A velocity that is constant for about ``memory_s`` and then forgotten, by axis (x, y, z).

    Velocity is an Ornstein-Uhlenbeck process of standard deviation ``velocity_sigma_m_s``: over short times white
    acceleration of density 2 sigma^2 / memory, over long ones a walk, so a lost target's covariance grows with time
    and not with its cube. ``walk_m2_s`` is added to the position's variance each second, ``turn_rad2_s`` to the
    orientation's. Where ``turn_sigma_rad_s`` is given, its way turns as its heading does, at a rate that is such a
    process too, of a memory of ``turn_memory_s``: what drives, drives on along its arc.
    """

    velocity_sigma_m_s: tuple[float, float, float]
    walk_m2_s: tuple[float, float, float]
    turn_rad2_s: float
    memory_s: float = 10.0
    turn_sigma_rad_s: float = 0.0
    turn_memory_s: float = 2.0

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Return the (6, 6) transition and process noise over ``dt_s`` >= 0 for [position, velocity]."""
        return _step(self, dt_s)


@lru_cache(maxsize=64)
def _step(model: MotionModel, dt_s: float) -> tuple[Array, Array]:
    """Return them; all targets of one frame ask for the same."""
    a = dt_s / model.memory_s
    keep = np.exp(-a)
    carry = -model.memory_s * np.expm1(-a)
    variance = np.square(model.velocity_sigma_m_s)
    F = np.eye(6)
    F[:3, 3:] = carry * np.eye(3)
    F[3:, 3:] = keep * np.eye(3)
    Q = np.zeros((6, 6))
    # 2a - 3 + 4 e^-a - e^-2a; its series where the terms cancel
    spread = 2.0 * a**3 / 3.0 * (1.0 - 0.75 * a) if a < 1e-3 else 2.0 * a - 3.0 + 4.0 * keep - keep * keep
    axes = np.arange(3)
    Q[axes, axes] = variance * model.memory_s**2 * spread + np.multiply(model.walk_m2_s, dt_s)
    Q[axes, axes + 3] = Q[axes + 3, axes] = variance * carry**2 / model.memory_s
    Q[axes + 3, axes + 3] = -variance * np.expm1(-2.0 * a)
    F.flags.writeable = Q.flags.writeable = False
    return F, Q


FLOOR = MotionModel((0.25, 0.25, 0.0), (0.0, 0.0, 1e-6), 0.5, 20.0)
"""In the plane, as it likes: its height walks a millimetre in a second.

The acceleration's density, 0.006 m2/s3, is on the safe side of the best for five robots at 0.1 to 0.4 m/s, eight frames
a second and camera (25 s of the simulated room, seeds 1 and 2): mean error 3.5 mm and NEES 0.9, with 0.018 3.95 mm and
0.5, with 0.002 3.1 mm and 1.6, but then now and then five sigma off where one turns.
"""

DRIVES = MotionModel((0.25, 0.25, 0.0), (0.0, 0.0, 1e-6), 0.001, 30.0, turn_sigma_rad_s=1.0)
"""In the plane, its way turning with its heading; docs/accuracy.md has what that is worth."""

FREE = MotionModel((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), 2.0)

STATIC = MotionModel((0.0, 0.0, 0.0), (1e-8, 1e-8, 1e-8), 1e-6)
"""A tenth of a millimetre in a second, so that it may still be found wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """What ``fuse.update`` and ``fuse.targets_at`` go by."""

    estimator: Estimator = "joint"
    """``joint``: all corners of all cameras at once, the cameras' poses and lenses estimated along. The others fuse the
    poses that single cameras find: ``covariance`` by what each is worth, ``quality`` by 1/Q^2 and ``mean`` alike, both
    as the paper does; published covariances stay honest under them.
    """

    models: dict[str, MotionModel] = field(
        default_factory=lambda: {"floor": FLOOR, "drives": DRIVES, "free": FREE, "static": STATIC}
    )
    equal_sigma_m: float = 0.01
    """What a single camera's pose is taken for by ``mean``."""

    repeating: float = 0.8
    """The part of a sighting's corner variance that counts as the camera's own: pixel phase and the bend of edges come
    again in the next frame. Of a detector's corners only about 0.02 px of noise is new; of refined ones a third to two
    thirds of the law's variance (geometry.corner_noise), which errs on the safe side.
    """

    late_s: float = 0.7
    """Sightings may arrive this much after newer ones; later they are dropped and reported."""

    gate_chi2: float = 21.1
    """Squared Mahalanobis distance (3 numbers) that chance exceeds once in 10 000."""

    sure_sigma_m: float = 0.05
    """A first sighting at least this good confirms a track by itself; any other waits for a second that agrees."""

    restart_after: int = 3
    """So many sightings in a row that agree with each other and not with the track: the target was moved."""

    lost_after_s: float = 1.0
    """Unseen for longer a target is lost; one not confirmed by then is forgotten."""

    seen_within_s: float = 1.0
    """Cameras that saw a target within this time count as seeing it."""


DEFAULTS = Settings()
