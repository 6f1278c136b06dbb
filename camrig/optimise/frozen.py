"""The smooth problem beside a configuration: what each camera sees now it must go on seeing; nothing else counts.

Derivatives are central differences of the vectorised evaluation, all steps of a camera in one call.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import fmin_slsqp

from camrig import sensing
from camrig.geometry.arrays import Array
from camrig.optimise.places import bounds, camera_poses
from camrig.optimise.sight import Problem, alpha_rad
from camrig.sensing.visibility import Flags

_STEP = 1e-6
_EDGE_SHARE = 0.15
"""Edges of an image farther away than this share of its size cannot become active within one polish."""

_INSIDE = 1e-9
"""How far inside its limits the smooth problem stays, so that the hard visibility agrees."""


@dataclass(eq=False)
class FrozenProblem:
    """Objective (in mm), constraints (>= 0, dimensionless) and their gradients over all free variables together."""

    problem: Problem
    start: Array
    slices: tuple[slice, ...]
    seen: Flags
    active: tuple[Flags, ...]
    """For each camera the clearances of ``_clearances`` that are kept."""
    pairs: tuple[tuple[int, int, float], ...]
    _cache: tuple[bytes, tuple[float, Array, Array, Array]] | None = field(default=None, init=False)

    @classmethod
    def at(cls, problem: Problem, vectors: tuple[Array, ...], seen: Flags, separation_m: Array) -> FrozenProblem:
        """Freeze the pattern ``seen`` (n, m) at a configuration."""
        ends = np.cumsum([0, *(x.size for x in vectors)])
        slices = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        near = [_clearances(problem, i, vectors[i][None], seen[i])[0] < _EDGE_SHARE for i in range(len(vectors))]
        active = [flags if vectors[i].size else np.zeros_like(flags) for i, flags in enumerate(near)]
        pairs = tuple((int(i), int(j), float(separation_m[i, j])) for i, j in np.argwhere(np.triu(separation_m) > 0.0))
        return cls(problem, np.concatenate(vectors), slices, seen, tuple(active), pairs)

    @property
    def size(self) -> int:
        """The number of free variables; 0 too where nothing is seen."""
        return self.start.size if self.seen.any() else 0

    @property
    def bound(self) -> bool:
        """Whether anything but the limits constrains it."""
        return bool(self.pairs) or any(flags.any() for flags in self.active)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """The limits of every variable."""
        limits = [bounds(camera.place) for camera in self.problem.cameras]
        return [(float(a), float(b)) for low, high in limits for a, b in zip(low, high, strict=True)]

    def vectors(self, x: Array) -> tuple[Array, ...]:
        """Split the joint variables by camera, inside their bounds."""
        inside = np.clip(x, *np.array(self.bounds).T)
        return tuple(inside[part] for part in self.slices)

    def solve(self, most_iterations: int) -> Array:
        """Return the joint variables that SLSQP reaches from the start."""
        return np.asarray(
            fmin_slsqp(
                lambda x: self._evaluate(x)[0],
                self.start,
                fprime=lambda x: self._evaluate(x)[1],
                f_ieqcons=(lambda x: self._evaluate(x)[2]) if self.bound else None,
                fprime_ieqcons=(lambda x: self._evaluate(x)[3]) if self.bound else None,
                bounds=self.bounds,
                iter=most_iterations,
                acc=1e-9,
                iprint=0,
            )
        )

    def _evaluate(self, x: Array) -> tuple[float, Array, Array, Array]:
        key = x.tobytes()
        if self._cache is None or self._cache[0] != key:
            self._cache = key, self._compute(x)
        return self._cache[1]

    def _compute(self, x: Array) -> tuple[float, Array, Array, Array]:
        weights = self.problem.targets.weights
        total = np.zeros(len(weights))
        slopes = np.zeros((x.size, len(weights)))
        kept: list[Array] = []
        kept_slopes: list[Array] = []
        for i, part in enumerate(self.slices):
            steps = _stencil(x[part])
            gain = _smooth_gains(self.problem, i, steps, self.seen[i])
            total += gain[0]
            slopes[part] = _differences(gain)
            if self.active[i].any():
                clearance = _clearances(self.problem, i, steps, self.seen[i])[:, self.active[i]]
                kept.append(clearance[0] - _INSIDE)
                slope = np.zeros((clearance.shape[1], x.size))
                slope[:, part] = _differences(clearance).T
                kept_slopes.append(slope)
        for i, j, least_m in self.pairs:
            gap = (x[self.slices[i]] - x[self.slices[j]])[:2]
            slope = np.zeros((1, x.size))
            slope[0, self.slices[i]][:2] = 2.0 * gap
            slope[0, self.slices[j]][:2] = -2.0 * gap
            kept.append(np.array([gap @ gap - least_m**2 - _INSIDE]))
            kept_slopes.append(slope)
        covered = self.seen.any(axis=0)
        share = np.where(covered, weights, 0.0) / weights[covered].sum()
        quality = 1.0 / np.where(covered, total, 1.0)
        value = 1e3 * float(quality @ share)
        gradient = -1e3 * slopes @ (quality * quality * share)
        empty = np.zeros(0), np.zeros((0, x.size))
        joined = (np.concatenate(kept), np.concatenate(kept_slopes)) if kept else empty
        return value, gradient, *joined


def _stencil(x: Array) -> Array:
    """Return x and x plus and minus a step along each axis: (1 + 2 d, d)."""
    step = _STEP * np.eye(x.size)
    return np.concatenate([x[None], x + step, x - step])


def _differences(values: Array) -> Array:
    """Return (d, ...) central differences of values (1 + 2 d, ...) on the stencil."""
    d = (len(values) - 1) // 2
    return np.asarray((values[1 : d + 1] - values[d + 1 :]) / (2.0 * _STEP))


def _smooth_gains(problem: Problem, i: int, vectors: Array, seen: Flags) -> Array:
    """Return (K, m) gains 1/Q of the frozen pattern, whatever the visibility says."""
    camera = problem.cameras[i]
    R, origins = camera_poses(camera.place, vectors)
    gain = np.zeros((len(vectors), len(seen)))
    points = (problem.targets.points_m[seen] - origins[:, None, :]) @ R
    gain[:, seen] = 1.0 / sensing.pixel_quality(camera.lens, points)
    return gain


def _clearances(problem: Problem, i: int, vectors: Array, seen: Flags) -> Array:
    """Return (K, C) how far inside the edges of view the seen targets are, as a share of the view, about 0..1."""
    camera, margin_rad = problem.cameras[i], problem.settings.margin_rad
    R, origins = camera_poses(camera.place, vectors)
    if problem.settings.visibility == "cone":
        points = (problem.targets.points_m[seen] - origins[:, None, :]) @ R
        return sensing.cone_clearance(camera.lens, points, alpha_rad(camera), margin_rad) / alpha_rad(camera)
    tagged = problem.targets.tagged
    lone = (problem.targets.points_m[seen & ~tagged] - origins[:, None, :]) @ R
    corners = (problem.targets.corners_m[seen & tagged].reshape(-1, 3) - origins[:, None, :]) @ R
    points = np.concatenate([lone, corners], axis=1)
    clearance = sensing.image_clearance(camera.lens, points, margin_rad) / camera.lens.size_px[0]
    return np.asarray(clearance.reshape(len(vectors), -1))
