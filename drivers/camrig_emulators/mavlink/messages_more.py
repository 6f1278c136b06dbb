"""Telemetry that few ask for, and messages that the dialect does not know."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.mavlink.dynamics import GRAVITY_M_S2
from camrig_emulators.mavlink.frames import quaternion, quaternion_of, swap, swap_yaw
from camrig_emulators.mavlink.messages import TELEMETRY, Message, Report

_LOCAL_NED, _BODY_FRD = 1, 12
_UNKNOWN_COVARIANCE = [math.nan] * 21
_EV_OR_GPS_GOOD = 1 | 2 | 4 | 8 | 16 | 32  # ESTIMATOR_STATUS_FLAGS: attitude, velocities, positions
_CONST_POSITION = 0x80
_IGNORE_RATES = 0x7


def system_time(report: Report) -> Message:
    """SYSTEM_TIME (2); it does not know UTC."""
    return dialect.MAVLink_system_time_message(0, report.boot_ms)


def vfr_hud(report: Report) -> Message:
    """VFR_HUD (74)."""
    cockpit, sample = report.vehicle.cockpit, report.sample
    speed = float(np.hypot(*sample.velocity_m_s[:2]))
    altitude_m = cockpit.frame.to_globe(sample.position_m)[2] / 1e3
    heading = round(math.degrees(swap_yaw(cockpit.yaw_rad))) % 360
    throttle = 50 if cockpit.armed else 0
    return dialect.MAVLink_vfr_hud_message(0.0, speed, heading, throttle, altitude_m, float(sample.velocity_m_s[2]))


def attitude_target(report: Report) -> Message:
    """ATTITUDE_TARGET (83): level, at the wanted yaw."""
    yaw_rad = report.vehicle.firmware.goal.yaw_rad
    yaw_ned_rad = swap_yaw(report.vehicle.cockpit.yaw_rad if math.isnan(yaw_rad) else yaw_rad)
    q = quaternion_of(0.0, 0.0, yaw_ned_rad)
    return dialect.MAVLink_attitude_target_message(report.boot_ms, _IGNORE_RATES, q, 0.0, 0.0, 0.0, 0.5)


def position_target_local_ned(report: Report) -> Message:
    """POSITION_TARGET_LOCAL_NED (85)."""
    cockpit, goal = report.vehicle.cockpit, report.vehicle.firmware.goal
    place = map(float, cockpit.frame.to_ned(goal.position_m))
    velocity, push = map(float, swap(goal.velocity_m_s)), map(float, swap(goal.acceleration_m_s2))
    yaw_rad = swap_yaw(cockpit.yaw_rad if math.isnan(goal.yaw_rad) else goal.yaw_rad)
    return dialect.MAVLink_position_target_local_ned_message(
        report.boot_ms, _LOCAL_NED, 0, *place, *velocity, *push, yaw_rad, -goal.yaw_rate_rad_s
    )


def highres_imu(report: Report) -> Message:
    """HIGHRES_IMU (105)."""
    felt = report.attitude.T @ swap(report.sample.truth.acceleration_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2]))
    return dialect.MAVLink_highres_imu_message(
        report.boot_ms * 1000, *map(float, felt), *report.rates, 0.2, 0.0, 0.4, 956.0, 0.0, 488.0, 25.0, 0x3F
    )


def altitude(report: Report) -> Message:
    """ALTITUDE (141)."""
    cockpit = report.vehicle.cockpit
    above_sea_m = cockpit.frame.to_globe(report.sample.position_m)[2] / 1e3
    local_m = -float(cockpit.frame.to_ned(report.sample.position_m)[2])
    above_home_m = math.nan if cockpit.home_m is None else float(report.sample.position_m[2] - cockpit.home_m[2])
    return dialect.MAVLink_altitude_message(
        report.boot_ms * 1000, above_sea_m, above_sea_m, local_m, above_home_m, math.nan, math.nan
    )


def fence_status(report: Report) -> Message:
    """FENCE_STATUS (162)."""
    breach = report.vehicle.cockpit.fence_breach
    return dialect.MAVLink_fence_status_message(1 if breach else 0, 1 if breach else 0, breach, 0)


def ekf_status_report(report: Report) -> Message:
    """EKF_STATUS_REPORT (193), ArduPilot's."""
    variance = _variance(report)
    return dialect.MAVLink_ekf_status_report_message(_estimator_flags(report), 0.02, variance, variance, 0.02, 0.0)


def estimator_status(report: Report) -> Message:
    """ESTIMATOR_STATUS (230), PX4's."""
    variance = _variance(report)
    return dialect.MAVLink_estimator_status_message(
        report.boot_ms * 1000, _estimator_flags(report), 0.02, variance, variance, 0.02, 0.0, 0.0, 0.1, 0.1
    )


