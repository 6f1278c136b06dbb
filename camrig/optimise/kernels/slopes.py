"""How what a camera adds to a target changes with the camera's free variables: analytic but for a zoom. Compiled."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.pose import lens_of, pose_of, twist_of
from camrig.optimise.kernels.problem import (
    FISHER,
    HIGH,
    LOW,
    PIXEL,
    POINT,
    QUALITY,
    VARIABLES,
    ZOOM,
    Flags,
    Ints,
    Problem,
)
from camrig.optimise.kernels.sight import to_camera
from camrig.optimise.kernels.worth import add_worth, lever_of, place_noise, pose_known_by, to_world
from camrig.sensing.fisher import information_slope, invert_symmetric
from camrig.sensing.point import perspective_gain_slopes, pixel_gain_slopes

STEP = 1e-5
"""Of central differences: a zoom's, and those of the pose's covariance with the anchors in view.

Refined corners make that covariance small beside what it is solved from: with 1e-6 rounding shows (1e-5 of a slope).
"""


@compiled
def worth_slopes(
    problem: Problem, i: int, u: Array, anchors: Flags, targets: Ints, worths: Array, slopes: Array
) -> None:
    """Fill what camera ``i`` adds to each of the targets (T,), worths (T, C), and its slopes (T, 6, C) by variable.

    All the targets and the ``anchors`` (A,) count as seen; variables that are not free get 0.
    """
    lens = lens_of(problem.cameras[i], problem.lenses, u)
    R, origin = pose_of(problem.cameras[i], u)
    quality = int(problem.settings[QUALITY])
    worths[:, :] = 0.0
    slopes[:, :, :] = 0.0
    twists = np.zeros((VARIABLES, 6))
    for variable in range(VARIABLES):
        if problem.cameras[i, LOW + variable] < problem.cameras[i, HIGH + variable]:
            if variable == ZOOM:
                _zoom_slopes(problem, i, u, anchors, targets, slopes)
            else:
                twist_of(problem.cameras[i], u, variable, twists[variable])
    if quality != FISHER:
        _gain_slopes(problem, lens, R, origin, twists, targets, worths, slopes)
        return
    known = pose_known_by(problem, i, u, anchors, lens, R, origin)
    for t in range(len(targets)):
        add_worth(quality, lens, R, origin, known, problem.targets[targets[t]], 1.0, worths[t])
    for variable in range(ZOOM):
        if problem.cameras[i, LOW + variable] < problem.cameras[i, HIGH + variable]:
            known_by = _known_slope(problem, i, u, anchors, variable)
            _information_slopes(
                problem, lens, R, origin, known, known_by, twists[variable], targets, slopes[:, variable]
            )


@compiled
def _gain_slopes(
    problem: Problem,
    lens: Array,
    R: Array,
    origin: Array,
    twists: Array,
    targets: Ints,
    worths: Array,
    slopes: Array,
) -> None:
    by = np.empty(3)
    for t in range(len(targets)):
        target = problem.targets[targets[t]]
        x, y, z = to_camera(R, origin, target, POINT)
        if problem.settings[QUALITY] == PIXEL:
            worths[t, 0], by_x, by_y, by_z = pixel_gain_slopes(lens, x, y, z)
        else:
            worths[t, 0], by_x, by_y, by_z = perspective_gain_slopes(lens, x, y, z)
        for k in range(3):
            by[k] = R[k, 0] * by_x + R[k, 1] * by_y + R[k, 2] * by_z
        for variable in range(ZOOM):
            for k in range(3):
                slopes[t, variable, 0] += by[k] * _drift(twists[variable], origin, target, k)


@compiled
def _drift(twist: Array, origin: Array, point: Array, k: int) -> float:
    """Return the velocity, along world axis ``k``, at which a fixed point moves past a camera of this twist."""
    a, b = (k + 1) % 3, (k + 2) % 3
    turned = twist[3 + a] * (point[b] - origin[b]) - twist[3 + b] * (point[a] - origin[a])
    return float(-twist[k] - turned)


@compiled
def _information_slopes(
    problem: Problem,
    lens: Array,
    R: Array,
    origin: Array,
    known: Array,
    known_by: Array,
    twist: Array,
    targets: Ints,
    slopes: Array,
) -> None:
    corners, information, lever = np.empty((4, 3)), np.empty((6, 6)), np.empty((3, 6))
    noise, covariance, found = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    slope, centre = np.empty((6, 6)), np.empty(3)
    turned = np.zeros((3, 3))  # [turn]x of the camera, in the world
    turned[0, 1], turned[0, 2], turned[1, 2] = -twist[5], twist[4], -twist[3]
    turned[1, 0], turned[2, 0], turned[2, 1] = twist[5], -twist[4], twist[3]
    moved = np.empty(6)  # the scene past the camera, in the camera's frame
    for k in range(3):
        moved[k] = -(R[0, k] * twist[0] + R[1, k] * twist[1] + R[2, k] * twist[2])
        moved[3 + k] = -(R[0, k] * twist[3] + R[1, k] * twist[4] + R[2, k] * twist[5])
    for t in range(len(targets)):
        target = problem.targets[targets[t]]
        place_noise(lens, R, origin, target, corners, information, lever, noise)
        centre[0], centre[1], centre[2] = to_camera(R, origin, target, POINT)
        information_slope(lens, corners, centre, moved, slope)
        to_world(R, noise, covariance)
        by = R @ (-noise @ (lever @ slope @ lever.T) @ noise) @ R.T
        rotated = turned @ covariance
        A = lever_of(origin, target)
        A_by = lever_of(origin, origin - twist[:3])
        A_by[0, 0] = A_by[1, 1] = A_by[2, 2] = 0.0
        crossed = A_by @ known @ A.T
        by += rotated + rotated.T + crossed + crossed.T + A @ known_by @ A.T
        covariance += A @ known @ A.T
        invert_symmetric(covariance, found)
        change = -found @ by @ found
        at = 0
        for k in range(3):
            for h in range(k, 3):
                slopes[t, at] += change[k, h]
                at += 1


@compiled
def _known_slope(problem: Problem, i: int, u: Array, anchors: Flags, variable: int) -> Array:
    step = np.zeros(VARIABLES)
    step[variable] = STEP
    R_a, origin_a = pose_of(problem.cameras[i], u - step)
    R_b, origin_b = pose_of(problem.cameras[i], u + step)
    lens = lens_of(problem.cameras[i], problem.lenses, u)
    before = pose_known_by(problem, i, u - step, anchors, lens, R_a, origin_a)
    after = pose_known_by(problem, i, u + step, anchors, lens, R_b, origin_b)
    return (after - before) / (2.0 * STEP)


@compiled
def _zoom_slopes(problem: Problem, i: int, u: Array, anchors: Flags, targets: Ints, slopes: Array) -> None:
    R, origin = pose_of(problem.cameras[i], u)
    quality = int(problem.settings[QUALITY])
    # Beyond its table a lens stays as it is: at an end of it the difference is one-sided.
    ends = max(u[ZOOM] - STEP, problem.cameras[i, LOW + ZOOM]), min(u[ZOOM] + STEP, problem.cameras[i, HIGH + ZOOM])
    for sign in (-1.0, 1.0):
        moved = u.copy()
        moved[ZOOM] = ends[1] if sign > 0.0 else ends[0]
        lens = lens_of(problem.cameras[i], problem.lenses, moved)
        known = pose_known_by(problem, i, moved, anchors, lens, R, origin)
        for t in range(len(targets)):
            target = problem.targets[targets[t]]
            share = sign / (ends[1] - ends[0])
            add_worth(quality, lens, R, origin, known, target, share, slopes[t, ZOOM])
