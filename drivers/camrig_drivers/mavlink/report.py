"""What one vehicle tells the rig: readings of its pose with their covariance."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z, yaw_of
from camrig.messages import DroneReading, FlightState
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.poses import StampedPose
from camrig_drivers.mavlink.telemetry import Telemetry

_KEPT = 256
_FRESH_GIMBAL_S = 1.0
_DOWN_RAD = math.radians(2.0)
_ADRIFT_RAD = 0.35
"""One sigma of a gimbal of which nothing is heard, or that is still on its way."""


class Report:
    """Collects readings; ``gimbal`` says that the camera hangs in one that keeps it level.

    The pose of a drone with a gimbal is that of the gimbal's base if it were level: roll and pitch of the airframe do
    not reach the camera.
    """

    def __init__(self, spec: DroneSpec, seen: Telemetry, *, gimbal: bool) -> None:
        self.readings: deque[DroneReading] = deque(maxlen=_KEPT)
        self._spec = spec
        self._seen = seen
        self._gimbal = gimbal
        self._covariance = _covariance(spec, spec.attitude_sigma_rad)
        self._adrift = _covariance(spec, _ADRIFT_RAD)

    def take(self, poses: Iterable[StampedPose], flight: FlightState, now_s: float) -> None:
        """Turn poses into readings."""
        covariance = self._covariance if not self._gimbal or self._points_down(now_s) else self._adrift
        for pose in poses:
            T_world_body = _levelled(pose.T_world_body) if self._gimbal else pose.T_world_body
            self.readings.append(DroneReading(self._spec.id, pose.stamp_s, T_world_body, covariance, flight))

    def _points_down(self, now_s: float) -> bool:
        gimbal = self._seen.gimbal
        fresh = gimbal is not None and now_s - self._seen.gimbal_s <= _FRESH_GIMBAL_S
        return fresh and gimbal is not None and abs(gimbal.pitch_rad + math.pi / 2.0) <= _DOWN_RAD


def _covariance(spec: DroneSpec, attitude_sigma_rad: float) -> Array:
    return np.asarray(np.diag(np.square([spec.position_sigma_m] * 3 + [attitude_sigma_rad] * 3)))


def _levelled(T_world_body: Transform) -> Transform:
    return transform(rotation_z(yaw_of(T_world_body[:3, :3])), T_world_body[:3, 3])
