"""How targets move, and when a track is born, doubted and lost."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np

from camrig.geometry.arrays import Array

Estimator = Literal["joint", "covariance", "quality", "mean"]

SWERVES_S = 0.7
"""Swerves of a longer time undo each other, and only those at its beginning and its end count: nothing becomes faster
and faster by them.
"""


@dataclass(frozen=True, slots=True, eq=False)
class MotionModel:
    """A velocity that is constant for about ``memory_s`` and then forgotten, by axis (x, y, z).

    While it is calm, velocity is an Ornstein-Uhlenbeck process of standard deviation ``velocity_sigma_m_s``: over short
    times white acceleration of density 2 sigma^2 / memory, over long ones a walk, so a lost target's covariance grows
    with time and not with its cube. ``walk_m2_s`` is added to the position's variance each second, ``turn_rad2_s`` to
    the orientation's. Where ``turn_sigma_rad_s`` is given, its way turns as its heading does, at a rate that is such a
    process too, of a memory of ``turn_memory_s``: what drives, drives on along its arc.

    Once in ``calm_s`` it swerves, brakes or starts, for about ``swerve_s`` (both exponential): its acceleration then
    has the density ``swerve_m2_s3`` more on every axis on which it has a velocity.
    """

    velocity_sigma_m_s: tuple[float, float, float]
    walk_m2_s: tuple[float, float, float]
    turn_rad2_s: float
    memory_s: float = 10.0
    turn_sigma_rad_s: float = 0.0
    turn_memory_s: float = 2.0
    swerve_m2_s3: float = 0.0
    calm_s: float = 1.6
    swerve_s: float = 0.4

    def step(self, dt_s: float) -> tuple[Array, Array, Array]:
        """Return the (6, 6) transition over ``dt_s`` > 0 for [position, velocity], the process noise (n, 6, 6) where it
        is calm before and after and, if it ever does, where it swerves all the while, ``SWERVES_S`` at the most; and
        with which probability (n, n) one mode has become another by then.
        """
        return _step(self, dt_s)

    @property
    def often(self) -> Array:
        """Which part of the time it is in each mode, (n,)."""
        if self.swerve_m2_s3 == 0.0:
            return np.ones(1)
        return np.array([self.calm_s, self.swerve_s]) / (self.calm_s + self.swerve_s)

    @property
    def density_m2_s3(self) -> Array:
        """The density (3,) of its acceleration while it is calm."""
        return _beforehand(self)[0]

    @property
    def swerve_density_m2_s3(self) -> Array:
        """The density (3,) that comes to it while it swerves."""
        return _beforehand(self)[1]

    @property
    def velocity_covariance(self) -> Array:
        """The (3, 3) covariance of its velocity where nothing is known of it."""
        return _beforehand(self)[2]


@lru_cache(maxsize=64)
def _beforehand(model: MotionModel) -> tuple[Array, Array, Array]:
    """Return the densities and the velocity's covariance: all targets of one frame ask for the same."""
    variance = np.square(model.velocity_sigma_m_s)
    swerve = np.where(variance > 0.0, model.swerve_m2_s3, 0.0)
    found = 2.0 * variance / model.memory_s, swerve, np.diag(variance + SWERVES_S * model.often[-1] * swerve)
    for part in found:
        part.flags.writeable = False
    return found


@lru_cache(maxsize=64)
def _step(model: MotionModel, dt_s: float) -> tuple[Array, Array, Array]:
    """Return transition, noises and changes of mode; kept, as the densities are."""
    F, Q = _transition(model.memory_s, dt_s), _noise(model.density_m2_s3, model.memory_s, dt_s)
    Q[range(3), range(3)] += np.multiply(model.walk_m2_s, dt_s)
    noises, often = [Q], model.often
    x = (1.0 / model.calm_s + 1.0 / model.swerve_s) * dt_s
    becomes = math.exp(-x) * np.eye(len(often)) - math.expm1(-x) * often
    if model.swerve_m2_s3 > 0.0:
        half_s = 0.5 * min(dt_s, SWERVES_S)
        half = _noise(model.swerve_density_m2_s3, model.memory_s, half_s)
        on = _transition(model.memory_s, dt_s - half_s)
        swerve = on @ half @ on.T + half  # at its beginning and its end
        noises = [Q + _between(model, dt_s) * swerve, Q + swerve]
    found = F, np.stack(noises), becomes
    for part in found:
        part.flags.writeable = False
    return found


def _between(model: MotionModel, dt_s: float) -> float:
    """Return for which part of a time what is calm before and after has swerved in between, one swerve being unlikely
    to have come and gone in less than half of ``SWERVES_S``.
    """
    calm, swerves = model.often
    x = (1.0 / model.calm_s + 1.0 / model.swerve_s) * max(dt_s - 0.5 * SWERVES_S, 1e-9)
    return float(calm * swerves * (1.0 + 2.0 * math.expm1(-x) / x + math.exp(-x)) / (calm + swerves * math.exp(-x)))


def _transition(memory_s: float, dt_s: float) -> Array:
    F = np.eye(6)
    F[:3, 3:] = -memory_s * math.expm1(-dt_s / memory_s) * np.eye(3)
    F[3:, 3:] = math.exp(-dt_s / memory_s) * np.eye(3)
    return F


def _noise(density: Array, memory_s: float, dt_s: float) -> Array:
    """Return the covariance (6, 6) that white acceleration of a density (3,) leaves of [position, velocity]."""
    a = dt_s / memory_s
    keep, variance, axes = math.exp(-a), 0.5 * memory_s * density, np.arange(3)
    # 2a - 3 + 4 e^-a - e^-2a; its series where the terms cancel
    spread = 2.0 * a**3 / 3.0 * (1.0 - 0.75 * a) if a < 1e-3 else 2.0 * a - 3.0 + 4.0 * keep - keep * keep
    Q = np.zeros((6, 6))
    Q[axes, axes] = variance * memory_s**2 * spread
    Q[axes, axes + 3] = Q[axes + 3, axes] = variance * memory_s * math.expm1(-a) ** 2
    Q[axes + 3, axes + 3] = -variance * math.expm1(-2.0 * a)
    return Q


SWERVE_M2_S3 = 0.8
"""Of a robot that brakes or starts at 2 m/s2 no position is past five sigma, from 15 fixes a second on (ADR 18)."""

FLOOR = MotionModel((0.1, 0.1, 0.0), (0.0, 0.0, 1e-6), 0.5, 20.0, swerve_m2_s3=SWERVE_M2_S3)
"""In the plane, as it likes: its height walks a millimetre in a second."""

DRIVES = MotionModel((0.1, 0.1, 0.0), (0.0, 0.0, 1e-6), 0.001, 20.0, turn_sigma_rad_s=1.0, swerve_m2_s3=SWERVE_M2_S3)
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
