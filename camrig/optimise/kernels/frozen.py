"""The smooth problem beside a configuration, over all free variables together: values, slopes, curvature. Compiled.

Who sees whom is frozen. Qualities in mm, constraints dimensionless (of view) or in square metres (between drones), kept
where >= 0. m targets, Q clearances of view, P pairs of drones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.curvature import add_cameras, add_fusion, add_gaps, add_view
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import CHANNELS, QUALITY, VARIABLES, Flags, Ints, Problem, Y
from camrig.optimise.kernels.slopes import worth_slopes
from camrig.optimise.kernels.smooth import clearance, clearances
from camrig.optimise.kernels.worth import add_worth, pose_known_by, quality_of, quality_slopes

MM = 1e3
INSIDE = 1e-9
"""How far inside its limits the smooth problem stays, so that the hard visibility agrees."""


class Frozen(NamedTuple):
    """What stays as it is: who sees whom (n, m), and what of that must be kept."""

    seen: Flags
    anchors: Flags
    """(n, A) the anchors that count as seen: a camera's pose is known by them."""
    column: Ints
    """(n, 6) the place of a camera's variable among the joint ones, -1 for what is not free."""
    edges: Ints
    """(Q, 4) clearances of view that may become active, as in ``smooth.active_edges``."""
    pairs: Ints
    """(P, 2) drones that must keep apart."""
    apart_m: Array
    """(P,) horizontally, by how much."""
    share: Array
    """(m,) what a target's quality counts in the mean; 0 for the uncovered."""
    worst: bool


@compiled
def joint(frozen: Frozen, vectors: Array) -> Array:
    """Return the joint variables (size,) of vectors (n, 6)."""
    out = np.empty(frozen.column.max() + 1)
    for i in range(len(vectors)):
        for variable in range(VARIABLES):
            if frozen.column[i, variable] >= 0:
                out[frozen.column[i, variable]] = vectors[i, variable]
    return out


@compiled
def with_joint(frozen: Frozen, before: Array, x: Array) -> Array:
    """Return the vectors (n, 6) with other joint variables (size,)."""
    out = before.copy()
    for i in range(len(out)):
        for variable in range(VARIABLES):
            if frozen.column[i, variable] >= 0:
                out[i, variable] = x[frozen.column[i, variable]]
    return out


@compiled
def values(problem: Problem, frozen: Frozen, vectors: Array) -> tuple[Array, Array]:
    """Return the fused qualities (m,) in mm, 0 for the uncovered, and by how much each constraint is kept (Q + P,)."""
    quality = int(problem.settings[QUALITY])
    total = np.zeros((len(frozen.share), CHANNELS[quality]))
    for i in range(len(vectors)):
        lens = lens_of(problem.cameras[i], problem.lenses, vectors[i])
        R, origin = pose_of(problem.cameras[i], vectors[i])
        known = pose_known_by(problem, i, vectors[i], frozen.anchors[i], lens, R, origin)
        for j in range(len(frozen.share)):
            if frozen.seen[i, j]:
                add_worth(quality, lens, R, origin, known, problem.targets[j], 1.0, total[j])
    quality_mm = np.zeros(len(frozen.share))
    for j in range(len(frozen.share)):
        if frozen.share[j] > 0.0:
            quality_mm[j] = MM * quality_of(total[j], quality)
    inside = np.empty(len(frozen.edges) + len(frozen.pairs))
    for q in range(len(frozen.edges)):
        inside[q] = clearance(problem, frozen.edges[q], vectors[frozen.edges[q, 0]]) - INSIDE
    for p in range(len(frozen.pairs)):
        inside[len(frozen.edges) + p] = _gap(frozen, vectors, p)
    return quality_mm, inside


@compiled
def _gap(frozen: Frozen, vectors: Array, p: int) -> float:
    square = -(frozen.apart_m[p] ** 2) - INSIDE
    for axis in range(Y + 1):
        square += (vectors[frozen.pairs[p, 0], axis] - vectors[frozen.pairs[p, 1], axis]) ** 2
    return float(square)


