"""What carries VISCA's messages: a serial line, or UDP with Sony's header or without. Every trouble is a LinkLost."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from camrig.clock import Clock
from camrig.errors import LinkLost
from camrig_drivers.serial_port import Port
from camrig_drivers.udp import Endpoint, UdpSocket
from camrig_drivers.visca.codec import (
    INQUIRE_PAN_TILT,
    RESET_SEQUENCE,
    WRONG_SEQUENCE,
    Kind,
    Reply,
    Splitter,
    datagram,
    parse,
    undatagram,
)

_BITS_A_BYTE = 10
"""8N1: a start bit, eight data bits, a stop bit."""
_GUARD_AHEAD = 1 << 30
"""How far a guardian's number is ahead of ours: newer than any we shall send, however a camera compares them."""
_ADVICE = "check the camera's power, its address and that VISCA over IP is switched on"


@dataclass(frozen=True, slots=True)
class Sent:
    """When a message's last bit has left, and its number where it has one."""

    end_s: float
    sequence: int | None = None


@dataclass(frozen=True, slots=True)
class Heard:
    """A reply, when its first bit began and its last one came, and the number of what it answers, where it has one."""

    reply: Reply
    start_s: float
    end_s: float
    sequence: int | None = None


class Transport(Protocol):
    """One open port. ``wake`` is for any thread, all else for whoever has the turn."""

    @property
    def name(self) -> str:
        """The port, for sentences."""
        ...

    @property
    def fd(self) -> int:
        """The descriptor, for a guardian; raises LinkLost once closed."""
        ...

    def send(self, message: bytes) -> Sent:
        """Hand over a message."""
        ...

    def receive(self, timeout_s: float) -> list[Heard]:
        """Block until a message has come, ``timeout_s`` has passed or ``wake``; return the replies among what came."""
        ...

    def guard_bytes(self, stop: bytes, cancels: Sequence[bytes]) -> bytes:
        """Return what a guardian writes, in one write, to stop a head."""
        ...

    def wake(self) -> None:
        """Make a blocked ``receive``, or else the next one, return."""
        ...

    def close(self) -> None:
        """Release the port; twice is allowed."""
        ...


class SerialTransport:
    """A serial port at 8N1. Stamps reckon with the time that bytes take."""

    def __init__(self, path: str, baud: int, clock: Clock) -> None:
        self._port = Port(path, baud)
        self._byte_s = _BITS_A_BYTE / baud
        self._clock = clock
        self._splitter = Splitter()
        self._closing = threading.Lock()
        """A port that is being closed must not be woken."""

    @property
    def name(self) -> str:
        return self._port.path

    @property
    def fd(self) -> int:
        return self._port.fd

    def send(self, message: bytes) -> Sent:
        end_s = self._clock.now_s() + len(message) * self._byte_s
        self._port.write(message)
        return Sent(end_s)

    def receive(self, timeout_s: float) -> list[Heard]:
        deadline_s = self._clock.now_s() + timeout_s
        while byte := self._port.read(1, max(0.0, deadline_s - self._clock.now_s())):
            if found := self._splitter.feed(byte):
                end_s = self._clock.now_s()
                return [
                    Heard(reply, end_s - len(raw) * self._byte_s, end_s)
                    for raw in found
                    if (reply := parse(raw)) is not None
                ]
        return []

    def guard_bytes(self, stop: bytes, cancels: Sequence[bytes]) -> bytes:
        # A message cut off in its middle spoils the one after it, and a camera busy with two commands takes no third.
        return b"".join((stop, *cancels, stop))

    def wake(self) -> None:
        with self._closing:
            if self._port.is_open:
                self._port.wake()

    def close(self) -> None:
        with self._closing:
            self._port.close()


class UdpTransport:
    """A UDP port, a message a datagram; with Sony's header messages are numbered, and so are the replies to them."""

    def __init__(self, url: str, host: str, port: int, *, header: bool, clock: Clock) -> None:
        self.name = url
        self._clock = clock
        self._header = header
        self._sequence = 0
        self._reset_due = True
        """The camera may still know numbers of a controller before us."""
        self._closed = False
        with self._link("opening"):
            self._socket = UdpSocket(Endpoint(listens=False, host=host, port=port))

    @property
    def fd(self) -> int:
        if self._closed:
            raise LinkLost(f"{self.name} is closed")
        return self._socket.fd

    def send(self, message: bytes) -> Sent:
        if not self._header:
            self._put(message)
            return Sent(self._clock.now_s())
        if self._reset_due:
            self._put(datagram(Kind.CONTROL, 0, RESET_SEQUENCE))
            self._sequence, self._reset_due = 0, False
        self._sequence += 1
        kind = Kind.INQUIRY if message[1] == INQUIRE_PAN_TILT[0] else Kind.COMMAND
        self._put(datagram(kind, self._sequence, message))
        return Sent(self._clock.now_s(), self._sequence)

    def receive(self, timeout_s: float) -> list[Heard]:
        with self._link("reading"):
            self._socket.wait(timeout_s)
            now_s = self._clock.now_s()
            return [heard for _, data in self._socket.received() for heard in self._read(data, now_s)]

    def guard_bytes(self, stop: bytes, cancels: Sequence[bytes]) -> bytes:
        del cancels  # one write is one datagram, and holds one message
        return datagram(Kind.COMMAND, self._sequence + _GUARD_AHEAD, stop) if self._header else stop

    def wake(self) -> None:
        self._socket.wake()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._socket.close()

    def _put(self, data: bytes) -> None:
        if self._closed:
            raise LinkLost(f"{self.name} is closed")
        with self._link("writing"):
            self._socket.send(data, ("", 0))

    def _read(self, data: bytes, now_s: float) -> list[Heard]:
        sequence = None
        if self._header:
            found = undatagram(data)
            if found is None:
                return []
            kind, sequence, data = found
            if kind is Kind.CONTROL_REPLY and data == WRONG_SEQUENCE:
                self._reset_due = True
            if kind is not Kind.REPLY:
                return []
        replies = (parse(raw) for raw in Splitter().feed(data))
        return [Heard(reply, now_s, now_s, sequence) for reply in replies if reply is not None]

    @contextmanager
    def _link(self, doing: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LinkLost(f"{self.name} was lost while {doing}: {error.strerror or error}; {_ADVICE}") from error
