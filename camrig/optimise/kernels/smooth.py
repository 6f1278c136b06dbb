"""The smooth problem beside a configuration: what each camera sees now it must go on seeing; nothing else counts.

Qualities and their gradients are analytic; the clearances of view that bind the solver are central differences of
compiled formulas. Compiled.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import (
    CHANNELS,
    CONE,
    HIGH,
    LOW,
    MARGIN,
    POINT,
    QUALITY,
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
from camrig.optimise.kernels.slopes import STEP, worth_slopes
from camrig.optimise.kernels.worth import quality_slopes
from camrig.sensing.lens_row import ALPHA, WIDTH
from camrig.sensing.view import cone_clearance, image_clearance

CENTRE, EDGES = 4, 5


@compiled
def qualities(problem: Problem, vectors: Array, seen: Flags, column: Ints, size: int) -> tuple[Array, Array]:
    """Return the fused quality (m,) of what is seen (n, m), and its gradient (m, size).

    ``column`` (n, 6) is the place of a camera's variable among the joint ones, -1 for what is not free. What nobody
    sees has quality 0.
    """
    quality = int(problem.settings[QUALITY])
    channels = CHANNELS[quality]
    count = len(problem.targets)
    total, value = np.zeros((count, channels)), np.zeros(count)
    by, gradient = np.zeros((count, size, channels)), np.zeros((count, size))
    for i in range(len(vectors)):
        targets: Ints = np.flatnonzero(seen[i]).astype(np.int64)
        worths, slopes = np.empty((len(targets), channels)), np.empty((len(targets), VARIABLES, channels))
        worth_slopes(problem, i, vectors[i], targets, worths, slopes)
        for t in range(len(targets)):
            total[targets[t]] += worths[t]
            for variable in range(VARIABLES):
                if column[i, variable] >= 0:
                    by[targets[t], column[i, variable]] += slopes[t, variable]
    of_channel = np.empty(channels)
    for j in range(count):
        if not seen[:, j].any():
            continue
        value[j] = quality_slopes(total[j], quality, of_channel)
        for k in range(size):
            for c in range(channels):
                gradient[j, k] += of_channel[c] * by[j, k, c]
    return value, gradient


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
    camera, corner = problem.cameras[row[0]], row[2]
    target = problem.targets[row[1]] if row[1] >= 0 else problem.anchors[-1 - row[1]]
    lens = lens_of(camera, problem.lenses, u)
    R, origin = pose_of(camera, u)
    x, y, z = to_camera(R, origin, target, POINT if corner == CENTRE else ROOM + 3 * corner)
    margin_rad = problem.settings[MARGIN]
    if problem.settings[CONE] > 0.0:
        widened = margin_rad + (math.atan(target[REACH] / z) if z > 0.0 else 0.0)
        return float(cone_clearance(lens, x, y, z, widened) / lens[ALPHA])
    return float(image_clearance(lens, x, y, z, margin_rad)[row[3]] / lens[WIDTH])


@compiled
def clearances(problem: Problem, rows: Ints, vectors: Array, column: Ints, size: int) -> tuple[Array, Array]:
    """Return the clearances (Q,) and their Jacobian (Q, size)."""
    value, slopes = np.empty(len(rows)), np.zeros((len(rows), size))
    for q in range(len(rows)):
        i = rows[q, 0]
        value[q] = clearance(problem, rows[q], vectors[i])
        u = vectors[i].copy()
        for variable in range(VARIABLES):
            if column[i, variable] < 0:
                continue
            before, after = vectors[i, variable] - STEP, vectors[i, variable] + STEP
            if variable == ZOOM:  # beyond its table a lens stays as it is
                before = max(before, problem.cameras[i, LOW + ZOOM])
                after = min(after, problem.cameras[i, HIGH + ZOOM])
            u[variable] = after
            ahead = clearance(problem, rows[q], u)
            u[variable] = before
            slopes[q, column[i, variable]] = (ahead - clearance(problem, rows[q], u)) / (after - before)
            u[variable] = vectors[i, variable]
    return value, slopes
