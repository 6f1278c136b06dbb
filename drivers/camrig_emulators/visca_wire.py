"""VISCA as the head sees it: messages out of bytes, answers into bytes. Written from the protocol text alone.

A message is ``8x … FF`` to head x (88: to all), at most 16 bytes; FF stands nowhere but at its end. An answer begins
with ``y0``, y being x + 8. Numbers are spread over bytes, four bits each. On UDP with Sony's header eight bytes go
before: type (2), length (2), sequence number (4).
"""

from __future__ import annotations

from dataclasses import dataclass

END = 0xFF
LONGEST = 16
BROADCAST = 8

COMMAND, INQUIRY, REPLY, CONTROL, CONTROL_REPLY = 0x0100, 0x0110, 0x0111, 0x0200, 0x0201
"""Types of Sony's header."""

WRONG_LENGTH, WRONG_SYNTAX, BUFFER_FULL, CANCELLED, NO_SOCKET, NOT_EXECUTABLE = 0x01, 0x02, 0x03, 0x04, 0x05, 0x41
"""What an error reply says."""


@dataclass(frozen=True, slots=True)
class Message:
    """What came for a head, and when its first bit began and its last ended."""

    raw: bytes
    start_s: float
    end_s: float

    @property
    def address(self) -> int:
        return self.raw[0] & 0x0F

    @property
    def body(self) -> bytes:
        """What stands between the address and the end."""
        return self.raw[1:-1]


class MessageParser:
    """Finds messages in bytes: whatever ends with FF and begins with an address."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._start_s = 0.0

    def feed(self, byte: int, start_s: float, end_s: float) -> Message | None:
        """Take one byte that was on the wire from ``start_s`` to ``end_s``; return the message it ends."""
        if byte & 0x80 and byte != END:  # only an address and the end have their highest bit set
            self._bytes.clear()
        if not self._bytes:
            self._start_s = start_s
        self._bytes.append(byte)
        if byte != END:
            return None
        raw = bytes(self._bytes)
        self._bytes.clear()
        return Message(raw, self._start_s, end_s) if len(raw) > 2 and 0x81 <= raw[0] <= 0x88 else None

    def clear(self) -> None:
        """Forget half a message."""
        self._bytes.clear()


def spread(value: int, digits: int) -> bytes:
    """Return the lowest ``digits`` hexadecimal digits of a number, two's complement, a byte each."""
    return bytes(value >> 4 * k & 0x0F for k in reversed(range(digits)))


def gathered(data: bytes) -> int | None:
    """Return the signed number that is spread over the bytes; None where a byte holds more than four bits."""
    value = 0
    for byte in data:
        if byte > 0x0F:
            return None
        value = value << 4 | byte
    half = 1 << 4 * len(data) - 1
    return value - 2 * half if value >= half else value


def acknowledge(address: int, socket: int) -> bytes:
    """Say that a command has been taken and holds a socket."""
    return bytes((address + 8 << 4, 0x40 | socket, END))


def completion(address: int, socket: int, content: bytes = b"") -> bytes:
    """Say that a command is done, or with ``content`` answer an inquiry (socket 0)."""
    return bytes((address + 8 << 4, 0x50 | socket, *content, END))


def error(address: int, socket: int, code: int) -> bytes:
    """Say why something is not done."""
    return bytes((address + 8 << 4, 0x60 | socket, code, END))


def with_header(kind: int, sequence: int, payload: bytes) -> bytes:
    """Return a datagram with Sony's header."""
    return kind.to_bytes(2) + len(payload).to_bytes(2) + sequence.to_bytes(4) + payload


def header(data: bytes) -> tuple[int, int, bytes] | None:
    """Return type, sequence number and payload of a datagram; None where its header does not fit it."""
    payload = data[8:]
    if len(data) < 9 or int.from_bytes(data[2:4]) != len(payload):
        return None
    return int.from_bytes(data[:2]), int.from_bytes(data[4:8]), payload
