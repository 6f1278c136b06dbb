"""The problem with a smooth visibility: every camera sees every target a little. Compiled.

V = 1 / (1 + sum_e exp(-k c_e)) over the clearances c_e of a view's edges. A cone has one, cos(beta) - cos(alpha), so V
is the logistic function of it. A picture has four, as shares of its width, for the point or for each corner of the tag,
and that of the cone within which the lens holds. V is 1/2 on an edge, and tends to the hard visibility as the sharpness
k grows. Range, flatness, size in the picture, boxes and anchors are left to the hard visibility.

What is not in front of a camera, or lies past the lens's ``r_max``, is rated as if it were so far in front that it is
just within: V is next to nothing there, but its product with a rating must be finite.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import ALPHA, R_MAX, WIDTH
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import (
    CHANNELS,
    CONE,
    FISHER,
    MARGIN,
    PIXEL,
    POINT,
    QUALITY,
    REACH,
    ROOM,
    TAGGED,
    VARIABLES,
    Ints,
    Problem,
)
from camrig.optimise.kernels.sight import NEAR_M, to_camera
from camrig.optimise.kernels.slopes import STEP
from camrig.optimise.kernels.worth import add_worth, known_pose, quality_slopes
from camrig.sensing.point import perspective_gain, pixel_gain
from camrig.sensing.view import image_clearance

AXIS_M2 = 1e-12
"""Added to the square of the distance from the axis: the distance itself has no slope on the axis."""


@compiled
def smoothed(
    problem: Problem, vectors: Array, column: Ints, size: int, sharpness: float, unseen_m: float
) -> tuple[Array, Array, Array, Array]:
    """Return the fused quality (m,) with its gradient (m, size), and the logarithm of sum V (m,) with its own.

    ``column`` (n, 6) is the place of a camera's variable among the joint ones, -1 for what is not free. Everybody knows
    as much of a target as makes its quality ``unseen_m`` (infinite: nothing). Slopes are central differences.
    """
    n, m = len(vectors), len(problem.targets)
    quality = int(problem.settings[QUALITY])
    channels = CHANNELS[quality]
    total, by = _known_to_all(quality, m, unseen_m), np.zeros((m, size, channels))
    views, by_view = np.empty((n, m)), np.zeros((m, size))
    worths, before, after = np.empty((m, channels)), np.empty((m, channels)), np.empty((m, channels))
    view_before, view_after = np.empty(m), np.empty(m)
    for i in range(n):
        _look_softly(problem, i, vectors[i], sharpness, views[i], worths)
        total += worths
        u = vectors[i].copy()
        for variable in range(VARIABLES):
            k = column[i, variable]
            if k < 0:
                continue
            u[variable] = vectors[i, variable] - STEP
            _look_softly(problem, i, u, sharpness, view_before, before)
            u[variable] = vectors[i, variable] + STEP
            _look_softly(problem, i, u, sharpness, view_after, after)
            u[variable] = vectors[i, variable]
            by[:, k] = (after - before) / (2.0 * STEP)
            by_view[:, k] = (view_after - view_before) / (2.0 * STEP)
    value, gradient = np.empty(m), np.zeros((m, size))
    of_channel = np.empty(channels)
    for j in range(m):
        value[j] = quality_slopes(total[j], quality, of_channel)
        for k in range(size):
            for c in range(channels):
                gradient[j, k] += of_channel[c] * by[j, k, c]
    return value, gradient, _summed(views, by_view, column), by_view


@compiled
def _known_to_all(quality: int, m: int, unseen_m: float) -> Array:
    """Return the channels (m, C) that alone have the quality ``unseen_m``."""
    total = np.zeros((m, CHANNELS[quality]))
    if quality == FISHER:
        for c in (0, 3, 5):  # the diagonal; the rms of a place is the root of its covariance's trace
            total[:, c] = 3.0 / unseen_m**2
    else:
        total[:, 0] = 1.0 / unseen_m
    return total


@compiled
def _summed(views: Array, by_view: Array, column: Ints) -> Array:
    """Return log sum V (m,) of log V (n, m), and turn the slopes of each camera's log V into those of that."""
    out = np.empty(views.shape[1])
    for j in range(len(out)):
        highest = views[:, j].max()
        out[j] = highest + math.log(np.exp(views[:, j] - highest).sum())
        for i in range(len(views)):
            share = math.exp(views[i, j] - out[j])
            for variable in range(VARIABLES):
                if column[i, variable] >= 0:
                    by_view[j, column[i, variable]] *= share
    return out


@compiled
def _look_softly(problem: Problem, i: int, u: Array, sharpness: float, views: Array, worths: Array) -> None:
    """Fill log V (m,) of camera ``i`` from a vector, and V times what it adds to each target, (m, C)."""
    lens = lens_of(problem.cameras[i], problem.lenses, u)
    R, origin = pose_of(problem.cameras[i], u)
    quality = int(problem.settings[QUALITY])
    known = known_pose(problem, i, u, lens, R, origin)
    worths[:, :] = 0.0
    for j in range(len(problem.targets)):
        target = problem.targets[j]
        views[j] = _log_view(problem, lens, R, origin, target, sharpness)
        x, y, z = to_camera(R, origin, target, POINT)
        depth = _depth(lens, x, y, z)
        share = math.exp(views[j])
        if quality == PIXEL:
            worths[j, 0] = share * pixel_gain(lens, x, y, depth)
        elif quality != FISHER:
            worths[j, 0] = share * perspective_gain(lens, x, y, depth)
        elif depth == z:  # a tag cannot be moved to the front as a point can
            add_worth(quality, lens, R, origin, known, target, share, worths[j])


@compiled
def _depth(lens: Array, x: float, y: float, z: float) -> float:
    """Return the depth of a point, at least that at which it is within ``r_max``."""
    return float(max(z, math.sqrt(x * x + y * y + AXIS_M2) / lens[R_MAX], NEAR_M))


@compiled
def _log_view(problem: Problem, lens: Array, R: Array, origin: Array, target: Array, sharpness: float) -> float:
    margin_rad = problem.settings[MARGIN]
    holds = math.atan(lens[R_MAX]) - margin_rad
    x, y, z = to_camera(R, origin, target, POINT)
    distance = math.sqrt(x * x + y * y + z * z + AXIS_M2)
    if problem.settings[CONE] > 0.0:
        half = min(lens[ALPHA] - margin_rad, holds) - math.atan(target[REACH] / _depth(lens, x, y, z))
        return -_log_sum(0.0, -sharpness * (z / distance - math.cos(half)))
    out = _log_sum(0.0, -sharpness * (z / distance - math.cos(holds)))
    whole = target[TAGGED] > 0.0
    for corner in range(4 if whole else 1):
        x, y, z = to_camera(R, origin, target, ROOM + 3 * corner if whole else POINT)
        inside = image_clearance(lens, x, y, _depth(lens, x, y, z), margin_rad)
        for edge in range(4):
            out = _log_sum(out, -sharpness * inside[edge] / lens[WIDTH])
    return -out


@compiled
def _log_sum(a: float, b: float) -> float:
    """Return log(exp(a) + exp(b))."""
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))
