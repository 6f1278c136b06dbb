"""What the driver hears and says, as plain values: the vehicle logic knows these and no MAVLink library.

Field names, units and numbers are those of MAVLink's common.xml unless a name says its unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

OWN_SYSTEM, OWN_COMPONENT = 255, 190
"""ArduPilot counts heartbeats of system 255 only (MAV_GCS_SYSID)."""

# --- heard ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT (0): who is there, its mode, and whether it is armed."""

    autopilot: int
    base_mode: int
    custom_mode: int

    @property
    def is_autopilot(self) -> bool:
        """MAV_AUTOPILOT_INVALID (8) marks ground stations, cameras and gimbals."""
        return self.autopilot != 8

    @property
    def armed(self) -> bool:
        """MAV_MODE_FLAG_SAFETY_ARMED."""
        return bool(self.base_mode & 128)


@dataclass(frozen=True, slots=True)
class Attitude:
    """ATTITUDE (30): angles that turn NED into FRD."""

    time_boot_ms: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """LOCAL_POSITION_NED (32), relative to the estimator's origin."""

    time_boot_ms: int
    position_ned_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ExtendedState:
    """EXTENDED_SYS_STATE (245): landed_state is 0 unknown, 1 on ground, 2 in air, 3 taking off, 4 landing."""

    landed_state: int


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """SYS_STATUS (1): bit masks of MAV_SYS_STATUS_SENSOR."""

    present: int
    enabled: int
    health: int

    @property
    def prearm_failing(self) -> bool:
        """MAV_SYS_STATUS_PREARM_CHECK is there and not healthy."""
        prearm = 0x10000000
        return bool(self.present & self.enabled & prearm) and not self.health & prearm


@dataclass(frozen=True, slots=True)
class CommandAck:
    """COMMAND_ACK (77); ``target`` is (system, component), zeros where the sender left it out."""

    command: int
    result: int
    target: tuple[int, int]

    @property
    def is_for_us(self) -> bool:
        """Whether it answers our command, as far as it says so; other ground stations command too."""
        return self.target in {(OWN_SYSTEM, OWN_COMPONENT), (0, 0)}


@dataclass(frozen=True, slots=True)
class StatusText:
    """STATUSTEXT (253); texts over 50 characters come in chunks of one ``id`` != 0."""

    severity: int
    text: str
    id: int = 0
    chunk: int = 0


Heard = Heartbeat | Attitude | LocalPosition | ExtendedState | SystemStatus | CommandAck | StatusText

# --- said -----------------------------------------------------------------------------------------------

NAV_LAND = 21
NAV_TAKEOFF = 22
DO_SET_MODE = 176
ARM_DISARM = 400
SET_MESSAGE_INTERVAL = 511


@dataclass(frozen=True, slots=True)
class OwnHeartbeat:
    """HEARTBEAT (0) of a ground station; autopilots count its absence as a failure."""


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG (76)."""

    command: int
    params: tuple[float, float, float, float, float, float, float]
    confirmation: int = 0


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """SET_POSITION_TARGET_LOCAL_NED (84), frame 1, position and yaw only."""

    position_ned_m: tuple[float, float, float]
    yaw_ned_rad: float


Said = OwnHeartbeat | Command | PositionTarget


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
