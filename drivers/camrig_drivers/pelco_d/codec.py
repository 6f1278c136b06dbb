"""Pelco-D frames and replies, without I/O or time: bytes of a request out, bytes that were received in.

A command is ``FF address word1 word2 data1 data2 checksum``; the checksum is the sum of the five bytes between, modulo
256. A reply carries no length: 4 bytes (general), 7 (extended) or 18 (device query) follows from what was asked alone,
and FF is legal inside a frame, so nothing here ever cuts a stream at FF.
Sources: Pelco "D Protocol" v5.0.1; DRD14 C466M-E p. 22 (the general reply's checksum).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, StrEnum
from types import MappingProxyType

from camrig.errors import HardwareError, InputError

SYNC = 0xFF
COMMAND_BYTES = 7
GENERAL_BYTES = 4
EXTENDED_BYTES = 7
DEVICE_BYTES = 18
FULL_TURN_RAW = 36000
"""Hundredths of a degree in a turn; some heads say 36000 where they mean 0."""
_LOST_AT_MOST = 3
"""How many first bytes of a reply a line may lose at its turn-around and still be completed from the request."""


class FrameError(HardwareError):
    """Bytes that are not the frame they should be."""


class Op(IntEnum):
    """Extended opcodes (word2, always odd). 57 and 69 start a download into the head and are left out."""

    SET_PRESET = 0x03
    CLEAR_PRESET = 0x05
    CALL_PRESET = 0x07
    SET_AUX = 0x09
    CLEAR_AUX = 0x0B
    DUMMY = 0x0D
    REMOTE_RESET = 0x0F
    ZONE_START = 0x11
    ZONE_END = 0x13
    WRITE_CHAR = 0x15
    CLEAR_SCREEN = 0x17
    ALARM_ACK = 0x19
    ZONE_SCAN_ON = 0x1B
    ZONE_SCAN_OFF = 0x1D
    PATTERN_START = 0x1F
    PATTERN_STOP = 0x21
    RUN_PATTERN = 0x23
    ZOOM_SPEED = 0x25
    FOCUS_SPEED = 0x27
    RESET_DEFAULTS = 0x29
    AUTO_FOCUS = 0x2B
    AUTO_IRIS = 0x2D
    AGC = 0x2F
    BLC = 0x31
    AWB = 0x33
    PHASE_DELAY = 0x35
    SHUTTER = 0x37
    LINE_LOCK = 0x39
    WB_RB = 0x3B
    WB_MG = 0x3D
    GAIN = 0x3F
    IRIS_LEVEL = 0x41
    IRIS_PEAK = 0x43
    QUERY_DEVICE = 0x45
    SET_ZERO = 0x49
    SET_PAN = 0x4B
    SET_TILT = 0x4D
    SET_ZOOM = 0x4F
    QUERY_PAN = 0x51
    QUERY_TILT = 0x53
    QUERY_ZOOM = 0x55
    PAN = 0x59
    TILT = 0x5B
    ZOOM = 0x5D
    SET_MAGNIFICATION = 0x5F
    QUERY_MAGNIFICATION = 0x61
    MAGNIFICATION = 0x63
    QUERY_DEVICE_TYPE = 0x6B
    DEVICE_TYPE = 0x6D
    QUERY_DIAGNOSTICS = 0x6F
    DIAGNOSTICS = 0x71


ANSWERS: Mapping[int, Op] = MappingProxyType(
    {
        Op.QUERY_PAN: Op.PAN,
        Op.QUERY_TILT: Op.TILT,
        Op.QUERY_ZOOM: Op.ZOOM,
        Op.QUERY_MAGNIFICATION: Op.MAGNIFICATION,
        Op.QUERY_DEVICE_TYPE: Op.DEVICE_TYPE,
        Op.QUERY_DIAGNOSTICS: Op.DIAGNOSTICS,
    }
)
"""Which opcode answers which query with an extended reply."""


class Axis(Enum):
    """What a head can be sent to: the opcodes that set, ask and report it."""

    PAN = (Op.SET_PAN, Op.QUERY_PAN, Op.PAN)
    TILT = (Op.SET_TILT, Op.QUERY_TILT, Op.TILT)
    ZOOM = (Op.SET_ZOOM, Op.QUERY_ZOOM, Op.ZOOM)

    def __init__(self, set_op: Op, query_op: Op, answer_op: Op) -> None:
        self.set_op, self.query_op, self.answer_op = set_op, query_op, answer_op


@dataclass(frozen=True, slots=True)
class Command:
    """The four bytes between address and checksum."""

    word1: int
    word2: int
    data1: int = 0
    data2: int = 0


@dataclass(frozen=True, slots=True)
class Request:
    """A command to one address, and with it what its reply must look like."""

    address: int
    command: Command

    @property
    def frame(self) -> bytes:
        return encode(self.address, self.command)

    @property
    def answer_op(self) -> Op | None:
        """The opcode of the extended reply, where one is due."""
        return ANSWERS.get(self.command.word2) if self.command.word1 == 0 else None

    @property
    def reply_bytes(self) -> int:
        if self.answer_op is not None:
            return EXTENDED_BYTES
        return DEVICE_BYTES if self.command == Command(0, Op.QUERY_DEVICE) else GENERAL_BYTES


@dataclass(frozen=True, slots=True)
class General:
    """Understood, with the alarms 1..7 that are active; ``own_sum`` marks the deviant checksum, address plus alarms."""

    address: int
    alarms: tuple[int, ...]
    own_sum: bool = False


@dataclass(frozen=True, slots=True)
class Extended:
    """An answer of two data bytes. ``degraded`` marks one whose first bytes were lost and taken from the request."""

    address: int
    op: Op
    data1: int
    data2: int
    degraded: bool = False

    @property
    def value(self) -> int:
        """Both data bytes as one number: hundredths of a degree for pan and tilt."""
        return self.data1 << 8 | self.data2


@dataclass(frozen=True, slots=True)
class Device:
    """The 15 bytes of text with which a head describes itself."""

    address: int
    data: bytes


Reply = General | Extended | Device


class Echo(StrEnum):
    """Whether the line gives back our own bytes, as some 2-wire adapters do."""

    AUTO = "auto"
    YES = "yes"
    NO = "no"


def encode(address: int, command: Command) -> bytes:
    """Return the 7 bytes of a command; raises InputError for a field that is no byte."""
    body = (address, command.word1, command.word2, command.data1, command.data2)
    if any(not 0 <= field <= 0xFF for field in body):
        raise InputError(f"Pelco-D fields are bytes 0..255; got address and command {body}")
    return bytes((SYNC, *body, sum(body) & 0xFF))


def decode(frame: bytes) -> tuple[int, Command]:
    """Return address and command of one 7-byte frame; raises FrameError."""
    if len(frame) != COMMAND_BYTES or frame[0] != SYNC:
        raise FrameError(f"a Pelco-D frame is 7 bytes from FF; got {frame.hex(' ') or 'nothing'}")
    if sum(frame[1:6]) & 0xFF != frame[6]:
        raise FrameError(f"wrong checksum in {frame.hex(' ')}: the sum is {sum(frame[1:6]) & 0xFF:02x}")
    return frame[1], Command(*frame[2:6])


def decode_general(frame: bytes, request: Request) -> General:
    """Decode the 4-byte reply to ``request``, by either checksum rule; raises FrameError.

    By the manual the checksum is that of the *sent command* plus the alarms; some heads sum address and alarms.
    """
    if len(frame) != GENERAL_BYTES or frame[0] != SYNC or frame[1] != request.address or frame[2] > 0x7F:
        raise FrameError(f"no general reply of address {request.address}: {frame.hex(' ')}")
    alarms = tuple(bit + 1 for bit in range(7) if frame[2] >> bit & 1)
    if frame[3] == (request.frame[6] + frame[2]) & 0xFF:
        return General(frame[1], alarms)
    if frame[3] == (frame[1] + frame[2]) & 0xFF:
        return General(frame[1], alarms, own_sum=True)
    raise FrameError(f"wrong checksum in the general reply {frame.hex(' ')} to {request.frame.hex(' ')}")


def decode_extended(frame: bytes, request: Request) -> Extended:
    """Decode the 7-byte answer to the query ``request``; raises FrameError, also for another head's or opcode's."""
    address, answer = decode(frame)
    if request.answer_op is None or (address, answer.word1, answer.word2) != (request.address, 0, request.answer_op):
        raise FrameError(f"{frame.hex(' ')} does not answer {request.frame.hex(' ')}")
    reply = Extended(address, request.answer_op, answer.data1, answer.data2)
    if request.answer_op in (Op.PAN, Op.TILT) and reply.value > FULL_TURN_RAW:
        raise FrameError(f"{frame.hex(' ')} reports {reply.value / 100:.2f} deg; an angle is at most 360")
    return reply


def decode_device(frame: bytes, request: Request) -> Device:
    """Decode the 18-byte reply to query 45; its checksum includes that of the sent command. Raises FrameError."""
    if len(frame) != DEVICE_BYTES or frame[0] != SYNC or frame[1] != request.address:
        raise FrameError(f"no device reply of address {request.address}: {frame.hex(' ')}")
    if (request.frame[6] + sum(frame[1:17])) & 0xFF != frame[17]:
        raise FrameError(f"wrong checksum in the device reply {frame.hex(' ')}")
    return Device(frame[1], frame[2:17])


def find_reply(
    received: bytes, request: Request, *, echo: Echo = Echo.AUTO, resync_tail: bool = False, final: bool = False
) -> Reply | None:
    """Return the reply to ``request`` among all bytes received since it was sent; None where it is not there (yet).

    Late and foreign replies and noise before it are skipped. ``final`` says that no more will come: only then are an
    own-sum general reply and, with ``resync_tail``, a reply without its first 1..3 bytes believed, each flagged.
    """
    heard = _without_echo(received, request.frame, echo, final=final)
    length = request.reply_bytes
    for start in range(len(heard) - length + 1):
        reply = _matching(heard[start : start + length], request)
        alone = final and len(heard) == length
        if reply is not None and (alone or not (isinstance(reply, General) and reply.own_sum)):
            return reply
    return _from_tail(heard, request) if final and resync_tail else None


def _without_echo(received: bytes, sent: bytes, echo: Echo, *, final: bool) -> bytes:
    """Drop exactly our own bytes; while they may still be arriving nothing else has been heard."""
    if echo is Echo.NO:
        return received
    if echo is Echo.YES:
        return received.partition(sent)[2]
    if received.startswith(sent):
        return received[len(sent) :]
    return b"" if sent.startswith(received) and not final else received


def _matching(frame: bytes, request: Request) -> Reply | None:
    with suppress(FrameError):
        match request.reply_bytes:
            case length if length == GENERAL_BYTES:
                return decode_general(frame, request)
            case length if length == DEVICE_BYTES:
                return decode_device(frame, request)
            case _:
                return decode_extended(frame, request)
    return None


def _from_tail(heard: bytes, request: Request) -> Extended | None:
    """Complete an extended reply whose first bytes an adapter swallowed while it still drove the line."""
    lost = EXTENDED_BYTES - len(heard)
    if request.answer_op is None or not 1 <= lost <= _LOST_AT_MOST:
        return None
    header = bytes((SYNC, request.address, 0))
    with suppress(FrameError):
        return replace(decode_extended(header[:lost] + heard, request), degraded=True)
    return None
