"""A camera's free variables as a vector: its pose, its limits, and back to an aim. Vectorised over vectors.

Heads: (pan, tilt) in radians. Drones: (x, y, z) in metres. Fixed cameras: nothing.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.airspace import flight_box
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_z
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.optimise.scene import DronePlace, FixedPlace, HeadPlace, Place


def camera_poses(place: Place, vectors: Array) -> tuple[Array, Array]:
    """Return R_world_camera (K, 3, 3) and the camera's world position (K, 3) for (K, d) vectors."""
    match place:
        case HeadPlace():
            return _head_poses(place, vectors)
        case DronePlace():
            R_world_body = rotation_z(place.yaw_rad)
            R = R_world_body @ place.T_body_camera[:3, :3]
            return np.broadcast_to(R, (len(vectors), 3, 3)), vectors + R_world_body @ place.T_body_camera[:3, 3]
        case FixedPlace():
            T = place.T_world_camera
            count = len(vectors)
            return np.broadcast_to(T[:3, :3], (count, 3, 3)), np.broadcast_to(T[:3, 3], (count, 3))


def bounds(place: Place) -> tuple[Array, Array]:
    """Return the (d,) lowest and highest vector."""
    match place:
        case HeadPlace():
            low, high = zip(place.pan_limits_rad, place.tilt_limits_rad, strict=True)
            return np.array(low), np.array(high)
        case DronePlace():
            return flight_box(place.box_m)
        case FixedPlace():
            return np.zeros(0), np.zeros(0)


def within(place: Place, vectors: Array) -> Array:
    """Return (K, d) vectors brought inside the bounds: a pan by whole turns where that helps, then clamped."""
    low, high = bounds(place)
    if isinstance(place, HeadPlace):
        middle = (low[0] + high[0]) / 2.0
        turned = middle + (vectors[:, 0] - middle + math.pi) % (2.0 * math.pi) - math.pi
        inside = (vectors[:, 0] >= low[0]) & (vectors[:, 0] <= high[0])
        vectors = np.column_stack([np.where(inside, vectors[:, 0], turned), vectors[:, 1]])
    return np.clip(vectors, low, high)


def aim_of(place: Place, vector: Array) -> Aim | None:
    """Return the aim that a vector means; None for a fixed camera."""
    match place:
        case HeadPlace():
            return HeadAim(float(vector[0]), float(vector[1]))
        case DronePlace():
            x, y, z = (float(value) for value in vector)
            return DroneAim((x, y, z), place.yaw_rad)
        case FixedPlace():
            return None


def vector_of(place: Place, aim: Aim | None) -> Array | None:
    """Return the (d,) vector of an aim; None where the aim is unknown or of another kind of camera."""
    match place, aim:
        case HeadPlace(), HeadAim(pan_rad=pan_rad, tilt_rad=tilt_rad):
            return np.array([pan_rad, tilt_rad])
        case DronePlace(), DroneAim(position_m=position_m):
            return np.array(position_m, dtype=float)
        case FixedPlace(), _:
            return np.zeros(0)
        case _:
            return None


def head_vectors(place: HeadPlace, directions: Array) -> Array:
    """Return the (K, 2) pans and tilts, inside the limits, whose optical axes best follow (K, 3) world directions.

    A camera that does not look along the mount's x is met by correcting the angles by what its axis misses.
    """
    wanted = _angles(directions @ place.kinematics.T_world_base[:3, :3])
    vectors = wanted
    for _ in range(3):
        axis = camera_poses(place, vectors)[0][:, :, 2] @ place.kinematics.T_world_base[:3, :3]
        missed = wanted - _angles(axis)
        missed[:, 0] = (missed[:, 0] + math.pi) % (2.0 * math.pi) - math.pi
        vectors = vectors + missed
    return within(place, vectors)


def _angles(directions: Array) -> Array:
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def _head_poses(place: HeadPlace, vectors: Array) -> tuple[Array, Array]:
    base, arm, camera = place.kinematics.T_world_base, place.kinematics.T_arm_tilt, place.T_mount_camera
    R_world_arm = base[:3, :3] @ _turns(vectors[:, 0], 0, 1)
    # Tilt is positive up: a rotation about -y, that is from x towards z.
    R_world_mount = R_world_arm @ arm[:3, :3] @ _turns(vectors[:, 1], 0, 2)
    positions = base[:3, 3] + R_world_arm @ arm[:3, 3] + R_world_mount @ camera[:3, 3]
    return R_world_mount @ camera[:3, :3], positions


def _turns(angles_rad: Array, start: int, end: int) -> Array:
    """Return (K, 3, 3) rotations that turn axis ``start`` towards axis ``end``."""
    R = np.broadcast_to(np.eye(3), (len(angles_rad), 3, 3)).copy()
    R[:, start, start] = R[:, end, end] = np.cos(angles_rad)
    R[:, end, start] = np.sin(angles_rad)
    R[:, start, end] = -R[:, end, start]
    return R
