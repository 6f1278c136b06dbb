"""Second derivatives of the smooth problem beside a configuration. Compiled.

A target's fused quality depends on all cameras through the sums of their channels alone, and a channel on one camera's
variables: so the curvature is that of the fusion, known exactly, along the slopes of the sums, plus a block for each
camera, which differences of its analytic slopes give. Constraints of view belong to one camera too.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.problem import CHANNELS, FISHER, HIGH, QUALITY, VARIABLES, ZOOM, Flags, Ints, Problem, Y
from camrig.optimise.kernels.slopes import worth_slopes
from camrig.optimise.kernels.smooth import clearance_slopes
from camrig.optimise.kernels.worth import quality_slopes
from camrig.sensing.fisher import invert_symmetric

_STEP = 1e-5


@compiled
def add_fusion(total: Array, by: Array, quality: int, share: float, matrix: Array) -> None:
    """Add ``share`` times the second derivative of a target's quality by what cameras add up to, total (C,), along the
    derivatives of that by the joint variables (size, C), to a matrix (size, size).
    """
    size = len(by)
    of_channel = np.empty(len(total))
    value = quality_slopes(total, quality, of_channel)
    if quality != FISHER:
        for k in range(size):
            if by[k, 0] != 0.0:
                for h in range(size):
                    matrix[k, h] += 2.0 * share * value**3 * by[k, 0] * by[h, 0]
        return
    information, inverse = np.empty((3, 3)), np.empty((3, 3))
    _unpacked(total, information)
    invert_symmetric(information, inverse)
    slope, turned = np.empty((size, 3, 3)), np.zeros((size, 3, 3))  # M^-1 dM, and that times M^-1
    along = np.zeros(size)
    for k in range(size):
        for c in range(len(total)):
            along[k] += of_channel[c] * by[k, c]
        _unpacked(by[k], information)
        slope[k] = inverse @ information
        turned[k] = slope[k] @ inverse
    # Q^2 = tr M^-1, so Q Q'' = tr(M^-1 dM M^-1 dM M^-1) - Q' Q'
    for k in range(size):
        for h in range(size):
            double = 0.0
            for a in range(3):
                for b in range(3):
                    double += slope[k, a, b] * turned[h, b, a]
            matrix[k, h] += share * (double - along[k] * along[h]) / value


@compiled
def _unpacked(channels: Array, out: Array) -> None:
    at = 0
    for k in range(3):
        for h in range(k, 3):
            out[k, h] = out[h, k] = channels[at]
            at += 1


@compiled
def add_cameras(
    problem: Problem,
    vectors: Array,
    seen: Flags,
    anchors: Flags,
    column: Ints,
    by: Array,
    price: Array,
    matrix: Array,
) -> None:
    """Add the curvature of what each camera adds to what it sees, at a ``price`` (m, C) of each channel.

    ``by`` (m, size, C) are the slopes here: a joint variable belongs to one camera.
    """
    channels = CHANNELS[int(problem.settings[QUALITY])]
    for i in range(len(vectors)):
        targets: Ints = np.flatnonzero(seen[i]).astype(np.int64)
        worths, there = np.empty((len(targets), channels)), np.empty((len(targets), VARIABLES, channels))
        for variable in range(VARIABLES):
            if column[i, variable] < 0:
                continue
            step = _step(problem, i, vectors[i], variable)
            moved = vectors[i].copy()
            moved[variable] += step
            worth_slopes(problem, i, moved, anchors[i], targets, worths, there)
            for other in range(VARIABLES):
                if column[i, other] < 0:
                    continue
                change = 0.0
                for t in range(len(targets)):
                    j = targets[t]
                    for c in range(channels):
                        change += price[j, c] * (there[t, other, c] - by[j, column[i, other], c])
                _add_evenly(matrix, column[i, variable], column[i, other], change / step)


@compiled
def add_view(problem: Problem, vectors: Array, rows: Ints, column: Ints, prices: Array, matrix: Array) -> None:
    """Add the curvature of clearances (rows as in ``smooth.active_edges``), each at its price (Q,)."""
    here, there = np.empty((1, VARIABLES)), np.empty((1, VARIABLES))
    for q in range(len(rows)):
        if prices[q] == 0.0:
            continue
        i = rows[q, 0]
        clearance_slopes(problem, rows[q : q + 1], vectors[i], column[i], here)
        for variable in range(VARIABLES):
            if column[i, variable] < 0:
                continue
            step = 10.0 * _step(problem, i, vectors[i], variable)  # of slopes that are differences themselves
            moved = vectors[i].copy()
            moved[variable] += step
            clearance_slopes(problem, rows[q : q + 1], moved, column[i], there)
            for other in range(VARIABLES):
                if column[i, other] >= 0:
                    change = prices[q] * (there[0, other] - here[0, other]) / step
                    _add_evenly(matrix, column[i, variable], column[i, other], change)


@compiled
def add_gaps(pairs: Ints, column: Ints, prices: Array, matrix: Array) -> None:
    """Add the curvature of the squared horizontal distances of pairs (P, 2), each at its price (P,)."""
    for p in range(len(pairs)):
        for axis in range(Y + 1):
            one, other = column[pairs[p, 0], axis], column[pairs[p, 1], axis]
            if one >= 0:
                matrix[one, one] += 2.0 * prices[p]
            if other >= 0:
                matrix[other, other] += 2.0 * prices[p]
            if one >= 0 and other >= 0:
                matrix[one, other] -= 2.0 * prices[p]
                matrix[other, one] -= 2.0 * prices[p]


@compiled
def _step(problem: Problem, i: int, u: Array, variable: int) -> float:
    """Return a step that stays inside the lens's table: beyond it a zoom changes nothing."""
    return -_STEP if variable == ZOOM and u[ZOOM] + 20.0 * _STEP > problem.cameras[i, HIGH + ZOOM] else _STEP


@compiled
def _add_evenly(matrix: Array, row: int, column: int, value: float) -> None:
    matrix[row, column] += 0.5 * value
    matrix[column, row] += 0.5 * value
