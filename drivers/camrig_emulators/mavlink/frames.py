"""MAVLink's frames: local NED about an origin in the world (ENU), and attitudes of FRD bodies in NED.

East-north-up to north-east-down swaps x and y and turns z round; it is its own inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array

SWAP: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FLU_FRD: Array = np.diag([1.0, -1.0, -1.0])
_METRES_PER_DEGREE = 111_319.49


def swap(vector: Array) -> Array:
    """Turn a (3,) vector from ENU to NED or back."""
    return np.array([vector[1], vector[0], -vector[2]])


def swap_yaw(yaw_rad: float) -> float:
    """Turn a yaw from ENU (0 = east, counter-clockwise) to NED (0 = north, clockwise) or back, in [-pi, pi)."""
    return (math.pi / 2.0 - yaw_rad + math.pi) % (2.0 * math.pi) - math.pi


def R_ned_frd(R_world_body: Array) -> Array:
    """Turn a (3, 3) attitude of a forward-left-up body in ENU into one of forward-right-down in NED."""
    return np.asarray(SWAP @ R_world_body @ _FLU_FRD)


def euler(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of R = Rz(yaw) Ry(pitch) Rx(roll), radians."""
    return (
        math.atan2(R[2, 1], R[2, 2]),
        math.asin(max(-1.0, min(1.0, -float(R[2, 0])))),
        math.atan2(R[1, 0], R[0, 0]),
    )


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return w, x, y, z (w >= 0) of a (3, 3) rotation, by way of its roll, pitch and yaw."""
    return quaternion_of(*euler(R))


def quaternion_of(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float, float]:
    """Return w, x, y, z (w >= 0) of Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = roll_rad / 2.0, pitch_rad / 2.0, yaw_rad / 2.0
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
    w = cr * cp * cy + sr * sp * sy
    sign = 1.0 if w >= 0.0 else -1.0
    return (
        sign * w,
        sign * (sr * cp * cy - cr * sp * sy),
        sign * (cr * sp * cy + sr * cp * sy),
        sign * (cr * cp * sy - sr * sp * cy),
    )


def yaw_of(w: float, x: float, y: float, z: float) -> float:
    """Return the yaw of a unit quaternion."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def turn(rotation_vector: Array) -> Array:
    """Return the (3, 3) rotation by ``|v|`` radians about ``v`` (Rodrigues)."""
    x, y, z = (float(value) for value in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.asarray(np.eye(3) + K)
    return np.asarray(np.eye(3) + K * (math.sin(angle) / angle) + K @ K * ((1.0 - math.cos(angle)) / angle**2))


@dataclass(frozen=True, slots=True, eq=False)
class LocalFrame:
    """The estimator's local frame: its origin in the world and, on a flat earth, on the globe."""

    origin_m: Array
    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def to_ned(self, position_m: Array) -> Array:
        """Turn a (3,) place in the world into local NED."""
        return swap(position_m - self.origin_m)

    def to_world(self, position_ned: Array) -> Array:
        """Turn a (3,) local NED place into the world; NaNs stay on their axes."""
        return swap(position_ned) + self.origin_m

    def from_globe(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return east and north of a place on the globe, in the world."""
        north_m = (latitude_deg - self.latitude_deg) * _METRES_PER_DEGREE
        east_m = (longitude_deg - self.longitude_deg) * _METRES_PER_DEGREE * math.cos(math.radians(self.latitude_deg))
        return east_m + float(self.origin_m[0]), north_m + float(self.origin_m[1])

    def to_globe(self, position_m: Array) -> tuple[int, int, int]:
        """Return latitude and longitude in 1e-7 degrees and altitude above sea in millimetres."""
        north_m, east_m, down_m = (float(value) for value in self.to_ned(position_m))
        latitude = self.latitude_deg + north_m / _METRES_PER_DEGREE
        longitude = self.longitude_deg + east_m / (_METRES_PER_DEGREE * math.cos(math.radians(self.latitude_deg)))
        return _int32(latitude * 1e7), _int32(longitude * 1e7), _int32((self.altitude_m - down_m) * 1e3)


def _int32(value: float) -> int:
    """Round; what a message's field cannot hold becomes the most that it can."""
    return round(max(-(2.0**31), min(2.0**31 - 1.0, value)))
