"""A small, dense, strictly convex quadratic programme, by the dual active-set method. Compiled.

After D. Goldfarb and A. Idnani, "A numerically stable dual method for solving strictly convex quadratic programs",
Mathematical Programming 27 (1983): from the unconstrained minimum, one violated constraint after another is made
active, and those whose multiplier would turn negative on the way are let go.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.problem import Ints

_VIOLATED = 1e-11
_DEPENDENT = 1e-12
"""Squared, of a unit normal: what of it the active constraints leave, below which they already fix it."""
_ROUNDS = 8
"""Times the number of variables and constraints: degenerate corners may make the method go round in circles."""


@compiled
def cholesky(matrix: Array, lower: Array) -> bool:
    """Fill the lower triangular root of a symmetric matrix (n, n); False where that is not safely positive definite."""
    size = len(matrix)
    largest = 0.0
    for k in range(size):
        largest = max(largest, abs(matrix[k, k]))
    for k in range(size):
        for h in range(k + 1):
            value = matrix[k, h]
            for a in range(h):
                value -= lower[k, a] * lower[h, a]
            if h < k:
                lower[k, h] = value / lower[h, h]
            elif value > 1e-10 * largest:
                lower[k, k] = math.sqrt(value)
            else:
                return False
        for h in range(k + 1, size):
            lower[k, h] = 0.0
    return True


@compiled
def quadratic(lower: Array, linear: Array, rows: Array, least: Array, x: Array, multipliers: Array) -> bool:
    """Fill the x (n,) that minimises x^T L L^T x / 2 + linear^T x while rows (q, n) @ x >= least (q,).

    ``multipliers`` (q,) become those of the constraints, >= 0. Rows are best of about unit length. False, and x of no
    use, where no x satisfies all.
    """
    size, count = len(linear), len(rows)
    J, R = _inverse_transposed(lower), np.zeros((size, size))
    active, at = np.empty(size, dtype=np.int64), 0
    multipliers[:] = 0.0
    for k in range(size):  # the unconstrained minimum: -J J^T linear
        x[k] = 0.0
    for a in range(size):
        along = 0.0
        for k in range(size):
            along += J[k, a] * linear[k]
        for k in range(size):
            x[k] -= J[k, a] * along
    for _ in range(_ROUNDS * (size + count)):
        p, slack = _most_violated(rows, least, x, active, at)
        if p < 0:
            return True
        at = _activate(J, R, rows[p], slack, p, x, multipliers, active, at)
        if at < 0:
            return False
    return False


@compiled
def _activate(
    J: Array, R: Array, normal: Array, slack: float, p: int, x: Array, multipliers: Array, active: Ints, at: int
) -> int:
    """Go until constraint ``p`` holds, and make it the last of the active ones; return how many those are then.

    -1 where it cannot hold beside the others.
    """
    size = len(x)
    d, z, r = np.empty(size), np.empty(size), np.empty(size)
    added = 0.0
    while True:
        _directions(J, R, normal, at, d, z, r)
        leaving, partial = -1, math.inf
        for k in range(at):
            if r[k] > 0.0 and multipliers[active[k]] / r[k] < partial:
                leaving, partial = k, multipliers[active[k]] / r[k]
        left = (d[at:] * d[at:]).sum()
        full = -slack / left if left > _DEPENDENT * (d * d).sum() else math.inf
        step = min(partial, full)
        if step == math.inf:
            return -1
        added += step
        for k in range(at):
            multipliers[active[k]] -= step * r[k]
        if full < math.inf:
            slack += step * left
            for k in range(size):
                x[k] += step * z[k]
        if full <= partial:
            multipliers[p] = added
            active[at] = p
            _add(J, R, d, at)
            return at + 1
        multipliers[active[leaving]] = 0.0
        _drop(J, R, active, leaving, at)
        at -= 1


@compiled
def _inverse_transposed(lower: Array) -> Array:
    size = len(lower)
    inverse = np.zeros((size, size))
    for k in range(size):  # column k of L^-1, kept as row k: its transpose
        inverse[k, k] = 1.0 / lower[k, k]
        for h in range(k + 1, size):
            value = 0.0
            for a in range(k, h):
                value += lower[h, a] * inverse[k, a]
            inverse[k, h] = -value / lower[h, h]
    return inverse


@compiled
def _slack(rows: Array, least: Array, x: Array, p: int) -> float:
    value = -least[p]
    for k in range(len(x)):
        value += rows[p, k] * x[k]
    return float(value)


@compiled
def _most_violated(rows: Array, least: Array, x: Array, active: Ints, at: int) -> tuple[int, float]:
    worst, found = -_VIOLATED, -1
    for p in range(len(rows)):
        slack = _slack(rows, least, x, p)
        if slack < worst:
            known = False
            for k in range(at):
                known = known or active[k] == p
            if not known:
                worst, found = slack, p
    return found, worst


@compiled
def _directions(J: Array, R: Array, normal: Array, at: int, d: Array, z: Array, r: Array) -> None:
    """Fill d = J^T normal; z, the way of x, and r, by which the multipliers of the active ones shrink on it."""
    size = len(d)
    for a in range(size):
        d[a] = 0.0
    for k in range(size):
        if normal[k] != 0.0:
            for a in range(size):
                d[a] += J[k, a] * normal[k]
    for k in range(size):
        z[k] = 0.0
        for a in range(at, size):
            z[k] += J[k, a] * d[a]
    for k in range(at - 1, -1, -1):
        r[k] = d[k]
        for h in range(k + 1, at):
            r[k] -= R[k, h] * r[h]
        r[k] /= R[k, k]


@compiled
def _add(J: Array, R: Array, d: Array, at: int) -> None:
    """Turn the free columns of J until only the first of them has a part along the new normal."""
    size = len(d)
    for a in range(size - 1, at, -1):
        length = math.hypot(d[a - 1], d[a])
        if length == 0.0:
            continue
        c, s = d[a - 1] / length, d[a] / length
        d[a - 1], d[a] = length, 0.0
        for k in range(size):
            J[k, a - 1], J[k, a] = c * J[k, a - 1] + s * J[k, a], c * J[k, a] - s * J[k, a - 1]
    for k in range(at + 1):
        R[k, at] = d[k]


@compiled
def _drop(J: Array, R: Array, active: Ints, leaving: int, at: int) -> None:
    """Take one column out of R, and turn what is left into a triangle again."""
    size = len(J)
    for h in range(leaving, at - 1):
        active[h] = active[h + 1]
        for k in range(size):
            R[k, h] = R[k, h + 1]
    for k in range(size):
        R[k, at - 1] = 0.0
    for h in range(leaving, at - 1):
        length = math.hypot(R[h, h], R[h + 1, h])
        if length == 0.0:
            continue
        c, s = R[h, h] / length, R[h + 1, h] / length
        for k in range(h, at - 1):
            R[h, k], R[h + 1, k] = c * R[h, k] + s * R[h + 1, k], c * R[h + 1, k] - s * R[h, k]
        for k in range(size):
            J[k, h], J[k, h + 1] = c * J[k, h] + s * J[k, h + 1], c * J[k, h + 1] - s * J[k, h]
