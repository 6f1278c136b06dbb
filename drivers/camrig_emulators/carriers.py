"""Where a camera truly is: the kinematics of docs/frames-and-units.md, written down a second time.

camrig.geometry has them too; pictures taken from its poses would hide its mistakes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from camrig.geometry.arrays import Transform
from camrig.rig import DroneMount, FixedMount, HeadMount, HeadSpec, Rig

TrueAngles = Callable[[str, float], tuple[float, float]]
"""``(head id, stamp_s)`` to true pan and tilt in radians."""
TrueBody = Callable[[str, float], Transform]
"""``(drone id, stamp_s)`` to the true ``T_world_body``."""


def camera_pose(rig: Rig, camera_id: str, stamp_s: float, angles: TrueAngles, body: TrueBody) -> Transform:
    """Return the true ``T_world_camera`` at a stamp."""
    mount = rig.cameras[camera_id].mount
    match mount:
        case HeadMount(head=head_id):
            return _mount_pose(rig.heads[head_id], *angles(head_id, stamp_s)) @ mount.T_mount_camera
        case DroneMount(drone=drone_id):
            return np.asarray(body(drone_id, stamp_s) @ mount.T_body_camera)
        case FixedMount():
            return mount.T_world_camera
    raise ValueError(f"camera {camera_id} has no known place")


def _mount_pose(head: HeadSpec, pan_rad: float, tilt_rad: float) -> Transform:
    """Turn left by pan about the base's z, go to the tilt axis, turn up by tilt (about its -y)."""
    T_base_arm, T_tilt_mount = np.eye(4), np.eye(4)
    T_base_arm[:3, :3] = Rotation.from_rotvec([0.0, 0.0, pan_rad]).as_matrix()
    T_tilt_mount[:3, :3] = Rotation.from_rotvec([0.0, -tilt_rad, 0.0]).as_matrix()
    return np.asarray(head.kinematics.T_world_base @ T_base_arm @ head.kinematics.T_arm_tilt @ T_tilt_mount)