@compiled
def totals(problem: Problem, frozen: Frozen, vectors: Array) -> tuple[Array, Array]:
    """Return what all cameras add up to at each target (m, C), and its derivatives (m, size, C)."""
    channels = CHANNELS[int(problem.settings[QUALITY])]
    count, size = len(problem.targets), int(frozen.column.max()) + 1
    total, by = np.zeros((count, channels)), np.zeros((count, size, channels))
    for i in range(len(vectors)):
        targets: Ints = np.flatnonzero(frozen.seen[i]).astype(np.int64)
        worths, slopes = np.empty((len(targets), channels)), np.empty((len(targets), VARIABLES, channels))
        worth_slopes(problem, i, vectors[i], frozen.anchors[i], targets, worths, slopes)
        for t in range(len(targets)):
            for c in range(channels):
                total[targets[t], c] += worths[t, c]
                for variable in range(VARIABLES):
                    if frozen.column[i, variable] >= 0:
                        by[targets[t], frozen.column[i, variable], c] += slopes[t, variable, c]
    return total, by


@compiled
def qualities_of(problem: Problem, total: Array, by: Array, share: Array) -> tuple[Array, Array]:
    """Return qualities (m,) in mm and their slopes (m, size) from those of what is added up."""
    quality = int(problem.settings[QUALITY])
    quality_mm, slopes, of_channel = np.zeros(len(total)), np.zeros(by.shape[:2]), np.empty(total.shape[1])
    for j in range(len(total)):
        if share[j] <= 0.0:
            continue
        quality_mm[j] = MM * quality_slopes(total[j], quality, of_channel)
        for k in range(by.shape[1]):
            for c in range(total.shape[1]):
                slopes[j, k] += MM * of_channel[c] * by[j, k, c]
    return quality_mm, slopes


@compiled
def kept_of(problem: Problem, frozen: Frozen, vectors: Array, size: int) -> tuple[Array, Array]:
    """Return the constraints (Q + P,) and their Jacobian (Q + P, size)."""
    edges = len(frozen.edges)
    inside, slopes = np.empty(edges + len(frozen.pairs)), np.zeros((edges + len(frozen.pairs), size))
    view, view_slopes = clearances(problem, frozen.edges, vectors, frozen.column, size)
    inside[:edges], slopes[:edges] = view - INSIDE, view_slopes
    for p in range(len(frozen.pairs)):
        inside[edges + p] = _gap(frozen, vectors, p)
        one, other = frozen.pairs[p, 0], frozen.pairs[p, 1]
        for axis in range(Y + 1):
            gap = vectors[one, axis] - vectors[other, axis]
            if frozen.column[one, axis] >= 0:
                slopes[edges + p, frozen.column[one, axis]] = 2.0 * gap
            if frozen.column[other, axis] >= 0:
                slopes[edges + p, frozen.column[other, axis]] = -2.0 * gap
    return inside, slopes


@compiled
def hessian_of(
    problem: Problem,
    frozen: Frozen,
    vectors: Array,
    total: Array,
    by: Array,
    importance: Array,
    prices: Array,
) -> Array:
    """Return the Lagrangian's second derivatives (size, size): of the qualities in mm, each counting its ``importance``
    (m,), less those of the constraints at their ``prices`` (Q + P,). ``total`` and ``by`` are ``totals``.
    """
    quality = int(problem.settings[QUALITY])
    size, edges = by.shape[1], len(frozen.edges)
    matrix, price, of_channel = np.zeros((size, size)), np.zeros(total.shape), np.empty(total.shape[1])
    for j in range(len(total)):
        if importance[j] > 0.0:
            add_fusion(total[j], by[j], quality, MM * importance[j], matrix)
            quality_slopes(total[j], quality, of_channel)
            price[j] = MM * importance[j] * of_channel
    add_cameras(problem, vectors, frozen.seen, frozen.anchors, frozen.column, by, price, matrix)
    add_view(problem, vectors, frozen.edges, frozen.column, -prices[:edges], matrix)
    add_gaps(frozen.pairs, frozen.column, -prices[edges:], matrix)
    return matrix
