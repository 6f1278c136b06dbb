"""The commands that we give, as COMMAND_LONG."""

from __future__ import annotations

import math

from camrig_drivers.mavlink.packets import OWN_COMPONENT, OWN_SYSTEM, Command

NAV_LAND = 21
NAV_TAKEOFF = 22
DO_SET_MODE = 176
ARM_DISARM = 400
DO_CHANGE_SPEED = 178
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
GIMBAL_PITCHYAW = 1000
GIMBAL_CONFIGURE = 1001


def set_mode(main: float, sub: float) -> Command:
    """DO_SET_MODE to a custom mode, as the flavour spells it."""
    return Command(DO_SET_MODE, (1.0, main, sub, 0.0, 0.0, 0.0, 0.0))


def arm() -> Command:
    """Arm, with the autopilot's own checks."""
    return Command(ARM_DISARM, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def take_off(height_m: float) -> Command:
    """NAV_TAKEOFF to a height above the ground (ArduPilot's reading of parameter 7)."""
    return Command(NAV_TAKEOFF, (0.0, 0.0, 0.0, math.nan, 0.0, 0.0, height_m))


def land() -> Command:
    """NAV_LAND here, keeping the heading."""
    return Command(NAV_LAND, (0.0, 0.0, 0.0, math.nan, 0.0, 0.0, 0.0))


def message_interval(message_id: int, rate_hz: float) -> Command:
    """Ask for one message at a rate."""
    return Command(SET_MESSAGE_INTERVAL, (float(message_id), 1e6 / rate_hz, 0.0, 0.0, 0.0, 0.0, 0.0))


def request_message(message_id: int) -> Command:
    """Ask for one message, once."""
    return Command(REQUEST_MESSAGE, (float(message_id), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def change_speed(kind: int, speed_m_s: float) -> Command:
    """Set ArduPilot's speed of travel: ``kind`` 1 over ground, 2 climbing, 3 descending."""
    return Command(DO_CHANGE_SPEED, (float(kind), speed_m_s, -1.0, 0.0, 0.0, 0.0, 0.0))


def gimbal_down(*, takes_control: bool) -> tuple[Command, ...]:
    """Point the primary gimbal down, its yaw following the body; PX4 wants primary control of it taken first."""
    control = Command(GIMBAL_CONFIGURE, (float(OWN_SYSTEM), float(OWN_COMPONENT), -1.0, -1.0, 0.0, 0.0, 0.0))
    down = Command(GIMBAL_PITCHYAW, (-90.0, 0.0, math.nan, math.nan, 0.0, 0.0, 0.0))
    return (control, down) if takes_control else (down,)
