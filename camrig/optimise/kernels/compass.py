"""Compass search on the true, hard objective: one camera at a time to the best point of a star about it. Compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.descent import Table
from camrig.optimise.kernels.problem import (
    HIGH,
    LOW,
    SEPARATION,
    VARIABLES,
    ZOOM,
    Flags,
    Ints,
    Problem,
    X,
    Y,
    Z,
)
from camrig.optimise.kernels.state import SAME, Sums, apply, change, preferred
from camrig.optimise.kernels.table import look


class Rows(NamedTuple):
    """What every camera sees from its present vector, beside what it can reach at all; changed in place."""

    reach_ends: Ints
    """(n + 1,) where the reachable targets of a camera end in ``reachable``; its row has room for all of them."""
    reachable: Ints
    sizes: Ints
    """(n,) how many it sees: the first entries of its part of ``targets`` and ``worths``."""
    targets: Ints
    worths: Array
    watch_ends: Ints
    """(m + 1,) where the list of cameras that can reach a target ends in ``watchers``."""
    watchers: Ints


@compiled
def fill(problem: Problem, rows: Rows, sums: Sums, vectors: Array) -> None:
    """Fill the rows of all cameras at vectors (n, 6) and add them to empty sums."""
    for i in range(len(vectors)):
        start, end = rows.reach_ends[i], rows.reach_ends[i + 1]
        reachable = rows.reachable[start:end]
        rows.sizes[i] = look(problem, i, vectors[i], reachable, rows.targets[start:end], rows.worths[start:end])
        apply(sums, rows.targets, rows.worths, start, start + rows.sizes[i], 1)


@compiled
def star(problem: Problem, i: int, u: Array, scales: Array) -> Array:
    """Return vectors (K, 6) about one, inside the limits: along each free variable and each pair of them, all ways."""
    free = np.empty(VARIABLES, dtype=np.int64)
    count = 0
    for variable in range(VARIABLES):
        if problem.cameras[i, LOW + variable] < problem.cameras[i, HIGH + variable]:
            free[count] = variable
            count += 1
    out = np.empty((len(scales) * 2 * count * count, VARIABLES))
    at = 0
    for scale in scales:
        for a in range(count):
            for b in range(a, count):
                for sign_a in (-1.0, 1.0):
                    for sign_b in (-1.0, 1.0):
                        if a == b and sign_b < 0.0:
                            continue
                        out[at] = u
                        _shift(problem, i, out[at], free[a], sign_a * scale)
                        if a != b:
                            _shift(problem, i, out[at], free[b], sign_b * scale)
                        at += 1
    return out[:at]


@compiled
def _mark(rows: Rows, targets: Ints, dirty: Flags) -> None:
    for j in targets:
        for at in range(rows.watch_ends[j], rows.watch_ends[j + 1]):
            dirty[rows.watchers[at]] = True


@compiled
def _shift(problem: Problem, i: int, u: Array, variable: int, step: float) -> None:
    if variable == ZOOM:
        step *= problem.cameras[i, HIGH + ZOOM]  # a step of 1 is the whole table
    low, high = problem.cameras[i, LOW + variable], problem.cameras[i, HIGH + variable]
    u[variable] = min(max(u[variable] + step, low), high)


@compiled
def placed_well(problem: Problem, vectors: Array, i: int, u: Array) -> bool:
    """Tell whether a drone may be there: outside the keep-out boxes, and apart from the other drones horizontally."""
    if problem.cameras[i, SEPARATION] < 0.0:
        return True
    for b in range(len(problem.boxes)):
        low, high = problem.boxes[b, 0], problem.boxes[b, 1]
        if low[X] < u[X] < high[X] and low[Y] < u[Y] < high[Y] and low[Z] < u[Z] < high[Z]:
            return False
    for other in range(len(vectors)):
        if other == i or problem.cameras[other, SEPARATION] < 0.0:
            continue
        least = max(problem.cameras[i, SEPARATION], problem.cameras[other, SEPARATION]) - SAME
        dx, dy = u[X] - vectors[other, X], u[Y] - vectors[other, Y]
        if least > 0.0 and dx * dx + dy * dy < least * least:
            return False
    return True


@compiled
def compass(
    problem: Problem,
    table: Table,
    rows: Rows,
    sums: Sums,
    vectors: Array,
    dirty: Flags,
    scales: Array,
    least_gain: float,
    at: int,
    budget: int,
) -> int:
    """Move dirty cameras, beginning with ``at``, until none can do better or ``budget`` sights were looked at.

    A camera goes to the best point of its star or, where that is better still, to one of its candidates in the table,
    if it has any there: others that have moved since may have left it a better view. Returns the camera to go on with,
    or -1. Changes vectors, rows and sums in place, never for the worse. Only a gain of ``least_gain`` makes it look
    again at those who share a target with a camera that has moved.
    """
    clean = 0
    while clean < len(vectors):
        if budget <= 0:
            return at
        if dirty[at]:
            dirty[at] = False
            clean = 0
            start = rows.reach_ends[at]
            present = rows.targets[start : start + rows.sizes[at]].copy()
            apply(sums, rows.targets, rows.worths, start, start + rows.sizes[at], -1)
            first_uncovered, first_cost = change(sums, rows.targets, rows.worths, start, start + rows.sizes[at])
            uncovered, cost = _best_of_star(problem, rows, sums, vectors, scales, at, first_uncovered, first_cost)
            uncovered, cost = _best_of_table(problem, table, rows, sums, vectors, at, uncovered, cost)
            budget -= _looks(problem, table, rows, scales, at)
            end = start + rows.sizes[at]
            apply(sums, rows.targets, rows.worths, start, end, 1)
            if preferred(uncovered, cost + least_gain, first_uncovered, first_cost):
                dirty[at] = True
                _mark(rows, present, dirty)
                _mark(rows, rows.targets[start:end], dirty)
        else:
            clean += 1
        at = (at + 1) % len(vectors)
    return -1


@compiled
def _looks(problem: Problem, table: Table, rows: Rows, scales: Array, i: int) -> int:
    """Return how many sights the star and the candidates of camera ``i`` cost."""
    free = 0
    for variable in range(VARIABLES):
        if problem.cameras[i, LOW + variable] < problem.cameras[i, HIGH + variable]:
            free += 1
    first, end = table.block[i, 0], table.block[i, 1]
    sights = len(scales) * 2 * free * free * (rows.reach_ends[i + 1] - rows.reach_ends[i])
    return int(sights + table.ends[end] - table.ends[first])


@compiled
def _best_of_star(
    problem: Problem,
    rows: Rows,
    sums: Sums,
    vectors: Array,
    scales: Array,
    i: int,
    best_uncovered: float,
    best_cost: float,
) -> tuple[float, float]:
    """Move camera ``i``, whose row is not in the sums, to the best point of its star if that is better; return how good
    its place is then.
    """
    start, most = rows.reach_ends[i], rows.reach_ends[i + 1]
    reachable = rows.reachable[start:most]
    seen, worths = np.empty(most - start, dtype=np.int64), np.empty((most - start, sums.total.shape[1]))
    points = star(problem, i, vectors[i], scales)
    for k in range(len(points)):
        if not placed_well(problem, vectors, i, points[k]):
            continue
        count = look(problem, i, points[k], reachable, seen, worths)
        uncovered, cost = change(sums, seen, worths, 0, count)
        if preferred(uncovered, cost + SAME * abs(cost), best_uncovered, best_cost):
            best_uncovered, best_cost = uncovered, cost
            vectors[i] = points[k]
            rows.sizes[i] = count
            rows.targets[start : start + count] = seen[:count]
            rows.worths[start : start + count] = worths[:count]
    return best_uncovered, best_cost


@compiled
def _best_of_table(
    problem: Problem,
    table: Table,
    rows: Rows,
    sums: Sums,
    vectors: Array,
    i: int,
    best_uncovered: float,
    best_cost: float,
) -> tuple[float, float]:
    """Do the same with the camera's candidates."""
    best = -1
    for k in range(table.block[i, 0], table.block[i, 1]):
        uncovered, cost = change(sums, table.targets, table.worths, table.ends[k], table.ends[k + 1])
        if not preferred(uncovered, cost + SAME * abs(cost), best_uncovered, best_cost):
            continue
        if placed_well(problem, vectors, i, table.vectors[k]):
            best, best_uncovered, best_cost = k, uncovered, cost
    if best >= 0:
        start, first, end = rows.reach_ends[i], table.ends[best], table.ends[best + 1]
        vectors[i] = table.vectors[best]
        rows.sizes[i] = end - first
        rows.targets[start : start + end - first] = table.targets[first:end]
        rows.worths[start : start + end - first] = table.worths[first:end]
    return best_uncovered, best_cost
