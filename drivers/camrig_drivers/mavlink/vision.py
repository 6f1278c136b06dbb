"""Poses from outside, as the autopilot's estimator takes them: ENU to NED, covariance, time, reset counter."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_z
from camrig.messages import BodyPose
from camrig_drivers.mavlink.frames import LocalFrame, rotate_to_ned, rpy_ned_frd
from camrig_drivers.mavlink.packets import ExternalPose

PERIOD_S = 0.02
"""Estimators take up to 50 poses a second."""
_JUMP_M = 0.3
_JUMP_RAD = math.radians(20.0)
_FASTEST_M_S = 3.0
_FASTEST_RAD_S = math.radians(180.0)
_UPPER = np.triu_indices(6)


class VisionPoses:
    """Turns poses of one body into what is sent; leaves out what is older than the last, or too soon after it.

    The reset counter goes up where a pose cannot follow from the one before: other anchors, or an ambiguity that has
    been resolved. The estimator then starts from the new one, instead of flying the jump.
    """

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._last: BodyPose | None = None
        self._resets = 0

    def take(self, pose: BodyPose) -> ExternalPose | None:
        """Return the pose as it is to be sent, or None."""
        last = self._last
        if last is not None:
            if pose.stamp_s < last.stamp_s + PERIOD_S / 2.0:
                return None
            self._resets = (self._resets + _jumps(last, pose)) % 256
        self._last = pose
        x, y, z = pose.T_world_body[:3, 3].tolist()
        rpy_rad = rpy_ned_frd(pose.T_world_body[:3, :3])
        return ExternalPose(
            stamp_us=round(pose.stamp_s * 1e6),
            position_ned_m=self._frame.local((x, y, z)),
            rpy_rad=rpy_rad,
            covariance=tuple(_covariance_ned(pose.covariance, rpy_rad[2])[_UPPER].tolist()),
            reset_counter=self._resets,
        )


def _jumps(last: BodyPose, pose: BodyPose) -> bool:
    dt_s = pose.stamp_s - last.stamp_s
    moved_m = float(np.linalg.norm(pose.T_world_body[:3, 3] - last.T_world_body[:3, 3]))
    cosine = (float(np.trace(pose.T_world_body[:3, :3] @ last.T_world_body[:3, :3].T)) - 1.0) / 2.0
    turned_rad = math.acos(min(1.0, max(-1.0, cosine)))
    return moved_m > _JUMP_M + _FASTEST_M_S * dt_s or turned_rad > _JUMP_RAD + _FASTEST_RAD_S * dt_s


def _covariance_ned(covariance: Array, yaw_ned_rad: float) -> Array:
    """Return the (6, 6) covariance over north, east, down, roll, pitch, yaw.

    Ours is over small turns about the world's axes (geometry.pose). Yaw is the turn about down; roll and pitch of a
    body that is nearly level are the turns about its forward and right axes, which lie ``yaw_ned_rad`` from north.
    """
    J = np.zeros((6, 6))
    J[:3, :3] = rotate_to_ned(np.eye(3))
    J[3:, 3:] = rotation_z(-yaw_ned_rad) @ rotate_to_ned(np.eye(3))
    return np.asarray(J @ covariance @ J.T)
