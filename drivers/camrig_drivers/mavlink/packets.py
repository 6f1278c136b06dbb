"""What the driver hears and says, as plain values: the vehicle logic knows these and no MAVLink library.

Field names, units and numbers are those of MAVLink's common.xml unless a name says its unit.
"""

from __future__ import annotations

from dataclasses import dataclass

Triple = tuple[float, float, float]

OWN_SYSTEM, OWN_COMPONENT = 255, 190
"""ArduPilot counts heartbeats of system 255 only (MAV_GCS_SYSID)."""

_COPTERS = {2, 3, 4, 13, 14, 15, 29, 35, 43}
"""MAV_TYPE: quadrotor, coaxial, helicopter, hexa-, octo-, tri-, dodeca-, decarotor, multirotor."""

# --- heard ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT (0): who is there, its mode, and whether it is armed."""

    autopilot: int
    base_mode: int
    custom_mode: int
    kind: int = 2
    """MAV_TYPE."""

    @property
    def is_autopilot(self) -> bool:
        """MAV_AUTOPILOT_INVALID (8) marks ground stations, cameras and gimbals."""
        return self.autopilot != 8

    @property
    def is_copter(self) -> bool:
        """Whether it hovers: an aeroplane or a rover of the same firmware family means other modes by the numbers."""
        return self.kind in _COPTERS

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
    position_ned_m: Triple
    velocity_ned_m_s: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ExtendedState:
    """EXTENDED_SYS_STATE (245): landed_state is 0 unknown, 1 on ground, 2 in air, 3 taking off, 4 landing."""

    landed_state: int


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """SYS_STATUS (1): bit masks of MAV_SYS_STATUS_SENSOR; ``battery`` is the charge left, 0 to 1, where it is known."""

    present: int
    enabled: int
    health: int
    battery: float | None = None

    @property
    def prearm_failing(self) -> bool:
        """MAV_SYS_STATUS_PREARM_CHECK is there and not healthy."""
        prearm = 0x10000000
        return bool(self.present & self.enabled & prearm) and not self.health & prearm

    @property
    def fence_breached(self) -> bool:
        """MAV_SYS_STATUS_GEOFENCE is in use and not healthy."""
        fence = 0x100000
        return bool(self.present & self.enabled & fence) and not self.health & fence


@dataclass(frozen=True, slots=True)
class CommandAck:
    """COMMAND_ACK (77); ``target`` is (system, component), zeros where the sender left it out."""

    command: int
    result: int
    target: tuple[int, int]

    @property
    def refuses(self) -> bool:
        """Whether the command will not be done: neither accepted (0) nor in progress (5)."""
        return self.result not in {0, 5}

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


@dataclass(frozen=True, slots=True)
class ParamValue:
    """PARAM_VALUE (22) as the wire has it; how an integer is squeezed into ``wire`` differs by autopilot."""

    name: str
    wire: float
    kind: int


@dataclass(frozen=True, slots=True)
class TimeSync:
    """TIMESYNC (111), both ways, nanoseconds: ``tc1`` is 0 in a question, ``ts1`` the asker's clock."""

    tc1: int
    ts1: int


@dataclass(frozen=True, slots=True)
class Estimator:
    """EKF_STATUS_REPORT (193) or ESTIMATOR_STATUS (230): flags of common meaning, the worst test ratio but yaw's."""

    flags: int
    worst_ratio: float

    @property
    def lacks(self) -> tuple[str, ...]:
        """What the estimator does not know, in words."""
        known = {
            "attitude": self.flags & 1,
            "horizontal position": self.flags & (8 | 16),
            "height": self.flags & (32 | 64),
        }
        stands = ("horizontal position (it assumes that it stands still)",) if self.flags & 128 else ()
        return (*(name for name, told in known.items() if not told), *stands)


@dataclass(frozen=True, slots=True)
class GlobalOrigin:
    """GPS_GLOBAL_ORIGIN (49): the estimator's origin is set; degrees and metres."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class Version:
    """AUTOPILOT_VERSION (148)."""

    capabilities: int
    software: int

    @property
    def takes_local_targets(self) -> bool:
        """MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED."""
        return bool(self.capabilities & 128)

    @property
    def number(self) -> str:
        """Major, minor and patch."""
        return ".".join(str(self.software >> shift & 0xFF) for shift in (24, 16, 8))


@dataclass(frozen=True, slots=True)
class GimbalAttitude:
    """GIMBAL_DEVICE_ATTITUDE_STATUS (285): where the gimbal points; pitch is 0 ahead, -pi/2 down."""

    pitch_rad: float


Heard = (
    Heartbeat
    | Attitude
    | LocalPosition
    | ExtendedState
    | SystemStatus
    | CommandAck
    | StatusText
    | ParamValue
    | TimeSync
    | Estimator
    | GlobalOrigin
    | Version
    | GimbalAttitude
)

# --- said -----------------------------------------------------------------------------------------------


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

    position_ned_m: Triple
    yaw_ned_rad: float


@dataclass(frozen=True, slots=True)
class ParamRead:
    """PARAM_REQUEST_READ (20), by name."""

    name: str


@dataclass(frozen=True, slots=True)
class SetOrigin:
    """SET_GPS_GLOBAL_ORIGIN (48); never acknowledged."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class ExternalPose:
    """Where the vehicle is seen from outside; ``stamp_us`` is of the clock that answers TIMESYNC.

    ``rpy_rad`` turn NED into FRD; ``covariance`` has the 21 numbers of the upper triangle, row by row, over
    x, y, z, roll, pitch, yaw.
    """

    stamp_us: int
    position_ned_m: Triple
    rpy_rad: Triple
    covariance: tuple[float, ...]
    reset_counter: int


@dataclass(frozen=True, slots=True)
class VisionEstimate:
    """The pose as VISION_POSITION_ESTIMATE (102), which ArduPilot takes."""

    pose: ExternalPose


@dataclass(frozen=True, slots=True)
class Odometry:
    """The pose as ODOMETRY (331), frames LOCAL_NED and BODY_FRD, which PX4 takes."""

    pose: ExternalPose


Said = OwnHeartbeat | Command | PositionTarget | TimeSync | ParamRead | SetOrigin | VisionEstimate | Odometry
