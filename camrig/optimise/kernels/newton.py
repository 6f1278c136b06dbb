"""Sequential quadratic programming with exact curvature, on the smooth problem beside a configuration. Compiled.

Each step solves the quadratic programme of the Lagrangian's second derivatives and the linearised constraints, within
a box about where it is, and is shortened until an exact penalty function falls (J. Nocedal and S. Wright, *Numerical
Optimization*, 2nd ed., chapter 18).
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.frozen import (
    INSIDE,
    Frozen,
    hessian_of,
    joint,
    kept_of,
    qualities_of,
    totals,
    values,
    with_joint,
)
from camrig.optimise.kernels.problem import HIGH, LOW, VARIABLES, Problem
from camrig.optimise.kernels.quadratic import cholesky, quadratic

_FIRST_REACH, _MOST_REACH = 0.2, 1.0
"""How far a step may go in each variable, in radians or metres: what cameras see is known nearby alone."""
_NEAR = 1e-2
"""A step this short leaves the curvature as good as it was."""
_SHORTEST = 2.0**-10
_FALL = 1e-4
"""The share of the promised fall that a step must bring."""
_SLACK_CURVATURE = 1e-3
"""Of the worst target's own variable, in 1/mm: it has none, and a quadratic programme needs some."""


@compiled
def newton(problem: Problem, frozen: Frozen, vectors: Array, iterations: int, accuracy_mm: float) -> int:
    """Move vectors (n, 6) to the optimum of the smooth problem; return how many iterations that took.

    Fewer than ``iterations`` when the next step promises less than ``accuracy_mm``, or none leads on.
    """
    low, high = (
        joint(frozen, problem.cameras[:, LOW : LOW + VARIABLES]),
        joint(frozen, problem.cameras[:, HIGH : HIGH + VARIABLES]),
    )
    x = joint(frozen, vectors)
    size, kept = len(x), len(frozen.edges) + len(frozen.pairs)
    prices, penalty, reach = np.zeros(kept), 0.0, _FIRST_REACH
    importance = frozen.share.copy()
    if frozen.worst:
        _first_importance(values(problem, frozen, vectors)[0], frozen.share, importance)
    d, root, longest = np.zeros(size + 1), np.empty((size, size)), math.inf
    for iteration in range(iterations):
        total, by = totals(problem, frozen, vectors)
        quality_mm, slopes = qualities_of(problem, total, by, frozen.share)
        inside, inside_slopes = kept_of(problem, frozen, vectors, size)
        height = _height(frozen, quality_mm)
        if longest > _NEAR:
            hessian = hessian_of(problem, frozen, vectors, total, by, importance, prices)
            root = _convex(hessian, prices, inside_slopes)
        multipliers = np.zeros(kept + len(frozen.share))
        found = _step(frozen, root, quality_mm, slopes, inside, inside_slopes, x, low, high, reach, d, multipliers)
        if not found:
            return iteration
        prices[:] = multipliers[:kept]
        if frozen.worst:
            importance[:] = multipliers[kept:]
        promised = d[size] if frozen.worst else (slopes.T @ frozen.share) @ d[:size]
        violated = _violation(inside)
        penalty = max(penalty, 1.5 * prices.max()) if kept else 0.0
        promised -= penalty * violated
        if -promised < accuracy_mm and violated < INSIDE / 2.0:
            return iteration
        merit, share = height + penalty * violated, 1.0
        while True:
            moved = with_joint(frozen, vectors, np.minimum(np.maximum(x + share * d[:size], low), high))
            tried_mm, tried_inside = values(problem, frozen, moved)
            if _height(frozen, tried_mm) + penalty * _violation(tried_inside) <= merit + _FALL * share * promised:
                break
            share /= 2.0
            if share < _SHORTEST:
                return iteration
        vectors[:] = moved
        x = joint(frozen, vectors)
        longest = np.abs(d[:size]).max()
        reach = min(2.0 * reach, _MOST_REACH) if share == 1.0 else 2.0 * share * longest
    return iterations


