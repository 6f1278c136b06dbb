"""Telemetry of the emulated drone: one function a message, each from the vehicle and the newest reportable sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.geometry.arrays import Array
from camrig_emulators.mavlink.frames import R_ned_frd, euler, quaternion, swap
from camrig_emulators.mavlink.history import Sample
from camrig_emulators.mavlink.params import RELEASES
from camrig_emulators.mavlink.vehicle import Vehicle

Message: TypeAlias = Any
"""A message of the generated dialect, which is untyped."""

_QUADROTOR = 2
_CUSTOM, _STABILIZE, _GUIDED, _ARMED = 1, 16, 8, 128  # MAV_MODE_FLAG
_STANDBY, _ACTIVE, _STATE_CRITICAL = 3, 4, 5  # MAV_STATE
_SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x200000 | 0x2000000  # gyro, accelerometer, magnetometer, barometer, AHRS, battery
_GPS, _VISION, _FENCE, _AHRS, _PREARM = 0x20, 0x80, 0x100000, 0x200000, 0x10000000
_UNKNOWN_CELL = 0xFFFF
_DEVELOPMENT, _OFFICIAL = 0, 0xFF  # FIRMWARE_VERSION_TYPE
_CAPABILITIES = 0x2 | 0x8 | 0x80 | 0x100 | 0x2000 | 0x40000  # float params, COMMAND_INT, local and global targets …


@dataclass(eq=False)
class Report:
    """What a message may tell: ``sample`` is what telemetry knows now, ``earlier`` the step before it."""

    vehicle: Vehicle
    sample: Sample
    earlier: Sample

    @property
    def boot_ms(self) -> int:
        """The sample's stamp on the vehicle's clock."""
        return self.vehicle.boot_ms(self.sample.stamp_s)

    @cached_property
    def attitude(self) -> Array:
        """(3, 3) estimated R_ned_frd."""
        return R_ned_frd(self.sample.R_world_body)

    @cached_property
    def rates(self) -> tuple[float, float, float]:
        """Estimated body rates about forward, right, down."""
        dt_s = self.sample.stamp_s - self.earlier.stamp_s
        if dt_s <= 0.0:
            return 0.0, 0.0, 0.0
        turn = R_ned_frd(self.earlier.R_world_body).T @ self.attitude
        x, y, z = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2.0 * dt_s)
        return float(x), float(y), float(z)


def heartbeat(report: Report) -> Message:
    """HEARTBEAT (0)."""
    vehicle = report.vehicle
    cockpit, firmware = vehicle.cockpit, vehicle.firmware
    base = _CUSTOM | _STABILIZE | _GUIDED | (_ARMED if cockpit.armed else 0)
    state = _STATE_CRITICAL if cockpit.critical else _ACTIVE if cockpit.armed else _STANDBY
    return dialect.MAVLink_heartbeat_message(_QUADROTOR, firmware.autopilot, base, firmware.custom_mode, state, 3)


def sys_status(report: Report) -> Message:
    """SYS_STATUS (1). A sensor that the firmware does not navigate by is not there."""
    cockpit, stamp_s = report.vehicle.cockpit, report.sample.stamp_s
    estimator = cockpit.estimator
    source = _GPS if estimator.sources.gps else _VISION if estimator.sources.vision_position else 0
    present = _SENSORS | _FENCE | _PREARM | source
    faulty = {
        _PREARM: not estimator.ready,
        source: not estimator.aided,
        _AHRS: not estimator.local,
        _FENCE: cockpit.fence_breach != 0,
    }
    healthy = present & ~sum(bit for bit, is_faulty in faulty.items() if is_faulty)
    voltage_mV, charge = round(1e3 * cockpit.battery.voltage_V(stamp_s)), round(100.0 * cockpit.battery.charge(stamp_s))
    return dialect.MAVLink_sys_status_message(
        present, present, healthy, 200, voltage_mV, 1500, charge, 0, 0, 0, 0, 0, 0
    )


def gps_raw_int(report: Report) -> Message:
    """GPS_RAW_INT (24), made up; no fix where the firmware has no GPS, or it is blinded."""
    estimator = report.vehicle.cockpit.estimator
    if not estimator.sources.gps or estimator.blinded:
        return dialect.MAVLink_gps_raw_int_message(report.boot_ms * 1000, 0, 0, 0, 0, 0xFFFF, 0xFFFF, 0, 0xFFFF, 0)
    latitude, longitude, altitude = report.vehicle.cockpit.frame.to_globe(report.sample.position_m)
    usec = report.boot_ms * 1000
    return dialect.MAVLink_gps_raw_int_message(usec, 3, latitude, longitude, altitude, 90, 120, 0, 0xFFFF, 12)


def attitude(report: Report) -> Message:
    """ATTITUDE (30)."""
    return dialect.MAVLink_attitude_message(report.boot_ms, *euler(report.attitude), *report.rates)


def attitude_quaternion(report: Report) -> Message:
    """ATTITUDE_QUATERNION (31)."""
    return dialect.MAVLink_attitude_quaternion_message(report.boot_ms, *quaternion(report.attitude), *report.rates)


def local_position_ned(report: Report) -> Message:
    """LOCAL_POSITION_NED (32), once there is an estimate."""
    if not report.vehicle.cockpit.estimator.local:
        return None
    position = report.vehicle.cockpit.frame.to_ned(report.sample.position_m)
    velocity = swap(report.sample.velocity_m_s)
    return dialect.MAVLink_local_position_ned_message(report.boot_ms, *map(float, (*position, *velocity)))


def global_position_int(report: Report) -> Message:
    """GLOBAL_POSITION_INT (33), on a flat earth."""
    cockpit = report.vehicle.cockpit
    if not (cockpit.estimator.local and cockpit.estimator.origin_known) or cockpit.home_m is None:
        return None
    position_m = report.sample.position_m
    above_home_mm = round(float(np.clip(1e3 * (position_m[2] - cockpit.home_m[2]), -(2.0**31), 2.0**31 - 1.0)))
    velocity_cm_s = [round(float(value)) for value in np.clip(100.0 * swap(report.sample.velocity_m_s), -32768, 32767)]
    heading_cdeg = round(100.0 * math.degrees(euler(report.attitude)[2])) % 36000
    return dialect.MAVLink_global_position_int_message(
        report.boot_ms, *cockpit.frame.to_globe(position_m), above_home_mm, *velocity_cm_s, heading_cdeg
    )


def battery_status(report: Report) -> Message:
    """BATTERY_STATUS (147)."""
    battery, stamp_s = report.vehicle.cockpit.battery, report.sample.stamp_s
    voltages = [round(1e3 * battery.voltage_V(stamp_s))] + [_UNKNOWN_CELL] * 9
    charge = round(100.0 * battery.charge(stamp_s))
    return dialect.MAVLink_battery_status_message(0, 0, 1, 2500, voltages, 1500, -1, -1, charge)


def home_position(report: Report) -> Message:
    """HOME_POSITION (242), once home is set and has a place on the globe."""
    cockpit = report.vehicle.cockpit
    if cockpit.home_m is None or not cockpit.estimator.origin_known:
        return None
    north, east, down = map(float, cockpit.frame.to_ned(cockpit.home_m))
    globe = cockpit.frame.to_globe(cockpit.home_m)
    return dialect.MAVLink_home_position_message(*globe, north, east, down, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)


def autopilot_version(report: Report) -> Message:
    """AUTOPILOT_VERSION (148)."""
    vehicle = report.vehicle
    uid = vehicle.settings.system
    release = vehicle.settings.release or RELEASES[vehicle.settings.flavour][-1]
    major, minor = (int(part) for part in release.split("."))
    kind = _DEVELOPMENT if release == "4.7" else _OFFICIAL
    version, none = major << 24 | minor << 16 | kind, [0] * 8
    return dialect.MAVLink_autopilot_version_message(_CAPABILITIES, version, 0, 0, 0, none, none, none, 0, 0, uid)


def extended_sys_state(report: Report) -> Message:
    """EXTENDED_SYS_STATE (245)."""
    return dialect.MAVLink_extended_sys_state_message(0, report.vehicle.firmware.landed_state)


def timesync(report: Report) -> Message:
    """TIMESYNC (111), the vehicle's own question."""
    return dialect.MAVLink_timesync_message(0, report.vehicle.boot_ns(report.sample.stamp_s))


TELEMETRY: Mapping[int, Callable[[Report], Message]] = MappingProxyType(
    {
        0: heartbeat,
        1: sys_status,
        24: gps_raw_int,
        30: attitude,
        31: attitude_quaternion,
        32: local_position_ned,
        33: global_position_int,
        111: timesync,
        147: battery_status,
        148: autopilot_version,
        242: home_position,
        245: extended_sys_state,
    }
)
"""What ground stations need, by number."""
