"""VISCA's messages, without I/O: commands and inquiries into bytes, bytes into replies. Sony's header for UDP.

A message is ``8x … FF`` to camera x (1..7), its replies are ``y0 … FF`` with y = x + 8. FF is only ever the end, so a
reader that is lost finds the next message after the next FF. Nothing carries a checksum on a serial line. Sources:
docs/visca.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

END = 0xFF
LONGEST_MESSAGE = 16
SOCKETS = (1, 2)
"""A camera executes at most two commands at once, each in a socket of its own."""

INQUIRE_PAN_TILT = bytes.fromhex("09 06 12")
INQUIRE_ZOOM = bytes.fromhex("09 04 47")


class Error(IntEnum):
    """Why a camera refuses."""

    LENGTH = 0x01
    SYNTAX = 0x02
    BUFFER_FULL = 0x03
    CANCELLED = 0x04
    NO_SOCKET = 0x05
    NOT_EXECUTABLE = 0x41


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """A command was taken; it holds a socket until it is completed, cancelled or refused."""

    address: int
    socket: int


@dataclass(frozen=True, slots=True)
class Completed:
    """A command has been executed, or, with ``content`` and mostly socket 0, an inquiry is answered."""

    address: int
    socket: int
    content: bytes = b""


@dataclass(frozen=True, slots=True)
class Refused:
    """A command or an inquiry is not obeyed; ``code`` is one of ``Error``, or the camera's own."""

    address: int
    socket: int
    code: int

    def __str__(self) -> str:
        try:
            return Error(self.code).name.lower().replace("_", " ")
        except ValueError:
            return f"error {self.code:02X}"


Reply = Acknowledged | Completed | Refused


@dataclass(frozen=True, slots=True)
class Digits:
    """How positions are spread over bytes: hexadecimal digits of pan and tilt, in two's complement or unsigned."""

    pan: int = 4
    tilt: int = 4
    signed: bool = True

    def range(self, digits: int) -> tuple[int, int]:
        """Return the lowest and the highest count of that many digits."""
        whole = 1 << 4 * digits
        return (-whole // 2, whole // 2 - 1) if self.signed else (0, whole - 1)


def message(address: int, body: bytes) -> bytes:
    """Address a command or an inquiry."""
    return bytes((0x80 | address, *body, END))


def absolute(pan: int, tilt: int, speeds: tuple[int, int], digits: Digits) -> bytes:
    """Go to a position in counts; the speeds are 1..24 of pan and 1..20 (some 24) of tilt."""
    return bytes((0x01, 0x06, 0x02, *speeds)) + spread(pan, digits.pan) + spread(tilt, digits.tilt)


def stop(speeds: tuple[int, int]) -> bytes:
    """End pan and tilt: a drive into neither direction."""
    return bytes((0x01, 0x06, 0x01, *speeds, 0x03, 0x03))


def cancel(socket: int) -> bytes:
    """End the command that holds a socket."""
    return bytes((0x20 | socket,))


def zoom_to(position: int) -> bytes:
    """Set the zoom, 0..4000h optical, above digital where the camera has it."""
    return b"\x01\x04\x47" + spread(position, 4)


def spread(value: int, digits: int) -> bytes:
    """Return the lowest ``digits`` hexadecimal digits of a number, a byte each, the highest first."""
    return bytes(value >> 4 * place & 0x0F for place in reversed(range(digits)))


def gathered(content: bytes, *, signed: bool) -> int | None:
    """Return the number that is spread over bytes; None where one of them is no digit."""
    if not content or any(byte > 0x0F for byte in content):
        return None
    value = 0
    for byte in content:
        value = value << 4 | byte
    whole = 1 << 4 * len(content)
    return value - whole if signed and value >= whole // 2 else value


def pan_tilt(content: bytes, digits: Digits) -> tuple[int, int] | None:
    """Return both counts of a position reply; None where it is none."""
    if len(content) != digits.pan + digits.tilt:
        return None
    pan = gathered(content[: digits.pan], signed=digits.signed)
    tilt = gathered(content[digits.pan :], signed=digits.signed)
    return None if pan is None or tilt is None else (pan, tilt)


def parse(raw: bytes) -> Reply | None:
    """Read one whole message, its FF included; None where it is no reply (an echo, noise, another's news)."""
    if not 3 <= len(raw) <= LONGEST_MESSAGE or raw[-1] != END or END in raw[:-1]:
        return None
    address, low = (raw[0] >> 4) - 8, raw[0] & 0x0F
    if low or not 1 <= address <= 7:
        return None
    kind, socket, content = raw[1] >> 4, raw[1] & 0x0F, raw[2:-1]
    if kind == 4 and not content:
        return Acknowledged(address, socket)
    if kind == 5:
        return Completed(address, socket, content)
    if kind == 6 and len(content) == 1:
        return Refused(address, socket, content[0])
    return None


class Splitter:
    """Cuts a stream of bytes into messages; what is longer than any message is noise and is dropped."""

    def __init__(self) -> None:
        self._kept = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that these bytes end, each with its FF."""
        found = []
        for byte in data:
            self._kept.append(byte)
            if byte == END:
                found.append(bytes(self._kept))
                self._kept.clear()
            elif len(self._kept) > LONGEST_MESSAGE:
                del self._kept[0]
        return [each for each in found if len(each) <= LONGEST_MESSAGE]


class Kind(IntEnum):
    """The type in Sony's header."""

    COMMAND = 0x0100
    INQUIRY = 0x0110
    REPLY = 0x0111
    CONTROL = 0x0200
    CONTROL_REPLY = 0x0201


RESET_SEQUENCE = b"\x01"
WRONG_SEQUENCE = b"\x0f\x01"
SEQUENCES = 1 << 32


def datagram(kind: Kind, sequence: int, payload: bytes) -> bytes:
    """Put Sony's 8-byte header before a message: type, length, sequence number."""
    return kind.to_bytes(2) + len(payload).to_bytes(2) + (sequence % SEQUENCES).to_bytes(4) + payload


def undatagram(data: bytes) -> tuple[Kind, int, bytes] | None:
    """Return type, sequence number and message of a datagram; None where it is none of these."""
    payload = data[8:]
    if not payload or int.from_bytes(data[2:4]) != len(payload):
        return None
    try:
        return Kind(int.from_bytes(data[:2])), int.from_bytes(data[4:8]), payload
    except ValueError:
        return None
