"""Pan-tilt kinematics with axes that need not meet.

Frames of a head, outermost first:

- *world* to *base*: ``T_world_base``; pan turns about base z (positive counter-clockwise seen from above).
- *base* to *pan arm*: rotation by pan, then the offset ``T_arm_tilt`` to the tilt axis.
- *arm* to *mount*: tilt turns about -y (positive up), so at pan = tilt = 0 the mount's x looks along base x,
  y left, z up.
- *mount* to *camera*: ``T_mount_camera``, optical (x right, y down, z forward). With zero roll-pitch-yaw in the
  YAML it looks along mount x: ``R_MOUNT_OPTICAL``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_log, rotation_y, rotation_z

R_MOUNT_OPTICAL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from the optical frame to a forward-looking (x forward, y left, z up) frame."""

R_BODY_OPTICAL_DOWN: Array = np.diag([1.0, -1.0, -1.0])
"""Rotation from the optical frame of a straight-down camera to its drone's body: image right = body x."""

_STRAIGHT_RAD = 1e-9
"""Closer to straight up or down than this a camera has no pan."""


def aim_rotation(pan_rad: float, tilt_rad: float) -> Array:
    """Return R_base_mount of a level head: Rz(pan) Ry(-tilt)."""
    return np.asarray(rotation_z(pan_rad) @ rotation_y(-tilt_rad))


def look_of(R_world_camera: Array, straight_rad: float = _STRAIGHT_RAD) -> tuple[float, float, float]:
    """Return the pan, tilt and roll (about the optical axis, after both) of a camera, in radians; of one that looks
    straight up or down, or within ``straight_rad`` of it, the turn is all pan.
    """
    _, image_down, (x, y, z) = R_world_camera.T
    if math.hypot(x, y) < straight_rad:
        x, y = np.copysign(1.0, z) * image_down[:2]
    pan_rad, tilt_rad = math.atan2(y, x), math.asin(min(max(z, -1.0), 1.0))
    level = aim_rotation(pan_rad, tilt_rad) @ R_MOUNT_OPTICAL
    return pan_rad, tilt_rad, float(rotation_log(level.T @ R_world_camera)[2])


@dataclass(frozen=True, slots=True, eq=False)
class PanTilt:
    """The kinematics of one head: where its base stands and how far its axes are apart."""

    T_world_base: Transform
    T_arm_tilt: Transform = field(default_factory=lambda: np.eye(4))

    def T_world_mount(self, pan_rad: float, tilt_rad: float) -> Transform:
        """Return the pose of the tilted mount frame."""
        T_base_arm = transform(rotation_z(pan_rad), np.zeros(3))
        T_tilt_mount = transform(rotation_y(-tilt_rad), np.zeros(3))
        return self.T_world_base @ T_base_arm @ self.T_arm_tilt @ T_tilt_mount

    def T_world_camera(self, pan_rad: float, tilt_rad: float, T_mount_camera: Transform) -> Transform:
        """Return the camera's pose at the given angles."""
        return self.T_world_mount(pan_rad, tilt_rad) @ T_mount_camera

    def jacobian(self, pan_rad: float, tilt_rad: float, T_mount_camera: Transform) -> Array:
        """Return (6, 2) ``d pose / d (pan, tilt)`` in the pose convention of geometry.pose, world axes."""
        T_world_tilt = self.T_world_base @ transform(rotation_z(pan_rad), np.zeros(3)) @ self.T_arm_tilt
        camera = self.T_world_camera(pan_rad, tilt_rad, T_mount_camera)[:3, 3]
        pan_axis = self.T_world_base[:3, 2]
        tilt_axis = -T_world_tilt[:3, 1]
        J = np.zeros((6, 2))
        J[:3, 0] = np.cross(pan_axis, camera - self.T_world_base[:3, 3])
        J[:3, 1] = np.cross(tilt_axis, camera - T_world_tilt[:3, 3])
        J[3:, 0] = pan_axis
        J[3:, 1] = tilt_axis
        return J