@compiled
def _height(frozen: Frozen, quality_mm: Array) -> float:
    return float(quality_mm.max() if frozen.worst else (quality_mm * frozen.share).sum())


@compiled
def _violation(inside: Array) -> float:
    total = 0.0
    for value in inside:
        total -= min(value, 0.0)
    return total


@compiled
def _first_importance(quality_mm: Array, share: Array, importance: Array) -> None:
    """Fill a guess at how much each target holds the worst one up: those near the worst do."""
    worst = quality_mm.max()
    for j in range(len(share)):
        importance[j] = math.exp((quality_mm[j] / worst - 1.0) / 0.05) if share[j] > 0.0 else 0.0
    importance /= importance.sum()


@compiled
def _convex(matrix: Array, prices: Array, slopes: Array) -> Array:
    """Return a lower triangular root of the matrix, with as much added as makes it positive definite: first across the
    active constraints, where that changes no step, then everywhere.
    """
    size = len(matrix)
    lower = np.empty((size, size))
    if cholesky(matrix, lower):
        return lower
    largest = max(np.abs(matrix).max(), 1e-9)
    for q in range(len(prices)):
        squared = (slopes[q] * slopes[q]).sum()
        if prices[q] > 0.0 and squared > 0.0:
            for k in range(size):
                for h in range(size):
                    matrix[k, h] += largest * slopes[q, k] * slopes[q, h] / squared
    added = 0.0
    while added < 1e3 * largest and not cholesky(matrix, lower):
        more = max(1e-3 * largest, added)
        for k in range(size):
            matrix[k, k] += more
        added += more
    return lower


@compiled
def _step(
    frozen: Frozen,
    lower: Array,
    quality_mm: Array,
    slopes: Array,
    inside: Array,
    inside_slopes: Array,
    x: Array,
    low: Array,
    high: Array,
    reach: float,
    d: Array,
    multipliers: Array,
) -> bool:
    """Fill the step (size + 1,), last that of the worst quality, and the multipliers (Q + P + m,)."""
    size, kept = len(x), len(inside)
    wide = size + 1 if frozen.worst else size
    covered = np.flatnonzero(frozen.share > 0.0)
    targets = len(covered) if frozen.worst else 0
    rows, least = np.zeros((kept + targets + 2 * size, wide)), np.empty(kept + targets + 2 * size)
    for q in range(kept):
        rows[q, :size] = inside_slopes[q]
        least[q] = -inside[q]
    for t in range(targets):
        rows[kept + t, :size] = -slopes[covered[t]]
        rows[kept + t, size] = 1.0
        least[kept + t] = quality_mm[covered[t]] - quality_mm.max()
    for k in range(size):
        rows[kept + targets + k, k], least[kept + targets + k] = 1.0, max(low[k] - x[k], -reach)
        rows[kept + targets + size + k, k], least[kept + targets + size + k] = -1.0, -min(high[k] - x[k], reach)
    lengths = np.empty(len(rows))
    for q in range(len(rows)):
        lengths[q] = max(math.sqrt((rows[q] * rows[q]).sum()), 1e-12)
        rows[q] /= lengths[q]
        least[q] /= lengths[q]
    root, linear = np.zeros((wide, wide)), np.zeros(wide)
    root[:size, :size] = lower
    if frozen.worst:
        root[size, size], linear[size] = math.sqrt(_SLACK_CURVATURE), 1.0
    else:
        linear[:] = slopes.T @ frozen.share
    found, prices = np.empty(wide), np.empty(len(rows))
    # What is violated a little must at least not get worse: that has a solution, the step that stays.
    if not quadratic(root, linear, rows, least, found, prices) and not quadratic(
        root, linear, rows, np.minimum(least, 0.0), found, prices
    ):
        return False
    if not np.isfinite(found).all():
        return False
    d[:wide] = found
    multipliers[:kept] = prices[:kept] / lengths[:kept]
    for t in range(targets):
        multipliers[kept + covered[t]] = prices[kept + t] / lengths[kept + t]
    return True
