"""Rotation matrices: exponential map, roll-pitch-yaw, elementary rotations. Angles in radians."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array


def skew(vector: Array) -> Array:
    """Return the (3, 3) matrix with ``skew(v) @ w == cross(v, w)``."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(rotation_vector: Array) -> Array:
    """Return the (3, 3) rotation by ``|v|`` radians about ``v`` (Rodrigues' formula)."""
    # Numbers, not arrays: of three they are five times as fast, and a frame asks for dozens.
    x, y, z = rotation_vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = (math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2) if angle > 1e-12 else (1.0, 0.5)
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def rotation_log(R: Array) -> Array:
    """Return the (3,) rotation vector of ``R``, of length in [0, pi]."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    axis2sin = np.array([zy - yz, xz - zx, yx - xy])
    sin2 = math.hypot(zy - yz, xz - zx, yx - xy)
    angle = math.atan2(sin2, xx + yy + zz - 1.0)
    if sin2 > 1e-6:
        return np.asarray(axis2sin * (angle / sin2))
    if angle < 1.0:
        return np.asarray(axis2sin / 2.0)
    # Near pi the antisymmetric part vanishes: (R + I) / 2 = a a^T, its largest column gives the axis.
    outer = (R + np.eye(3)) / 2.0
    column = outer[:, int(np.argmax(np.diag(outer)))]
    axis = column / np.linalg.norm(column)
    if float(axis @ axis2sin) < 0.0:
        axis = -axis
    return np.asarray(axis * angle)


def rotation_x(angle_rad: float) -> Array:
    """Rotation about x by the right-hand rule."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle_rad: float) -> Array:
    """Rotation about y by the right-hand rule."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle_rad: float) -> Array:
    """Rotation about z by the right-hand rule."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Roll about x, then pitch about y, then yaw about z, all fixed axes (REP-103): Rz Ry Rx."""
    return np.asarray(rotation_z(yaw_rad) @ rotation_y(pitch_rad) @ rotation_x(roll_rad))


def rpy_of(R: Array) -> tuple[float, float, float]:
    """Return the roll, pitch and yaw of ``rotation_from_rpy``; where pitch is a right angle, roll is 0."""
    pitch = math.asin(min(max(-float(R[2, 0]), -1.0), 1.0))
    if math.hypot(R[2, 1], R[2, 2]) < 1e-9:
        return 0.0, pitch, math.atan2(-float(R[0, 1]), float(R[1, 1]))
    return math.atan2(float(R[2, 1]), float(R[2, 2])), pitch, math.atan2(float(R[1, 0]), float(R[0, 0]))


def upright_rotation(R: Array) -> Array:
    """Turn a rotation by the least angle that points its z axis up."""
    x, y, z = R[:, 2].tolist()
    lean = math.hypot(x, y)
    axis = np.array([y, -x, 0.0]) / lean if lean > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.asarray(rotation_exp(axis * math.atan2(lean, z)) @ R)


def yaw_of(R: Array) -> float:
    """Return the heading of the rotated x axis in the x-y plane, in (-pi, pi]."""
    return math.atan2(float(R[1, 0]), float(R[0, 0]))


def wrap_angle(angle_rad: float) -> float:
    """Wrap to [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