def vibration(report: Report) -> Message:
    """VIBRATION (241)."""
    return dialect.MAVLink_vibration_message(report.boot_ms * 1000, 0.0, 0.0, 0.0, 0, 0, 0)


def odometry(report: Report) -> Message:
    """ODOMETRY (331): position in NED, velocity along the body's axes."""
    if not report.vehicle.cockpit.estimator.local:
        return None
    place = map(float, report.vehicle.cockpit.frame.to_ned(report.sample.position_m))
    velocity = map(float, report.attitude.T @ swap(report.sample.velocity_m_s))
    return dialect.MAVLink_odometry_message(
        report.boot_ms * 1000,
        _LOCAL_NED,
        _BODY_FRD,
        *place,
        quaternion(report.attitude),
        *velocity,
        *report.rates,
        _UNKNOWN_COVARIANCE,
        _UNKNOWN_COVARIANCE,
    )


def gps_global_origin(report: Report) -> Message:
    """GPS_GLOBAL_ORIGIN (49), once there is one."""
    cockpit = report.vehicle.cockpit
    if not cockpit.estimator.origin_known:
        return None
    return dialect.MAVLink_gps_global_origin_message(*cockpit.frame.to_globe(cockpit.frame.origin_m), 0)


def _of_mount(name: str) -> Callable[[Report], Message]:
    def tell(report: Report) -> Message:
        mount = report.vehicle.cockpit.mount
        return None if mount is None else getattr(mount, name)(report.boot_ms)

    return tell


def _variance(report: Report) -> float:
    estimator = report.vehicle.cockpit.estimator
    return min(2.0, 0.05 + estimator.lost_s / 8.0) if estimator.local else 2.0


def _estimator_flags(report: Report) -> int:
    estimator = report.vehicle.cockpit.estimator
    return _EV_OR_GPS_GOOD if estimator.local and estimator.aided else 1 | _CONST_POSITION


@dataclass(frozen=True, slots=True)
class Raw:
    """A message that the dialect does not know: readers of older dialects see UNKNOWN_n."""

    number: int
    payload: bytes
    crc_extra: int

    def pack(self, mav: Any) -> bytes:
        """Frame it as MAVLink 2, unsigned."""
        head = struct.pack(
            "<BBBBBBHB",
            len(self.payload),
            0,
            0,
            mav.seq,
            mav.srcSystem,
            mav.srcComponent,
            self.number & 0xFFFF,
            self.number >> 16,
        )
        checksum = dialect.x25crc(head + self.payload)
        checksum.accumulate(bytes([self.crc_extra]))
        return b"\xfd" + head + self.payload + struct.pack("<H", checksum.crc)


def link_node_status(report: Report) -> Message:
    """LINK_NODE_STATUS (8)."""
    return Raw(8, struct.pack("<QIIIIIHHHBBB", report.boot_ms, 2000, 100, 0, 0, 0, 0, 0, 0, 0, 0, 1), 117)


def time_estimate_to_target(report: Report) -> Message:
    """TIME_ESTIMATE_TO_TARGET (380): it knows none."""
    del report
    return Raw(380, struct.pack("<5i", -1, -1, -1, -1, -1), 232)


def event(report: Report) -> Message:
    """EVENT (410)."""
    return Raw(410, struct.pack("<IIHBBB", 1, report.boot_ms, 0, 0, 0, 0x66) + b"\x01", 160)


def current_event_sequence(report: Report) -> Message:
    """CURRENT_EVENT_SEQUENCE (411)."""
    del report
    return Raw(411, b"\x00\x00\x01", 106)


_ALL: Mapping[int, Callable[[Report], Message]] = {
    **TELEMETRY,
    2: system_time,
    8: link_node_status,
    49: gps_global_origin,
    74: vfr_hud,
    83: attitude_target,
    85: position_target_local_ned,
    105: highres_imu,
    141: altitude,
    162: fence_status,
    193: ekf_status_report,
    230: estimator_status,
    241: vibration,
    280: _of_mount("manager_information"),
    281: _of_mount("manager_status"),
    285: _of_mount("attitude_status"),
    331: odometry,
    380: time_estimate_to_target,
    410: event,
    411: current_event_sequence,
}
_NOT_OF = {3: {8, 83, 105, 141, 230, 331, 380, 410, 411}, 12: {162, 193}}

MESSAGES: Mapping[int, Mapping[int, Callable[[Report], Message]]] = MappingProxyType(
    {autopilot: {n: tell for n, tell in _ALL.items() if n not in others} for autopilot, others in _NOT_OF.items()}
)
"""By MAV_AUTOPILOT: every message that can be asked for, by its number."""
