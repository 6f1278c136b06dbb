"""MAVLink frames to packets and back; the only file that knows pymavlink.

The dialect is imported by name (0.03 s): ``mavutil`` would choose it by environment variable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_drivers.mavlink.packets import (
    OWN_COMPONENT,
    OWN_SYSTEM,
    Attitude,
    Command,
    CommandAck,
    Estimator,
    ExtendedState,
    ExternalPose,
    GimbalAttitude,
    GlobalOrigin,
    Heard,
    Heartbeat,
    LocalPosition,
    Odometry,
    OwnHeartbeat,
    ParamRead,
    ParamValue,
    PositionTarget,
    Said,
    SetOrigin,
    StatusText,
    SystemStatus,
    TimeSync,
    Version,
    VisionEstimate,
)
from camrig_drivers.mavlink.signing import Signing

POSITION_AND_YAW = 0x9F8
"""type_mask: ignore velocity, acceleration and yaw rate."""

Address = tuple[int, int]
"""System and component id."""

_MARKERS = (0xFE, 0xFD)
_MAX_FRAME = 280


class Seals:
    """The signatures of one link, shared by its decoders and its encoder; without a ``Signing`` it has none."""

    def __init__(self, signing: Signing | None = None) -> None:
        self._signing = signing
        self.refused = 0
        """How many frames were not, or not well, signed."""
        self.state: Any = dialect.MAVLinkSigning()
        if signing is not None:
            self.state.timestamp = signing.begin()
            self.state.secret_key, self.state.link_id = signing.key, signing.link_id
            self.state.sign_outgoing = True

    @property
    def signed(self) -> bool:
        """Whether nothing is heard that is not signed."""
        return self._signing is not None

    def stamps(self) -> dict[Any, int]:
        """Return the last stamp of every stream that is heard."""
        return dict(self.state.stream_timestamps)

    def refuse(self, stamps: dict[Any, int]) -> None:
        """Count a frame, and go back to the stamps before it.

        pymavlink notes a stamp before it tests the signature: one damaged or forged frame of a time to come, and all
        good ones after it would be too old.
        """
        self.refused += 1
        self.state.stream_timestamps = stamps

    def advance(self) -> None:
        """Bring the stamp of the next frame up to now."""
        if self._signing is not None:
            self.state.timestamp = self._signing.stamp(self.state.timestamp)


class Decoder:
    """Finds frames in the bytes of one peer. Resynchronises byte by byte, so that garbage costs itself alone."""

    def __init__(self, seals: Seals | None = None) -> None:
        self._mavlink: Any = dialect.MAVLink(None, OWN_SYSTEM, OWN_COMPONENT)
        self._seals = seals or Seals()
        self._mavlink.signing = self._seals.state
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[Address, Heard]]:
        """Yield (sender, packet) for every known message; bad frames and unknown messages are passed over."""
        self._buffer += data
        while (length := _frame_length(self._buffer)) is not None and length <= len(self._buffer):
            message = self._decode(self._buffer[:length]) if length else None
            if message is None or not self._frame_ends_well(message, length):
                del self._buffer[:1]
                continue
            del self._buffer[:length]
            packet = _packet(message)
            if packet is not None:
                yield (message.get_srcSystem(), message.get_srcComponent()), packet

    def _decode(self, frame: bytearray) -> Any:
        stamps = self._seals.stamps()
        try:
            return self._mavlink.decode(frame)
        except dialect.MAVError as error:
            if "signature" in str(error):  # nothing but its text tells
                self._seals.refuse(stamps)
            return None

    def _frame_ends_well(self, message: Any, length: int) -> bool:
        """Believe the length of an unknown message, whose checksum cannot be tested, only where a frame follows and
        none is inside; a good signature vouches for it.
        """
        if not isinstance(message, dialect.MAVLink_unknown) or self._seals.signed:
            return True
        followed = len(self._buffer) == length or self._buffer[length] in _MARKERS
        return followed and not any(self._holds_frame(at, length) for at in range(1, length))

    def _holds_frame(self, start: int, end: int) -> bool:
        """Whether a good frame of a known message lies there."""
        inside = self._buffer[start:end]
        length = _frame_length(inside)
        if not length or length > len(inside):
            return False
        message = self._decode(inside[:length])
        return message is not None and not isinstance(message, dialect.MAVLink_unknown)


class Encoder:
    """Packs what we say to one vehicle after another; one sequence per link, as MAVLink counts."""

    def __init__(self, seals: Seals | None = None) -> None:
        self._mavlink: Any = dialect.MAVLink(None, OWN_SYSTEM, OWN_COMPONENT)
        self._seals = seals
        if seals is not None:
            self._mavlink.signing = seals.state

    def encode(self, packet: Said, target: Address) -> bytes:
        """Return one MAVLink 2 frame."""
        if self._seals is not None:
            self._seals.advance()
        frame = bytes(_message(packet, target).pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame


def _frame_length(buffer: bytearray) -> int | None:
    """Return the length of the frame at the start: 0 where none can start, None where more bytes must come."""
    if not buffer:
        return None
    if buffer[0] not in _MARKERS:
        return 0
    if len(buffer) < 3:
        return None
    if buffer[0] == 0xFE:
        return buffer[1] + 8
    signature = 13 if buffer[2] & 1 else 0
    length = buffer[1] + 12 + signature
    return length if length <= _MAX_FRAME and buffer[2] <= 1 else 0


def _packet(message: Any) -> Heard | None:
    build = _HEARD.get(message.get_type())
    packet = build(message) if build else None
    finite = all(math.isfinite(value) for value in _floats(packet))
    return packet if finite else None


def _floats(packet: Heard | None) -> tuple[float, ...]:
    match packet:
        case LocalPosition(position_ned_m=position, velocity_ned_m_s=velocity):
            return (*position, *velocity)
        case Attitude(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw):
            return roll, pitch, yaw
    return ()


_HEARD: dict[str, Callable[[Any], Heard]] = {
    "HEARTBEAT": lambda m: Heartbeat(m.autopilot, m.base_mode, m.custom_mode, m.type),
    "ATTITUDE": lambda m: Attitude(m.time_boot_ms, m.roll, m.pitch, m.yaw),
    "LOCAL_POSITION_NED": lambda m: LocalPosition(m.time_boot_ms, (m.x, m.y, m.z), (m.vx, m.vy, m.vz)),
    "EXTENDED_SYS_STATE": lambda m: ExtendedState(m.landed_state),
    "SYS_STATUS": lambda m: SystemStatus(
        m.onboard_control_sensors_present,
        m.onboard_control_sensors_enabled,
        m.onboard_control_sensors_health,
        m.battery_remaining / 100.0 if 0 <= m.battery_remaining <= 100 else None,
    ),
    "COMMAND_ACK": lambda m: CommandAck(m.command, m.result, (m.target_system, m.target_component)),
    "STATUSTEXT": lambda m: StatusText(m.severity, m.text, m.id, m.chunk_seq),
    "PARAM_VALUE": lambda m: ParamValue(m.param_id, m.param_value, m.param_type),
    "TIMESYNC": lambda m: TimeSync(m.tc1, m.ts1),
    "EKF_STATUS_REPORT": lambda m: Estimator(
        m.flags, _worst(m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance)
    ),
    "ESTIMATOR_STATUS": lambda m: Estimator(m.flags, _worst(m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio)),
    "GPS_GLOBAL_ORIGIN": lambda m: GlobalOrigin(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3),
    "AUTOPILOT_VERSION": lambda m: Version(m.capabilities, m.flight_sw_version),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": lambda m: GimbalAttitude(_pitch_rad(m.q)),
}


def _worst(*ratios: float) -> float:
    """Return the greatest ratio; one that is no number has not been tested."""
    return max((ratio for ratio in ratios if math.isfinite(ratio)), default=0.0)


def _pitch_rad(q: Sequence[float]) -> float:
    """Return the pitch of a quaternion w, x, y, z; NaN where the gimbal does not know it."""
    w, x, y, z = q
    sine = 2.0 * (w * y - z * x)
    return math.asin(min(1.0, max(-1.0, sine))) if math.isfinite(sine) else math.nan


def _quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> list[float]:
    """Return w, x, y, z of the turn of a body by yaw, then pitch, then roll."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2.0), math.sin(a / 2.0)) for a in (roll_rad, pitch_rad, yaw_rad))
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def _message(packet: Said, target: Address) -> Any:
    match packet:
        case OwnHeartbeat():
            return dialect.MAVLink_heartbeat_message(
                dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
            )
        case Command(command=command, params=params, confirmation=confirmation):
            return dialect.MAVLink_command_long_message(*target, command, confirmation, *params)
        case PositionTarget(position_ned_m=position, yaw_ned_rad=yaw):
            zeros = (0.0,) * 6
            return dialect.MAVLink_set_position_target_local_ned_message(
                0, *target, dialect.MAV_FRAME_LOCAL_NED, POSITION_AND_YAW, *position, *zeros, yaw, 0.0
            )
        case TimeSync(tc1=tc1, ts1=ts1):
            return dialect.MAVLink_timesync_message(tc1, ts1)
        case ParamRead(name=name):
            return dialect.MAVLink_param_request_read_message(*target, name.encode("ascii"), -1)
        case SetOrigin(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude):
            return dialect.MAVLink_set_gps_global_origin_message(
                target[0], round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), 0
            )
        case VisionEstimate(pose=pose):
            return dialect.MAVLink_vision_position_estimate_message(
                pose.stamp_us, *pose.position_ned_m, *pose.rpy_rad, list(pose.covariance), pose.reset_counter
            )
        case Odometry(pose=pose):
            return _odometry(pose)


def _odometry(pose: ExternalPose) -> Any:
    """Return ODOMETRY without velocities: NaN says that they are unknown."""
    unknown = [math.nan] * 21
    return dialect.MAVLink_odometry_message(
        pose.stamp_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *pose.position_ned_m,
        _quaternion(*pose.rpy_rad),
        *[math.nan] * 6,
        list(pose.covariance),
        unknown,
        pose.reset_counter,
        dialect.MAV_ESTIMATOR_TYPE_VISION,
        0,
    )
