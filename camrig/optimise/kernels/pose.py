"""Where a vector puts a camera, how its pose moves with each variable, and how uncertain the pose is. Compiled."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import ALPHA, FX, FY, SIZE, WIDTH
from camrig.optimise.kernels.problem import (
    ARM_R,
    ARM_T,
    BASE_R,
    CAMERA_R,
    CAMERA_T,
    LENS_COUNT,
    LENS_FIRST,
    PAN,
    PRIOR,
    TILT,
    ZOOM,
)

Pose = tuple[Array, Array]
"""R_world_camera (3, 3) and the camera's place (3,)."""


@compiled
def pose_of(camera: Array, u: Array) -> Pose:
    """Return the pose of a camera (a row) at a vector (6,): geometry.pan_tilt, its base at the vector's place."""
    R, origin = np.empty((3, 3)), np.empty(3)
    _joints(camera, u, R, origin)
    for k in range(3):
        a, b, c = R[k, 0], R[k, 1], R[k, 2]
        for h in range(3):
            R[k, h] = a * camera[CAMERA_R + h] + b * camera[CAMERA_R + 3 + h] + c * camera[CAMERA_R + 6 + h]
    return R, origin


@compiled
def _joints(camera: Array, u: Array, R_mount: Array, origin: Array) -> None:
    """Fill R_world_mount and the camera's place, row by row. Tilt is positive up: a turn from x towards z."""
    cos_pan, sin_pan = math.cos(u[PAN]), math.sin(u[PAN])
    cos_tilt, sin_tilt = math.cos(u[TILT]), math.sin(u[TILT])
    for k in range(3):
        base_x, base_y, z = camera[BASE_R + 3 * k], camera[BASE_R + 3 * k + 1], camera[BASE_R + 3 * k + 2]
        x, y = cos_pan * base_x + sin_pan * base_y, cos_pan * base_y - sin_pan * base_x
        origin[k] = u[k] + x * camera[ARM_T] + y * camera[ARM_T + 1] + z * camera[ARM_T + 2]
        arm_x = x * camera[ARM_R] + y * camera[ARM_R + 3] + z * camera[ARM_R + 6]
        arm_y = x * camera[ARM_R + 1] + y * camera[ARM_R + 4] + z * camera[ARM_R + 7]
        arm_z = x * camera[ARM_R + 2] + y * camera[ARM_R + 5] + z * camera[ARM_R + 8]
        R_mount[k, 0], R_mount[k, 1] = cos_tilt * arm_x + sin_tilt * arm_z, arm_y
        R_mount[k, 2] = cos_tilt * arm_z - sin_tilt * arm_x
        for h in range(3):
            origin[k] += R_mount[k, h] * camera[CAMERA_T + h]


@compiled
def twist_of(camera: Array, u: Array, variable: int, twist: Array) -> None:
    """Fill (6,): the camera's velocity and turn in the world by one unit of a variable; a zoom moves nothing."""
    twist[:] = 0.0
    if variable < PAN:
        twist[variable] = 1.0
    elif variable < ZOOM:
        R_mount, origin = np.empty((3, 3)), np.empty(3)
        _joints(camera, u, R_mount, origin)
        arm = np.empty(3)  # from a point of the axis to the camera
        for k in range(3):
            if variable == PAN:
                twist[3 + k] = camera[BASE_R + 3 * k + 2]
                arm[k] = origin[k] - u[k]
            else:
                twist[3 + k] = -R_mount[k, 1]
                arm[k] = 0.0
                for h in range(3):
                    arm[k] += R_mount[k, h] * camera[CAMERA_T + h]
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            twist[k] = twist[3 + a] * arm[b] - twist[3 + b] * arm[a]


@compiled
def lens_of(camera: Array, lenses: Array, u: Array) -> Array:
    """Return the lens (SIZE,) at the vector's zoom; between rows of the table everything goes linearly."""
    first, count = int(camera[LENS_FIRST]), int(camera[LENS_COUNT])
    if count == 1:
        return np.asarray(lenses[first])
    at = min(max(u[ZOOM], 0.0), count - 1.0)
    row = min(int(at), count - 2)
    share = at - row
    lens = np.empty(SIZE)
    for k in range(SIZE):
        lens[k] = (1.0 - share) * lenses[first + row, k] + share * lenses[first + row + 1, k]
    lens[ALPHA] = math.atan(lens[WIDTH] / (2.0 * math.sqrt(lens[FX] * lens[FY])))
    return lens


@compiled
def pose_covariance(camera: Array, u: Array, covariance: Array) -> None:
    """Fill the (6, 6) covariance of the camera's place and turn in the world, before any anchor is seen."""
    covariance[:, :] = 0.0
    for k in range(3):
        covariance[k, k] = camera[PRIOR] ** 2
        covariance[3 + k, 3 + k] = camera[PRIOR + 1] ** 2
    twist = np.empty(6)
    for axis in range(2):
        sigma = camera[PRIOR + 2 + axis]
        if sigma > 0.0:
            twist_of(camera, u, PAN + axis, twist)
            for k in range(6):
                for h in range(6):
                    covariance[k, h] += sigma * sigma * twist[k] * twist[h]
