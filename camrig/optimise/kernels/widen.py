"""A vector from which a camera sees a target more that is just out of its view, and all that it sees. Compiled."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.compass import star
from camrig.optimise.kernels.problem import TAGGED, Ints, Problem
from camrig.optimise.kernels.smooth import CENTRE, EDGES, clearance

_SHRINK, _STEPS = 0.4, 9
"""From a tenth of a radian or metre down to 0.0001, less than a pixel."""
_MOST_MOVES = 40
"""Rounds of the star; what is wider by more than that is found from another start."""


@compiled
def widest(problem: Problem, i: int, targets: Ints, u: Array) -> float:
    """Move a vector (6,) to where the worst clearance of all the targets is largest; return that, a share of the view.

    Pattern search: there the clearances of two or three edges meet, and their minimum has no slope.
    """
    best = _least(problem, i, targets, u, -math.inf)
    scale = np.full(1, 0.1)
    moves = 0
    for _ in range(_STEPS):
        moved = True
        while moved and moves < _MOST_MOVES:
            moved = False
            points = star(problem, i, u, scale)
            for k in range(len(points)):
                value = _least(problem, i, targets, points[k], best)
                if value > best:
                    best, moved = value, True
                    u[:] = points[k]
            moves += 1
        scale[0] *= _SHRINK
    return best


@compiled
def _least(problem: Problem, i: int, targets: Ints, u: Array, known: float) -> float:
    """Return the worst clearance, or something below ``known`` as soon as it is that."""
    row = np.empty(4, dtype=np.int64)
    worst = math.inf
    for t in range(len(targets)):
        whole = problem.targets[targets[t], TAGGED] > 0.0
        for corner in range(0 if whole else CENTRE, CENTRE if whole else CENTRE + 1):
            for edge in range(EDGES):
                row[0], row[1], row[2], row[3] = i, targets[t], corner, edge
                worst = min(worst, clearance(problem, row, u))
                if worst <= known:
                    return worst
    return worst
