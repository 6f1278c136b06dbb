"""How far inside its edges of view a camera has what it sees: the constraints of the smooth problem. Compiled.

Their slopes are central differences of compiled formulas.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import ALPHA, WIDTH
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import (
    CONE,
    HIGH,
    LOW,
    MARGIN,
    POINT,
    REACH,
    ROOM,
    TAGGED,
    VARIABLES,
    ZOOM,
    Flags,
    Ints,
    Problem,
)
from camrig.optimise.kernels.sight import to_camera
from camrig.optimise.kernels.slopes import STEP
from camrig.sensing.view import cone_clearance, image_clearance

CENTRE, EDGES = 4, 5


@compiled
def active_edges(problem: Problem, vectors: Array, seen: Flags, anchors: Flags, share: float) -> Ints:
    """Return the rows (Q, 4) of clearances below ``share`` of the view: camera, target (below 0: anchor -1 - k),
    corner (or ``CENTRE``), edge. ``anchors`` (n, A) are those that a camera must go on seeing.
    """
    found = np.empty((seen.size * CENTRE * EDGES + anchors.size * CENTRE * EDGES, 4), dtype=np.int64)
    count = 0
    cone = problem.settings[CONE] > 0.0
    row = np.empty(4, dtype=np.int64)
    for i in range(len(vectors)):
        if not (problem.cameras[i, LOW : LOW + VARIABLES] < problem.cameras[i, HIGH : HIGH + VARIABLES]).any():
            continue
        for j in range(-anchors.shape[1], seen.shape[1]):
            if (j >= 0 and not seen[i, j]) or (j < 0 and not anchors[i, -1 - j]):
                continue
            whole = not cone and (j < 0 or problem.targets[j, TAGGED] > 0.0)
            for corner in range(0 if whole else CENTRE, CENTRE if whole else CENTRE + 1):
                for edge in range(1 if cone else EDGES):
                    row[0], row[1], row[2], row[3] = i, j, corner, edge
                    if clearance(problem, row, vectors[i]) < share:
                        found[count] = row
                        count += 1
    return found[:count].copy()


@compiled
def clearance(problem: Problem, row: Ints, u: Array) -> float:
    """Return how far inside an edge of view a point is, as a share of the view."""
    lens = lens_of(problem.cameras[row[0]], problem.lenses, u)
    R, origin = pose_of(problem.cameras[row[0]], u)
    return _clearance_from(problem, row, lens, R, origin)


@compiled
def _clearance_from(problem: Problem, row: Ints, lens: Array, R: Array, origin: Array) -> float:
    target = problem.targets[row[1]] if row[1] >= 0 else problem.anchors[-1 - row[1]]
    corner = row[2]
    x, y, z = to_camera(R, origin, target, POINT if corner == CENTRE else ROOM + 3 * corner)
    margin_rad = problem.settings[MARGIN]
    if problem.settings[CONE] > 0.0:
        widened = margin_rad + (math.atan(target[REACH] / z) if z > 0.0 else 0.0)
        return float(cone_clearance(lens, x, y, z, widened) / lens[ALPHA])
    return float(image_clearance(lens, x, y, z, margin_rad)[row[3]] / lens[WIDTH])


@compiled
def clearances(problem: Problem, rows: Ints, vectors: Array, column: Ints, size: int) -> tuple[Array, Array]:
    """Return the clearances (Q,) of rows that are in the order of cameras, and their Jacobian (Q, size)."""
    value, jacobian, slopes = np.empty(len(rows)), np.zeros((len(rows), size)), np.empty((len(rows), VARIABLES))
    first = 0
    while first < len(rows):
        i, end = rows[first, 0], first
        while end < len(rows) and rows[end, 0] == i:
            value[end] = clearance(problem, rows[end], vectors[i])
            end += 1
        clearance_slopes(problem, rows[first:end], vectors[i], column[i], slopes[first:end])
        for variable in range(VARIABLES):
            if column[i, variable] >= 0:
                jacobian[first:end, column[i, variable]] = slopes[first:end, variable]
        first = end
    return value, jacobian


@compiled
def clearance_slopes(problem: Problem, rows: Ints, u: Array, column: Ints, slopes: Array) -> None:
    """Fill the derivatives (Q, 6) of one camera's clearances by its variables; 0 where its column (6,) is below 0."""
    slopes[:, :] = 0.0
    if len(rows) == 0:
        return
    i = rows[0, 0]
    for variable in range(VARIABLES):
        if column[variable] < 0:
            continue
        ends = u[variable] - STEP, u[variable] + STEP
        if variable == ZOOM:  # beyond its table a lens stays as it is
            ends = max(ends[0], problem.cameras[i, LOW + ZOOM]), min(ends[1], problem.cameras[i, HIGH + ZOOM])
        for side in range(2):
            moved = u.copy()
            moved[variable] = ends[side]
            lens = lens_of(problem.cameras[i], problem.lenses, moved)
            R, origin = pose_of(problem.cameras[i], moved)
            share = (2.0 * side - 1.0) / (ends[1] - ends[0])
            for q in range(len(rows)):
                slopes[q, variable] += share * _clearance_from(problem, rows[q], lens, R, origin)
