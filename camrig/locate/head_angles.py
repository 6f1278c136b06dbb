"""What anchors in view tell of their head's angles: how a head that reports nothing is measured by its own camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.pose import difference, invert
from camrig.locate.camera_pose import MOUNT_COVARIANCE
from camrig.locate.history import Histories
from camrig.locate.time_offset import learn
from camrig.messages import AxisReading, CameraPose
from camrig.rig import CameraSpec, HeadMount, HeadSpec

_STAMP_SIGMA_S = 0.0005
"""A frame's stamp is that of its middle row; the angle is that of the whole picture."""
_LEAST_INFORMATION = 1.0 / math.radians(10.0) ** 2
"""Anchors that leave an axis less certain than that say nothing of it."""


def head_angles(
    head: HeadSpec, mount: HeadMount, carried: CameraPose | None, found: CameraPose
) -> tuple[AxisReading, ...]:
    """Return pan and tilt as the anchors alone show them, at the frame's stamp; nothing where they add nothing.

    ``carried`` is the camera's pose by the head's own readings, None where there was none; ``found`` is that pose after
    the anchors. What the readings had said is taken out again (the difference of both information matrices is the
    anchors'), so the driver may fuse the answer with its own belief. A pose is carried to the angles through the
    head's Jacobian; that camera and base are not quite where the rig says is marginalised.
    """
    pan_rad, tilt_rad = _angles_of(head.kinematics, mount.T_mount_camera, found.T_world_camera)
    T_start = head.kinematics.T_world_camera(pan_rad, tilt_rad, mount.T_mount_camera)
    information, vector = _information(found, T_start)
    if carried is not None:
        before, before_vector = _information(carried, T_start)
        information, vector = information - before, vector - before_vector
    J = head.kinematics.jacobian(pan_rad, tilt_rad, mount.T_mount_camera)
    marginal = np.linalg.inv(np.eye(6) + information @ MOUNT_COVARIANCE)
    of_angles = J.T @ marginal @ information @ J
    of_angles = 0.5 * (of_angles + of_angles.T)
    if np.linalg.eigvalsh(of_angles)[0] < _LEAST_INFORMATION:
        return ()
    covariance = np.linalg.inv(of_angles)
    if carried is not None and (np.diag(covariance) >= _variances_of(carried, J)).any():
        return ()
    pan_rad, tilt_rad = np.array([pan_rad, tilt_rad]) + covariance @ J.T @ marginal @ vector
    pan_sigma_rad, tilt_sigma_rad = np.sqrt(np.diag(covariance))
    return (
        AxisReading(head.id, "pan", float(pan_rad), found.stamp_s, float(pan_sigma_rad), _STAMP_SIGMA_S),
        AxisReading(head.id, "tilt", float(tilt_rad), found.stamp_s, float(tilt_sigma_rad), _STAMP_SIGMA_S),
    )


def with_offset(histories: Histories, camera: CameraSpec, shown: tuple[AxisReading, ...]) -> Histories:
    """Return the histories with what a frame's ``head_angles`` tell of the time between its camera's stamps and its
    head's reports.
    """
    if not shown or not isinstance(camera.mount, HeadMount):
        return histories
    before = histories.offset(camera.id)
    stamp_s, history = shown[0].stamp_s + before.offset_s, histories.heads.get(camera.mount.head)
    told = history.at(stamp_s) if history is not None and history.covers(stamp_s) else None
    if history is None or told is None:
        return histories
    after = learn(before, shown, told.angles_rad, np.diag(told.covariance), history.rates_rad_s(stamp_s))
    return replace(histories, offsets={**histories.offsets, camera.id: after})


def _information(pose: CameraPose, T_start: Transform) -> tuple[Array, Array]:
    """Return a pose's (6, 6) information, and that times its (6,) difference from the start."""
    information: Array = np.asarray(np.linalg.inv(pose.covariance), float)
    return information, information @ difference(pose.T_world_camera, T_start)


def _variances_of(carried: CameraPose, J: Array) -> Array:
    """Return the (2,) variances of the angles that a pose was carried from: ``camera_pose`` undone."""
    back = np.linalg.pinv(J)
    return np.asarray(np.diag(back @ (carried.covariance - MOUNT_COVARIANCE) @ back.T))


def _angles_of(kinematics: PanTilt, T_mount_camera: Transform, T_world_camera: Transform) -> tuple[float, float]:
    """Return the angles of the nearest pose the head can take: where to linearise. Well defined straight down too."""
    R_base_mount = kinematics.T_world_base[:3, :3].T @ (T_world_camera @ invert(T_mount_camera))[:3, :3]
    pan_rad = math.atan2(-R_base_mount[0, 1], R_base_mount[1, 1])
    return pan_rad, math.atan2(R_base_mount[2, 0], R_base_mount[2, 2])
