"""Nobody plans: heads look at the middle of the targets, drones hang on a grid. Pure."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.comparators.common import Asked, Found, looking_at, middle
from camrig.optimise.kernels.problem import TILT, Problem, X, Y


def find(asked: Asked) -> Found:
    """Return the rig that an installer would leave: drones at the middle height of their boxes, zooms at row 0."""
    problem = asked.task.problem
    vectors = middle(problem)
    centroid = problem.points.mean(axis=0)
    for i in np.flatnonzero(problem.low[:, TILT] < problem.high[:, TILT]):
        vectors[i] = looking_at(problem, int(i), vectors[i], centroid)
    drones = np.flatnonzero(problem.separation_m >= 0.0)
    for k, i in enumerate(drones):
        low, high = problem.low[i, X : Y + 1], problem.high[i, X : Y + 1]
        vectors[i, X : Y + 1] = low + _cell(problem, int(i), k, len(drones)) * (high - low)
    return Found(vectors)


def _cell(problem: Problem, i: int, k: int, count: int) -> Array:
    """Return the middle of cell ``k`` of ``count``, about square ones, as shares (2,) of drone i's box."""
    size = np.maximum(problem.high[i] - problem.low[i], 1e-9)
    columns = min(count, max(1, round(math.sqrt(count * size[X] / size[Y]))))
    rows = math.ceil(count / columns)
    return np.array([(k % columns + 0.5) / columns, (k // columns + 0.5) / rows])
