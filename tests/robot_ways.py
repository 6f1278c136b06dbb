"""How drawn robots drive about: round a stadium, with stops if wanted, or as a model of their motion has it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from camrig.fuse.settings import MotionModel
from camrig.geometry.arrays import Array

ROBOT_M_S = 0.5
STRAIGHT_M, RADIUS_M = 1.6, 0.5
CRUISE_S, REST_S, BRAKE_S = 1.25, 1.25, 0.25


def on_stadium(way_m: float) -> tuple[float, float, float]:
    """Return place and heading after so many metres of a stadium's edge, its middle being the origin."""
    half_m, arc_m = STRAIGHT_M / 2.0, math.pi * RADIUS_M
    turn, way_m = divmod(way_m, STRAIGHT_M + arc_m)
    if way_m < STRAIGHT_M:
        x, y, heading = way_m - half_m, -RADIUS_M, 0.0
    else:
        heading = (way_m - STRAIGHT_M) / RADIUS_M
        x, y = half_m + RADIUS_M * math.sin(heading), -RADIUS_M * math.cos(heading)
    return (x, y, heading) if turn % 2 == 0 else (-x, -y, heading + math.pi)


def with_stops(now_s: float) -> float:
    """Return how far a robot has driven that starts in a quarter of a second, drives for one and a quarter, brakes in a
    quarter and stands for one and a quarter.
    """
    rounds, t = divmod(now_s, CRUISE_S + REST_S + 2.0 * BRAKE_S)
    full_m, a = ROBOT_M_S * (CRUISE_S + BRAKE_S), ROBOT_M_S / BRAKE_S
    start_s, left_s = min(t, BRAKE_S), CRUISE_S + 2.0 * BRAKE_S - t
    driven_m = 0.5 * a * start_s**2 + ROBOT_M_S * max(0.0, t - BRAKE_S)
    if left_s < BRAKE_S:
        driven_m = full_m - 0.5 * a * max(0.0, left_s) ** 2
    return rounds * full_m + driven_m


class Wandering:
    """A way that is drawn from a model's own processes, of velocity, turning and height; at its middle it is 0, 0.

    Swerves make it ever faster, where the model has them undo each other: at times it leads out of the room.
    """

    STEP_S = 0.005

    def __init__(self, model: MotionModel, seconds: float, rng: np.random.Generator) -> None:
        n = int(seconds / self.STEP_S) + 2
        velocity = self._process(model.velocity_sigma_m_s[:2], model.memory_s, n, rng, self._density(model, n, rng))
        turned = np.cumsum(self._process([model.turn_sigma_rad_s], model.turn_memory_s, n, rng)[:, 0]) * self.STEP_S
        c, s = np.cos(turned), np.sin(turned)
        x, y = velocity.T
        place = np.cumsum(np.stack([c * x - s * y, s * x + c * y], axis=1), axis=0) * self.STEP_S
        self.place = place - place[n // 2]
        self.heading = turned + np.cumsum(rng.normal(size=n)) * math.sqrt(model.turn_rad2_s * self.STEP_S)
        self.height = np.cumsum(rng.normal(size=n)) * math.sqrt(model.walk_m2_s[2] * self.STEP_S)

    def _density(self, model: MotionModel, n: int, rng: np.random.Generator) -> Array:
        """Return the density (n, 1) of the acceleration, as a multiple of what it is where nothing swerves."""
        swerves, changed = np.empty(n, dtype=bool), rng.uniform(size=n)
        swerves[0] = changed[0] < model.often[-1]
        for k in range(1, n):
            lasts_s = model.swerve_s if swerves[k - 1] else model.calm_s
            swerves[k] = swerves[k - 1] ^ (changed[k] < self.STEP_S / lasts_s)
        calm = np.maximum(model.density_m2_s3[:2], 1e-12)
        return 1.0 + swerves[:, None] * (model.swerve_density_m2_s3[:2] / calm)

    def _process(
        self,
        sigma: Sequence[float],
        memory_s: float,
        n: int,
        rng: np.random.Generator,
        density: Array | float = 1.0,
    ) -> Array:
        """Return n steps of Ornstein-Uhlenbeck processes (n, k)."""
        keep = math.exp(-self.STEP_S / memory_s)
        found = rng.normal(size=(n, len(sigma))) * sigma
        found[1:] *= np.sqrt((1.0 - keep * keep) * np.broadcast_to(density, found.shape)[1:])
        for k in range(1, n):
            found[k] += keep * found[k - 1]
        return found

    def at(self, now_s: float) -> tuple[float, float, float, float]:
        """Return place, height and heading."""
        k, walks = now_s / self.STEP_S, (*self.place.T, self.height, self.heading)
        x, y, z, heading = (float(np.interp(k, np.arange(len(walk)), walk)) for walk in walks)
        return x, y, z, heading
