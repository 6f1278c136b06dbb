"""The one place where MAVLink's NED and FRD meet camrig's ENU and FLU.

World: east, north, up. MAVLink local: north, east, down. Body: forward, left, up against forward, right, down.
The autopilot's local origin lies at ``origin_m`` in the world; its axes are the world's.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_from_rpy, wrap_angle

Vector = tuple[float, float, float]

_R_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_R_FRD_FLU = np.diag([1.0, -1.0, -1.0])


def world_from_ned(position_ned_m: Vector, origin_m: Vector) -> Vector:
    """Map a point of the autopilot's local frame into the world."""
    north, east, down = position_ned_m
    return origin_m[0] + east, origin_m[1] + north, origin_m[2] - down


def ned_from_world(position_m: Vector, origin_m: Vector) -> Vector:
    """Map a world point into the autopilot's local frame."""
    x, y, z = (value - zero for value, zero in zip(position_m, origin_m, strict=True))
    return y, x, -z


def yaw_ned_from_enu(yaw_rad: float) -> float:
    """Turn 0 = east, counter-clockwise into 0 = north, clockwise, in [-pi, pi)."""
    return wrap_angle(math.pi / 2.0 - yaw_rad)


def yaw_enu_from_ned(yaw_ned_rad: float) -> float:
    """Turn 0 = north, clockwise into 0 = east, counter-clockwise, in [-pi, pi)."""
    return wrap_angle(math.pi / 2.0 - yaw_ned_rad)


def R_world_body(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Return the (3, 3) rotation FLU to ENU of an ATTITUDE message, whose angles turn NED into FRD (z, y, x)."""
    return np.asarray(_R_ENU_NED @ rotation_from_rpy(roll_rad, pitch_rad, yaw_rad) @ _R_FRD_FLU)
