"""The commands (MAV_CMD) that the emulated drone knows."""

from __future__ import annotations

from enum import IntEnum


class Cmd(IntEnum):
    """MAV_CMD, without its prefixes."""

    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    CONDITION_YAW = 115
    SET_MODE = 176
    CHANGE_SPEED = 178
    MOUNT_CONTROL = 205
    REBOOT = 246
    ARM_DISARM = 400
    GET_HOME_POSITION = 410
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    GIMBAL_PITCH_YAW = 1000
    GIMBAL_CONFIGURE = 1001
