"""What each firmware sends unasked, and the groups of REQUEST_DATA_STREAM."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

ARDUPILOT_STREAMS_HZ: Mapping[int, float] = MappingProxyType({0: 1.0, 111: 0.3})
"""HEARTBEAT and TIMESYNC, and nothing else until somebody asks."""

PX4_STREAMS_HZ: Mapping[int, float] = MappingProxyType(
    {
        0: 1.0,  # HEARTBEAT
        1: 5.0,  # SYS_STATUS
        2: 1.0,  # SYSTEM_TIME
        8: 1.0,  # LINK_NODE_STATUS
        24: 1.0,  # GPS_RAW_INT
        30: 100.0,  # ATTITUDE
        31: 50.0,  # ATTITUDE_QUATERNION
        32: 30.0,  # LOCAL_POSITION_NED
        33: 50.0,  # GLOBAL_POSITION_INT
        74: 10.0,  # VFR_HUD
        83: 30.0,  # ATTITUDE_TARGET
        85: 10.0,  # POSITION_TARGET_LOCAL_NED
        105: 50.0,  # HIGHRES_IMU
        111: 10.0,  # TIMESYNC
        141: 10.0,  # ALTITUDE
        147: 0.5,  # BATTERY_STATUS
        230: 1.0,  # ESTIMATOR_STATUS
        241: 0.5,  # VIBRATION
        242: 0.5,  # HOME_POSITION
        245: 5.0,  # EXTENDED_SYS_STATE
        331: 30.0,  # ODOMETRY
        380: 1.0,  # TIME_ESTIMATE_TO_TARGET
        410: 0.2,  # EVENT
        411: 0.5,  # CURRENT_EVENT_SEQUENCE
    }
)
"""Pushed to whoever is there."""

GROUPS: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        0: (1, 24, 30, 32, 33, 74, 147, 193, 245),
        2: (1, 24),
        6: (32, 33),
        10: (30,),
        11: (74, 147),
        12: (147, 193, 245),
    }
)
"""MAV_DATA_STREAM: which of our messages are in it."""
