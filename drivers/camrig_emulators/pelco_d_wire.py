"""Pelco-D as the head sees it: frames out of bytes, answers into bytes. Written from the protocol text alone.

A command is ``FF address command1 command2 data1 data2 sum``, the sum modulo 256 of the five bytes before it. The
byte FF may stand in its data, so only a correct sum tells where a frame begins. No head has the address FF: a second
FF in a row is a new beginning, or else noise before a stop for address 1 would make it one for address FF.
"""

from __future__ import annotations

from dataclasses import dataclass

SYNC = 0xFF
FRAME_LENGTH = 7

LEFT, RIGHT, UP, DOWN, TELE, WIDE = 0x04, 0x02, 0x08, 0x10, 0x20, 0x40
"""Bits of command2 in a standard command."""

SENSE, CAMERA = 0x80, 0x08
"""Bits of command1: the camera goes on with both, off with the second alone."""


@dataclass(frozen=True, slots=True)
class Command:
    """A frame with a correct sum, and when its first bit began and its last ended."""

    raw: bytes
    start_s: float
    end_s: float

    @property
    def address(self) -> int:
        return self.raw[1]

    @property
    def opcode(self) -> int | None:
        """The opcode of an extended command, None of a standard one: bit 0 of command2 tells."""
        return self.raw[3] if self.raw[3] & 1 else None

    @property
    def bits(self) -> int:
        """Directions of a standard command."""
        return self.raw[3]

    @property
    def switches(self) -> int:
        """The first command byte."""
        return self.raw[2]

    @property
    def data(self) -> tuple[int, int]:
        return self.raw[4], self.raw[5]

    @property
    def value(self) -> int:
        """Both data bytes as one number, most significant first."""
        return self.raw[4] << 8 | self.raw[5]

    @property
    def checksum(self) -> int:
        return self.raw[6]


class CommandParser:
    """Finds commands in bytes; after garbage it looks for the next place where a sum is correct."""

    def __init__(self, byte_timeout_s: float = 0.05) -> None:
        """Forget half a command when the next byte begins ``byte_timeout_s`` or more after the last one ended."""
        self._byte_timeout_s = byte_timeout_s
        self._bytes = bytearray()
        self._starts_s: list[float] = []
        self._last_end_s = 0.0

    @property
    def missing(self) -> int:
        """How many bytes the next command still needs, at least 1."""
        return FRAME_LENGTH - len(self._bytes)

    def feed(self, byte: int, start_s: float, end_s: float) -> Command | None:
        """Take one byte that was on the wire from ``start_s`` to ``end_s``; return the command it completes."""
        if start_s - self._last_end_s >= self._byte_timeout_s:
            self.clear()
        self._last_end_s = end_s
        self._bytes.append(byte)
        self._starts_s.append(start_s)
        self._drop_to_sync()
        while len(self._bytes) >= FRAME_LENGTH:
            if checksum(self._bytes[1:6]) == self._bytes[6]:
                command = Command(bytes(self._bytes), self._starts_s[0], end_s)
                self.clear()
                return command
            self._drop(1)
            self._drop_to_sync()
        return None

    def clear(self) -> None:
        """Forget half a command."""
        self._drop(len(self._bytes))

    def _drop_to_sync(self) -> None:
        garbage = self._bytes.find(SYNC)
        self._drop(len(self._bytes) if garbage < 0 else garbage)
        while self._bytes[1:2] == bytes((SYNC,)):
            self._drop(1)

    def _drop(self, count: int) -> None:
        del self._bytes[:count]
        del self._starts_s[:count]


def checksum(body: bytes | bytearray) -> int:
    """Return the sum modulo 256."""
    return sum(body) & 0xFF


def general_reply(address: int, command_checksum: int, alarms: int = 0, *, own_sum: bool = False) -> bytes:
    """Return the 4-byte answer; its sum is that of the command plus the alarms, the address not added again.

    ``own_sum``: the sum of its own two bytes instead, as some heads do.
    """
    return bytes((SYNC, address, alarms, ((address if own_sum else command_checksum) + alarms) & 0xFF))


def extended_reply(address: int, opcode: int, value: int) -> bytes:
    """Return the 7-byte answer that carries a 16-bit value."""
    body = bytes((address, 0x00, opcode, value >> 8 & 0xFF, value & 0xFF))
    return bytes((SYNC, *body, checksum(body)))


def query_reply(address: int, command_checksum: int, part_number: bytes) -> bytes:
    """Return the 18-byte answer to opcode 45; ``part_number`` is cut or filled with zeros to 15 bytes."""
    body = bytes((address, *part_number[:15].ljust(15, b"\0")))
    return bytes((SYNC, *body, (command_checksum + checksum(body)) & 0xFF))
