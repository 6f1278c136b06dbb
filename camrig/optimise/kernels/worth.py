"""What a camera adds to a target (a gain or an information), and what the sum of all cameras is worth. Compiled."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.pose import pose_covariance
from camrig.optimise.kernels.problem import CORNERS, FISHER, PIXEL, POINT, QUALITY, Flags, Problem
from camrig.optimise.kernels.sight import cone_cosine, sees, to_camera
from camrig.sensing.fisher import invert_symmetric, place_covariance, tag_information
from camrig.sensing.point import perspective_gain, pixel_gain

_MOST_KNOWN = 1e12
"""tr S N of a pose known to a metre and a radian beforehand, to a micrometre and a microradian after: no picture
tells more, and (6, 6) matrices are still solved safely.
"""


@compiled
def known_pose(problem: Problem, i: int, u: Array, lens: Array, R: Array, origin: Array) -> Array:
    """Return the (6, 6) covariance of camera ``i``'s place and turn in the world, with all the anchors it sees.

    Only the Fisher model asks: for the others it is empty.
    """
    if problem.settings[QUALITY] != FISHER:
        return np.empty((0, 0))
    return pose_known_by(problem, i, u, anchors_in_view(problem, lens, R, origin), lens, R, origin)


@compiled
def anchors_in_view(problem: Problem, lens: Array, R: Array, origin: Array) -> Flags:
    """Return which anchors (A,) are seen from a pose."""
    out = np.zeros(len(problem.anchors), dtype=np.bool_)
    cosine = cone_cosine(problem.settings, lens)
    for k in range(len(out)):
        out[k] = sees(problem.settings, problem.boxes, lens, cosine, R, origin, problem.anchors[k])
    return out


@compiled
def pose_known_by(problem: Problem, i: int, u: Array, anchors: Flags, lens: Array, R: Array, origin: Array) -> Array:
    """Return what ``known_pose`` would if the camera saw just these anchors (A,), wherever they are; empty too where
    the model does not ask.
    """
    if problem.settings[QUALITY] != FISHER:
        return np.empty((0, 0))
    covariance = np.empty((6, 6))
    pose_covariance(problem.cameras[i], u, covariance)
    if not anchors.any():
        return covariance
    total, found = np.zeros((6, 6)), np.empty((6, 6))
    corners, camera, centre = np.empty((4, 3)), np.zeros(3), np.empty(3)
    for k in np.flatnonzero(anchors):
        anchor = problem.anchors[k]
        _corners_in_camera(R, origin, anchor, corners)
        centre[0], centre[1], centre[2] = to_camera(R, origin, anchor, POINT)
        tag_information(lens, corners, centre, camera, found)
        total += found
    turn = np.zeros((6, 6))
    turn[:3, :3] = R
    turn[3:, 3:] = R
    return with_information(covariance, turn @ total @ turn.T)


@compiled
def with_information(covariance: Array, information: Array) -> Array:
    """Return (S^-1 + N)^-1 of (6, 6) matrices, without S^-1: a pose may be known exactly.

    A step tried may put an anchor where the lens's polynomial means nothing: N beyond all bounds is cut down, and one
    that is no number tells nothing.
    """
    amount = np.trace(covariance @ information)
    if not math.isfinite(amount):
        return covariance
    share = min(1.0, _MOST_KNOWN / amount) if amount > 0.0 else 1.0
    return np.ascontiguousarray(np.linalg.solve(np.eye(6) + covariance @ (share * information), covariance))


@compiled
def add_worth(
    quality: int, lens: Array, R: Array, origin: Array, known: Array, target: Array, sign: float, out: Array
) -> None:
    """Add ``sign`` times what a camera makes of a target (a row), which it sees, to the channels (C,)."""
    if quality == FISHER:
        corners, information, lever = np.empty((4, 3)), np.empty((6, 6)), np.empty((3, 6))
        noise, covariance, found = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        place_noise(lens, R, origin, target, corners, information, lever, noise)
        to_world(R, noise, covariance)
        A = lever_of(origin, target)
        covariance += A @ known @ A.T
        invert_symmetric(covariance, found)
        at = 0
        for k in range(3):
            for h in range(k, 3):
                out[at] += sign * found[k, h]
                at += 1
        return
    x, y, z = to_camera(R, origin, target, POINT)
    out[0] += sign * (pixel_gain(lens, x, y, z) if quality == PIXEL else perspective_gain(lens, x, y, z))


@compiled
def place_noise(
    lens: Array,
    R: Array,
    origin: Array,
    target: Array,
    in_camera: Array,
    information: Array,
    lever: Array,
    noise: Array,
) -> None:
    """Fill the (3, 3) covariance, in the camera's frame, of a tag's place by its corners' noise; and all on the way."""
    _corners_in_camera(R, origin, target, in_camera)
    centre = np.empty(3)
    centre[0], centre[1], centre[2] = to_camera(R, origin, target, POINT)
    tag_information(lens, in_camera, centre, centre, information)
    place_covariance(information, noise, lever)


@compiled
def _corners_in_camera(R: Array, origin: Array, target: Array, out: Array) -> None:
    for k in range(4):
        out[k, 0], out[k, 1], out[k, 2] = to_camera(R, origin, target, CORNERS + 3 * k)


@compiled
def to_world(R: Array, inside: Array, out: Array) -> None:
    """Fill R C R^T of a (3, 3) matrix in the camera's frame."""
    for k in range(3):
        for h in range(3):
            value = 0.0
            for a in range(3):
                for b in range(3):
                    value += R[k, a] * inside[a, b] * R[h, b]
            out[k, h] = value


@compiled
def lever_of(origin: Array, point: Array) -> Array:
    """Return A (3, 6): a point seen from a camera moves rigidly with the camera's error, by A (displacement, turn).

    So a pose known with covariance S adds A S A^T to what is known of the point.
    """
    A = np.zeros((3, 6))
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    A[0, 0] = A[1, 1] = A[2, 2] = 1.0
    A[0, 4], A[0, 5] = z, -y
    A[1, 3], A[1, 5] = -z, x
    A[2, 3], A[2, 4] = y, -x
    return A


@compiled
def quality_of(total: Array, quality: int) -> float:
    """Return what the channels (C,) of all cameras together mean in metres: 1/gain, or the rms of the place's error."""
    if quality != FISHER:
        return float(1.0 / total[0])
    xx, xy, xz, yy, yz, zz = total[0], total[1], total[2], total[3], total[4], total[5]
    c_xx, c_yy, c_zz = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    det = xx * c_xx + xy * (xz * yz - xy * zz) + xz * (xy * yz - xz * yy)
    return math.sqrt((c_xx + c_yy + c_zz) / det)


@compiled
def quality_slopes(total: Array, quality: int, out: Array) -> float:
    """Return ``quality_of`` and fill its derivatives by the channels (C,)."""
    value = quality_of(total, quality)
    if quality != FISHER:
        out[0] = -value * value
        return value
    matrix, inverse = np.empty((3, 3)), np.empty((3, 3))
    at = 0
    for k in range(3):
        for h in range(k, 3):
            matrix[k, h] = matrix[h, k] = total[at]
            at += 1
    invert_symmetric(matrix, inverse)
    at = 0
    for k in range(3):
        for h in range(k, 3):
            # d trace(M^-1) = -trace(M^-2 dM); an entry off the diagonal stands in M twice.
            square = inverse[k, 0] * inverse[0, h] + inverse[k, 1] * inverse[1, h] + inverse[k, 2] * inverse[2, h]
            out[at] = -(1.0 if k == h else 2.0) * square / (2.0 * value)
            at += 1
    return value
