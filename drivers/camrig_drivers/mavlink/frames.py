"""The one place where MAVLink's NED and FRD meet camrig's ENU and FLU.

World: east, north, up. MAVLink local: north, east, down. Body: forward, left, up against forward, right, down.
The autopilot's local axes are the world's, its origin lies at ``LocalFrame.origin_m``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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


def rotate_to_ned(vectors: Array) -> Array:
    """Turn (3, ...) columns from east, north, up to north, east, down: for vectors and axes of rotation alike."""
    return np.asarray(_R_ENU_NED.T @ vectors)


def rpy_ned_frd(R: Array) -> Vector:
    """Return roll, pitch and yaw, which turn NED into FRD, of a (3, 3) rotation FLU to ENU; inverts R_world_body."""
    R_ned_frd = _R_ENU_NED.T @ R @ _R_FRD_FLU.T
    roll_rad = math.atan2(R_ned_frd[2, 1], R_ned_frd[2, 2])
    pitch_rad = math.asin(min(1.0, max(-1.0, -float(R_ned_frd[2, 0]))))
    return roll_rad, pitch_rad, math.atan2(R_ned_frd[1, 0], R_ned_frd[0, 0])


@dataclass
class LocalFrame:
    """Where the origin of one autopilot's local frame lies in the world, as far as is known now."""

    origin_m: Vector

    def world(self, position_ned_m: Vector) -> Vector:
        """Map a local point into the world."""
        return world_from_ned(position_ned_m, self.origin_m)

    def local(self, position_m: Vector) -> Vector:
        """Map a world point into the local frame."""
        return ned_from_world(position_m, self.origin_m)

    def raise_by(self, height_m: float) -> None:
        """Move the origin up."""
        x, y, z = self.origin_m
        self.origin_m = (x, y, z + height_m)
