"""How well a tag's corners tell its place: Fisher information, in metres. Compiled, pure; optical frame of one camera.

The corners' noise (geometry.corner_noise) gives the (6, 6) information of the tag's pose; what the unknown rotation
takes from it is taken away (Schur complement), and the (3, 3) inverse is the covariance of the tag's place that no
estimator from this one view beats. A pose is perturbed by (dt, dphi): a point q goes to q + dt + dphi x (q - centre).
The error of the camera's own pose moves whatever it sees rigidly: it is added to that covariance as a whole, which by
the matrix inversion lemma is the same as marginalising it in the corners' information.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.corner_noise import (
    BEND_PER_PX,
    NOISE_PX,
    REFINED_PX,
    REFINED_PX2,
    SMALL_TAG_PX2,
    UNREFINED_POWER,
    UNREFINED_WIDTH_PX,
)
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import FX, FY, REFINED, curvatures_at, pixel_at, slopes_at


@compiled
def corner_rows(lens: Array, corner: Array, centre: Array, rows: Array) -> None:
    """Fill (2, 6) d pixel / d (dt, dphi) of one corner (3,) of a tag about its centre (3,)."""
    z = corner[2]
    a, b = corner[0] / z, corner[1] / z
    ua, ub, va, vb = slopes_at(lens, a, b)
    rows[0, 0], rows[0, 1] = lens[FX] * ua / z, lens[FX] * ub / z
    rows[1, 0], rows[1, 1] = lens[FY] * va / z, lens[FY] * vb / z
    arm_x, arm_y, arm_z = corner[0] - centre[0], corner[1] - centre[1], corner[2] - centre[2]
    for k in range(2):
        rows[k, 2] = -(rows[k, 0] * a + rows[k, 1] * b)
        rows[k, 3] = rows[k, 2] * arm_y - rows[k, 1] * arm_z
        rows[k, 4] = rows[k, 0] * arm_z - rows[k, 2] * arm_x
        rows[k, 5] = rows[k, 1] * arm_x - rows[k, 0] * arm_y


@compiled
def corner_sigma(lens: Array, corners: Array, centre: Array) -> float:
    """Return one sigma in pixels of the corners (4, 3) of a tag: geometry.corner_noise, as a plan expects them."""
    twice_area = 0.0
    last_x, last_y = pixel_at(lens, corners[3, 0], corners[3, 1], corners[3, 2])
    for k in range(4):
        at_x, at_y = pixel_at(lens, corners[k, 0], corners[k, 1], corners[k, 2])
        twice_area += last_x * at_y - last_y * at_x
        last_x, last_y = at_x, at_y
    width = math.sqrt(abs(twice_area) / 2.0)
    if lens[REFINED] > 0.0:
        width = max(width, 1.0)
        unrefined = (UNREFINED_WIDTH_PX / width) ** UNREFINED_POWER
        return math.sqrt(REFINED_PX**2 + (REFINED_PX2 / width) ** 2 + unrefined * unrefined)
    bend = BEND_PER_PX * math.hypot(centre[0], centre[1]) / centre[2] * width * width
    return math.hypot(max(NOISE_PX, SMALL_TAG_PX2 / max(width, 1.0)), bend)


@compiled
def tag_information(lens: Array, corners: Array, centre: Array, about: Array, information: Array) -> None:
    """Fill the (6, 6) information of (dt, dphi) about a point from a tag's four corners (4, 3).

    ``about`` its centre it is that of the tag's pose; ``about`` the camera (0, 0, 0), that of the camera's.
    """
    rows = np.empty((2, 6))
    information[:, :] = 0.0
    weight = 1.0 / corner_sigma(lens, corners, centre) ** 2
    for k in range(4):
        corner_rows(lens, corners[k], about, rows)
        for i in range(6):
            for j in range(6):
                information[i, j] += weight * (rows[0, i] * rows[0, j] + rows[1, i] * rows[1, j])


@compiled
def place_covariance(information: Array, covariance: Array, lever: Array) -> None:
    """Fill the (3, 3) covariance of the place from the (6, 6) information of the pose.

    ``lever`` (3, 6) becomes [I, -N_pr N_rr^-1]: the place's share of an information is lever N lever^T, and to first
    order it stays so while N changes.
    """
    inverse = np.empty((3, 3))
    invert_symmetric(information[3:, 3:], inverse)
    for i in range(3):
        for j in range(3):
            lever[i, j] = 1.0 if i == j else 0.0
            cross = 0.0
            for k in range(3):
                cross += information[i, 3 + k] * inverse[k, j]
            lever[i, 3 + j] = -cross
    reduced = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            value = information[i, j]
            for k in range(3):
                value += lever[i, 3 + k] * information[3 + k, j]
            reduced[i, j] = value
    invert_symmetric(reduced, covariance)


@compiled
def invert_symmetric(matrix: Array, inverse: Array) -> None:
    """Fill the inverse of a symmetric (3, 3) matrix."""
    xx, xy, xz = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    yy, yz, zz = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    det = xx * c_xx + xy * c_xy + xz * c_xz
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c_xx / det, c_xy / det, c_xz / det
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = c_xy / det, (xx * zz - xz * xz) / det, (xy * xz - xx * yz) / det
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = c_xz / det, inverse[1, 2], (xx * yy - xy * xy) / det


@compiled
def information_slope(lens: Array, corners: Array, centre: Array, moved: Array, slope: Array) -> None:
    """Fill d N (6, 6), the information about a tag's centre, while every point q moves at ``moved`` q' = v + w x q.

    ``moved`` (6,) holds the velocity v and the turn w of the scene in the camera's frame.
    """
    rows, rows_by = np.empty((2, 6)), np.empty((2, 6))
    slope[:, :] = 0.0
    sigma, sigma_by = _corner_sigma_slope(lens, corners, centre, moved)
    weight = 1.0 / (sigma * sigma)
    weight_by = -2.0 * weight * sigma_by / sigma
    for k in range(4):
        corner_rows(lens, corners[k], centre, rows)
        _corner_rows_slope(lens, corners[k], centre, moved, rows, rows_by)
        for i in range(6):
            for j in range(6):
                for axis in range(2):
                    product = rows[axis, i] * rows[axis, j]
                    product_by = rows_by[axis, i] * rows[axis, j] + rows[axis, i] * rows_by[axis, j]
                    slope[i, j] += weight_by * product + weight * product_by


@compiled
def _velocity(moved: Array, point: Array) -> tuple[float, float, float]:
    return (
        moved[0] + moved[4] * point[2] - moved[5] * point[1],
        moved[1] + moved[5] * point[0] - moved[3] * point[2],
        moved[2] + moved[3] * point[1] - moved[4] * point[0],
    )


@compiled
def _corner_rows_slope(lens: Array, corner: Array, centre: Array, moved: Array, rows: Array, rows_by: Array) -> None:
    z = corner[2]
    a, b = corner[0] / z, corner[1] / z
    x_by, y_by, z_by = _velocity(moved, corner)
    a_by, b_by = (x_by - a * z_by) / z, (y_by - b * z_by) / z
    uaa, uab, ubb, vaa, vab, vbb = curvatures_at(lens, a, b)
    rows_by[0, 0] = lens[FX] * (uaa * a_by + uab * b_by) / z - rows[0, 0] * z_by / z
    rows_by[0, 1] = lens[FX] * (uab * a_by + ubb * b_by) / z - rows[0, 1] * z_by / z
    rows_by[1, 0] = lens[FY] * (vaa * a_by + vab * b_by) / z - rows[1, 0] * z_by / z
    rows_by[1, 1] = lens[FY] * (vab * a_by + vbb * b_by) / z - rows[1, 1] * z_by / z
    arm_x, arm_y, arm_z = corner[0] - centre[0], corner[1] - centre[1], corner[2] - centre[2]
    still_x, still_y, still_z = _velocity(moved, centre)
    by_x, by_y, by_z = x_by - still_x, y_by - still_y, z_by - still_z
    for k in range(2):
        rows_by[k, 2] = -(rows_by[k, 0] * a + rows_by[k, 1] * b + rows[k, 0] * a_by + rows[k, 1] * b_by)
        rows_by[k, 3] = rows_by[k, 2] * arm_y + rows[k, 2] * by_y - rows_by[k, 1] * arm_z - rows[k, 1] * by_z
        rows_by[k, 4] = rows_by[k, 0] * arm_z + rows[k, 0] * by_z - rows_by[k, 2] * arm_x - rows[k, 2] * by_x
        rows_by[k, 5] = rows_by[k, 1] * arm_x + rows[k, 1] * by_x - rows_by[k, 0] * arm_y - rows[k, 0] * by_y


@compiled
def _corner_sigma_slope(lens: Array, corners: Array, centre: Array, moved: Array) -> tuple[float, float]:
    """Return ``corner_sigma`` and its derivative while the scene moves."""
    at, by = np.empty((4, 2)), np.empty((4, 2))
    for k in range(4):
        z = corners[k, 2]
        a, b = corners[k, 0] / z, corners[k, 1] / z
        at[k, 0], at[k, 1] = pixel_at(lens, corners[k, 0], corners[k, 1], z)
        ua, ub, va, vb = slopes_at(lens, a, b)
        x_by, y_by, z_by = _velocity(moved, corners[k])
        a_by, b_by = (x_by - a * z_by) / z, (y_by - b * z_by) / z
        by[k, 0] = lens[FX] * (ua * a_by + ub * b_by)
        by[k, 1] = lens[FY] * (va * a_by + vb * b_by)
    twice_area, twice_area_by = 0.0, 0.0
    for k in range(4):
        n = (k + 1) % 4
        twice_area += at[k, 0] * at[n, 1] - at[k, 1] * at[n, 0]
        twice_area_by += by[k, 0] * at[n, 1] + at[k, 0] * by[n, 1] - by[k, 1] * at[n, 0] - at[k, 1] * by[n, 0]
    width2 = abs(twice_area) / 2.0
    width2_by = math.copysign(1.0, twice_area) * twice_area_by / 2.0
    width = math.sqrt(width2)
    if lens[REFINED] > 0.0:
        return _refined_sigma_slope(width2, width2_by)
    noise, noise_by = NOISE_PX, 0.0
    if SMALL_TAG_PX2 / max(width, 1.0) > NOISE_PX:
        noise = SMALL_TAG_PX2 / max(width, 1.0)
        noise_by = -noise * width2_by / (2.0 * width2) if width > 1.0 else 0.0
    radius = math.hypot(centre[0], centre[1]) / centre[2]
    x_by, y_by, z_by = _velocity(moved, centre)
    radius_by = 0.0
    if radius > 0.0:
        radius_by = (centre[0] * x_by + centre[1] * y_by) / (centre[2] ** 2 * radius) - radius * z_by / centre[2]
    bend = BEND_PER_PX * radius * width2
    bend_by = BEND_PER_PX * (radius_by * width2 + radius * width2_by)
    sigma = math.hypot(noise, bend)
    return sigma, (noise * noise_by + bend * bend_by) / sigma


@compiled
def _refined_sigma_slope(width2: float, width2_by: float) -> tuple[float, float]:
    """Return the sigma of refined corners of tags ``sqrt(width2)`` wide, and its derivative."""
    if width2 < 1.0:
        width2, width2_by = 1.0, 0.0
    narrow = REFINED_PX2**2 / width2
    unrefined = (UNREFINED_WIDTH_PX**2 / width2) ** UNREFINED_POWER
    sigma = math.sqrt(REFINED_PX**2 + narrow + unrefined)
    return sigma, -(narrow + UNREFINED_POWER * unrefined) * width2_by / (2.0 * width2 * sigma)
