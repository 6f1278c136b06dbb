"""A servo gimbal as both firmwares drive it, and the messages of its manager (MAVLink gimbal protocol v2)."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.mavlink.frames import quaternion_of

Message: TypeAlias = Any

YAW_LOCK = 16  # GIMBAL_MANAGER_FLAGS: the yaw counts from north instead of from the nose
_HORIZON = 4 | 8  # GIMBAL_DEVICE_FLAGS: roll and pitch keep to the horizon
_SLEW_RAD_S = math.radians(90.0)
_YAW_LIMIT_RAD = math.pi
_CAPABILITIES = 0x2 | 0x20 | 0x80 | 0x100 | 0x200 | 0x400  # neutral; pitch, locked; yaw, following or locked


class Mount:
    """Pitch (up positive) and yaw (clockwise) that follow what was asked for at a steady rate; radians."""

    def __init__(self, pitch_limits_rad: tuple[float, float], now_s: float) -> None:
        self.pitch_limits_rad = pitch_limits_rad
        self.owner: tuple[int, int] | None = None
        """System and component that took control by DO_GIMBAL_MANAGER_CONFIGURE."""
        self._now_s = now_s
        self._goal_rad = (0.0, 0.0)
        self._pitch_rad = self._yaw_rad = 0.0
        self._flags = 0

    @property
    def angles_rad(self) -> tuple[float, float]:
        """Pitch and yaw now."""
        return self._pitch_rad, self._yaw_rad

    def advance(self, now_s: float) -> None:
        """Turn towards the goal."""
        reach_rad, self._now_s = _SLEW_RAD_S * (now_s - self._now_s), now_s
        self._pitch_rad = _towards(self._pitch_rad, self._goal_rad[0], reach_rad)
        self._yaw_rad = _towards(self._yaw_rad, self._goal_rad[1], reach_rad)

    def point(self, pitch_deg: float, yaw_deg: float, flags: int) -> None:
        """Ask for angles; NaN leaves one as it is."""
        low, high = self.pitch_limits_rad
        pitch_rad, yaw_rad = self._goal_rad
        if math.isfinite(pitch_deg):
            pitch_rad = max(low, min(high, math.radians(pitch_deg)))
        if math.isfinite(yaw_deg):
            yaw_rad = math.remainder(math.radians(yaw_deg), math.tau)
        self._goal_rad, self._flags = (pitch_rad, yaw_rad), flags

    def attitude_status(self, boot_ms: int) -> Message:
        """GIMBAL_DEVICE_ATTITUDE_STATUS (285)."""
        flags = _HORIZON | (self._flags & YAW_LOCK)
        q = quaternion_of(0.0, self._pitch_rad, self._yaw_rad)
        return dialect.MAVLink_gimbal_device_attitude_status_message(0, 0, boot_ms, flags, q, 0.0, 0.0, 0.0, 0)

    def manager_information(self, boot_ms: int) -> Message:
        """GIMBAL_MANAGER_INFORMATION (280)."""
        low, high = self.pitch_limits_rad
        return dialect.MAVLink_gimbal_manager_information_message(
            boot_ms, _CAPABILITIES, 1, 0.0, 0.0, low, high, -_YAW_LIMIT_RAD, _YAW_LIMIT_RAD
        )

    def manager_status(self, boot_ms: int) -> Message:
        """GIMBAL_MANAGER_STATUS (281)."""
        system, component = self.owner or (0, 0)
        return dialect.MAVLink_gimbal_manager_status_message(
            boot_ms, _HORIZON | (self._flags & YAW_LOCK), 1, system, component, 0, 0
        )


def _towards(value: float, goal: float, reach: float) -> float:
    return goal if abs(goal - value) <= reach else value + math.copysign(reach, goal - value)
