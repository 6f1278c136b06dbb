"""MAVLink frames to packets and back; the only file that knows pymavlink.

The dialect is imported by name (0.03 s): ``mavutil`` would choose it by environment variable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_drivers.mavlink.packets import (
    OWN_COMPONENT,
    OWN_SYSTEM,
    Attitude,
    Command,
    CommandAck,
    ExtendedState,
    Heard,
    Heartbeat,
    LocalPosition,
    OwnHeartbeat,
    PositionTarget,
    Said,
    StatusText,
    SystemStatus,
)

POSITION_AND_YAW = 0x9F8
"""type_mask: ignore velocity, acceleration and yaw rate."""

Address = tuple[int, int]
"""System and component id."""

_MARKERS = (0xFE, 0xFD)
_MAX_FRAME = 280


class Decoder:
    """Finds frames in the bytes of one peer. Resynchronises byte by byte, so that garbage costs itself alone."""

    def __init__(self) -> None:
        self._mavlink: Any = dialect.MAVLink(None, OWN_SYSTEM, OWN_COMPONENT)
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[Address, Heard]]:
        """Yield (sender, packet) for every known message; bad frames and unknown messages are passed over."""
        self._buffer += data
        while (length := _frame_length(self._buffer)) is not None and length <= len(self._buffer):
            message = self._decode(length) if length else None
            if message is None or not self._frame_ends_well(message, length):
                del self._buffer[:1]
                continue
            del self._buffer[:length]
            packet = _packet(message)
            if packet is not None:
                yield (message.get_srcSystem(), message.get_srcComponent()), packet

    def _decode(self, length: int) -> Any:
        try:
            return self._mavlink.decode(self._buffer[:length])
        except dialect.MAVError:
            return None

    def _frame_ends_well(self, message: Any, length: int) -> bool:
        """Believe the length of an unknown message, whose checksum cannot be tested, only where a frame follows."""
        known = not isinstance(message, dialect.MAVLink_unknown)
        return known or len(self._buffer) == length or self._buffer[length] in _MARKERS


class Encoder:
    """Packs what we say to one vehicle after another; one sequence per link, as MAVLink counts."""

    def __init__(self) -> None:
        self._mavlink: Any = dialect.MAVLink(None, OWN_SYSTEM, OWN_COMPONENT)

    def encode(self, packet: Said, target: Address) -> bytes:
        """Return one MAVLink 2 frame."""
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
        case LocalPosition(position_ned_m=position):
            return position
        case Attitude(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw):
            return roll, pitch, yaw
    return ()


_HEARD: dict[str, Callable[[Any], Heard]] = {
    "HEARTBEAT": lambda m: Heartbeat(m.autopilot, m.base_mode, m.custom_mode),
    "ATTITUDE": lambda m: Attitude(m.time_boot_ms, m.roll, m.pitch, m.yaw),
    "LOCAL_POSITION_NED": lambda m: LocalPosition(m.time_boot_ms, (m.x, m.y, m.z)),
    "EXTENDED_SYS_STATE": lambda m: ExtendedState(m.landed_state),
    "SYS_STATUS": lambda m: SystemStatus(
        m.onboard_control_sensors_present, m.onboard_control_sensors_enabled, m.onboard_control_sensors_health
    ),
    "COMMAND_ACK": lambda m: CommandAck(m.command, m.result, (m.target_system, m.target_component)),
    "STATUSTEXT": lambda m: StatusText(m.severity, m.text, m.id, m.chunk_seq),
}


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
