"""Where a camera was at a stamp, from what carries it."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.pose import compose
from camrig.locate.history import Histories
from camrig.messages import CameraPose
from camrig.rig import CameraSpec, DroneMount, FixedMount, FreeMount, HeadMount, Rig

MOUNT_SIGMA_M = 0.001
MOUNT_SIGMA_RAD = 0.0005
"""One sigma of how well any camera's place on its carrier, or in the room, is known; it also keeps the covariance of a
head's camera, which has two degrees of freedom, regular.
"""

MOUNT_COVARIANCE: Array = np.diag([MOUNT_SIGMA_M**2] * 3 + [MOUNT_SIGMA_RAD**2] * 3)


def camera_pose(camera: CameraSpec, rig: Rig, histories: Histories, stamp_s: float) -> CameraPose | None:
    """Return the camera's pose at the stamp with all that makes it uncertain; None where nothing tells it."""
    match camera.mount:
        case HeadMount():
            return _on_head(camera, camera.mount, rig, histories, stamp_s)
        case DroneMount():
            return _on_drone(camera, camera.mount, histories, stamp_s)
        case FixedMount(T_world_camera=T_world_camera):
            return CameraPose(camera.id, stamp_s, T_world_camera, MOUNT_COVARIANCE)
        case FreeMount():
            return None


def _on_head(camera: CameraSpec, mount: HeadMount, rig: Rig, histories: Histories, stamp_s: float) -> CameraPose | None:
    """Carry readings and bias through the kinematics: J (C + bias^2 I + rate^2 offset sigma^2) J^T."""
    history, offset = histories.heads.get(mount.head), histories.offset(camera.id)
    state = history.at(stamp_s + offset.offset_s) if history else None
    if history is None or state is None:
        return None
    head = rig.heads[mount.head]
    pan_rad, tilt_rad = (float(angle) for angle in state.angles_rad)
    T_world_camera = head.kinematics.T_world_camera(pan_rad, tilt_rad, mount.T_mount_camera)
    J = head.kinematics.jacobian(pan_rad, tilt_rad, mount.T_mount_camera)
    strayed_rad = history.rates_rad_s(stamp_s + offset.offset_s) * offset.sigma_s
    angles = state.covariance + head.bias_sigma_rad**2 * np.eye(2) + np.outer(strayed_rad, strayed_rad)
    return CameraPose(camera.id, stamp_s, T_world_camera, J @ angles @ J.T + MOUNT_COVARIANCE)


def _on_drone(camera: CameraSpec, mount: DroneMount, histories: Histories, stamp_s: float) -> CameraPose | None:
    history = histories.drones.get(mount.drone)
    state = history.at(stamp_s) if history else None
    if state is None:
        return None
    T_world_camera, covariance = compose(*state, mount.T_body_camera, np.zeros((6, 6)))
    return CameraPose(camera.id, stamp_s, T_world_camera, covariance + MOUNT_COVARIANCE)
