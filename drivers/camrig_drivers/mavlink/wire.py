"""What carries MAVLink: a UDP port, a TCP connection or a serial line, told apart by its url.

``udp://host:port`` listens there and answers to where each vehicle sends from; ``udpout://host:port`` sends first;
``tcp://host:port`` connects there; ``serial:///dev/…:baud`` opens a line.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import selectors
import socket
import struct
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from camrig.errors import InputError, LinkLost
from camrig_drivers.serial_port import Port
from camrig_drivers.udp import Endpoint, Peer, UdpSocket

_CONNECT_S = 2.0
_PIECE = 4096
_PIECES = 64
"""Taken in a row: a flood must not keep us from sending."""
_KERNEL_BYTES = 16_384
_WAITING_S = 0.1
_WAITING_BYTES = 1024
"""More is not put behind what waits to be sent already: a set-point that is sent late must not be sent at all."""
_UNTAKEN_MS = 3000
_UNTAKEN_S = _UNTAKEN_MS / 1e3
_PASSING = {
    errno.ECONNREFUSED,
    errno.ECONNRESET,
    errno.EHOSTDOWN,
    errno.EHOSTUNREACH,
    errno.ENETDOWN,
    errno.ENETUNREACH,
    errno.ENOBUFS,
    errno.EPERM,
}
"""A network, a neighbour or a firewall in trouble; the socket itself is sound."""


class Wire(Protocol):
    """Opened when built; raises OSError or LinkLost, as do all methods but ``wake`` and ``close``.

    One thread uses it; ``wake`` is for the others. ``remote`` is the only peer there can be, or None.
    """

    remote: Peer | None

    def wait(self, timeout_s: float) -> None:
        """Return when something has arrived, ``wake`` was called, or the time is over."""
        ...

    def received(self) -> Iterator[tuple[Peer, bytes]]:
        """Yield (sender, bytes) for what has arrived."""
        ...

    def send(self, data: bytes, peer: Peer) -> None:
        """Send one frame; where the wire takes none now, it is lost, as in the air."""
        ...

    def wake(self) -> None:
        """Make ``wait`` return; any thread, also after ``close``."""
        ...

    def close(self) -> None:
        """Release the wire; twice is allowed."""
        ...


@dataclass(frozen=True, slots=True)
class WireUrl:
    """A parsed url; ``port`` is the baud rate of a serial line."""

    scheme: str
    place: str
    port: int

    @classmethod
    def parse(cls, url: str) -> WireUrl:
        """Read a url; raises InputError for what is none of ours."""
        scheme, found, rest = url.partition("://")
        place, _, port = rest.rpartition(":")
        if scheme == "serial" and place.startswith("/") and port.isascii() and port.isdigit() and int(port) > 0:
            return cls(scheme, place, int(port))
        if found and scheme in {"udp", "udpout", "tcp"}:
            with contextlib.suppress(InputError):
                end = Endpoint.parse(f"udpout://{rest}")
                return cls(scheme, end.host, end.port)
        raise InputError(
            f"url '{url}' must be udp://host:port (listen there), udpout://host:port (send there), tcp://host:port "
            "(connect there) or serial:///dev/...:baud"
        )

    def open(self) -> Wire:
        """Open what the url names; raises OSError or LinkLost."""
        match self.scheme:
            case "tcp":
                return TcpWire(self.place, self.port)
            case "serial":
                return SerialWire(self.place, self.port)
        return UdpWire(Endpoint(self.scheme == "udp", self.place, self.port))


class UdpWire(UdpSocket):
    """A UDP port, which may serve many drones: once somebody was heard, what passes by itself closes it for nobody.

    A network that is down for a moment, or a router that restarts, is silence; of that every drone judges by itself.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._used = False

    def received(self) -> Iterator[tuple[Peer, bytes]]:
        with self._passing():
            for peer, data in super().received():
                self._used = True
                yield peer, data

    def send(self, data: bytes, peer: Peer) -> None:
        with self._passing():
            super().send(data, peer)

    @contextlib.contextmanager
    def _passing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if not self._used or error.errno not in _PASSING:
                raise


class _Doorbell:
    """Waits for one descriptor or for ``ring``."""

    def __init__(self, fd: int) -> None:
        self._woken, self._waker = socket.socketpair()
        for end in (self._woken, self._waker):
            end.setblocking(False)
        self._selector = selectors.DefaultSelector()
        for ready in (fd, self._woken.fileno()):
            self._selector.register(ready, selectors.EVENT_READ)

    def wait(self, timeout_s: float) -> None:
        self._selector.select(max(0.0, timeout_s))
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(_PIECE)

    def ring(self) -> None:
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def close(self) -> None:
        self._selector.close()
        self._woken.close()
        self._waker.close()


def _waiting(fd: int) -> int:
    """Return how many bytes the kernel has still to send (tty_ioctl(4) TIOCOUTQ, tcp(7) SIOCOUTQ: one number)."""
    return int(struct.unpack("i", fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)))[0])


class TcpWire:
    """A connection to an autopilot or a router; its end is an OSError."""

    def __init__(self, host: str, port: int) -> None:
        self.remote: Peer | None = (host, port)
        self._peer = (host, port)
        self._socket = socket.create_connection((host, port), _CONNECT_S)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNTAKEN_MS)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
        self._bell = _Doorbell(self._socket.fileno())
        self._rest = b""

    def wait(self, timeout_s: float) -> None:
        self._bell.wait(timeout_s)

    def received(self) -> Iterator[tuple[Peer, bytes]]:
        with contextlib.suppress(BlockingIOError):
            for _ in range(_PIECES):
                data = self._socket.recv(_PIECE)
                if not data:
                    raise ConnectionResetError(errno.ECONNRESET, "the other end has closed the connection")
                yield self._peer, data

    def send(self, data: bytes, peer: Peer) -> None:
        del peer
        with contextlib.suppress(BlockingIOError):
            while self._rest:  # what was begun must be ended, or the frames after it are lost
                self._rest = self._rest[self._socket.send(self._rest) :]
            if _waiting(self._socket.fileno()) < _WAITING_BYTES:
                self._rest = data[self._socket.send(data) :]

    def wake(self) -> None:
        self._bell.ring()

    def close(self) -> None:
        self._bell.close()
        self._socket.close()


class SerialWire:
    """A serial line: a telemetry radio, or a cable."""

    def __init__(self, path: str, baud: int) -> None:
        self.remote: Peer | None = (path, baud)
        self._peer = (path, baud)
        self._port = Port(path, baud)
        self._bell = _Doorbell(self._port.fd)
        self._waiting_bytes = max(_WAITING_BYTES, round(_WAITING_S * baud / 10))
        self._rest = b""
        self._taken_s = time.monotonic()

    def wait(self, timeout_s: float) -> None:
        self._bell.wait(timeout_s)

    def received(self) -> Iterator[tuple[Peer, bytes]]:
        for _ in range(_PIECES):
            data = self._port.read(_PIECE, 0.0)
            if not data:
                return
            yield self._peer, data

    def send(self, data: bytes, peer: Peer) -> None:
        """Never blocks: while it did, all set-points of the line would wait, and then go out late."""
        del peer
        if self._rest:
            self._write(self._rest)
        if not self._rest and _waiting(self._port.fd) < self._waiting_bytes:
            self._write(data)
        elif time.monotonic() - self._taken_s > _UNTAKEN_S:
            raise LinkLost(
                f"serial port {self._peer[0]} has taken nothing for {_UNTAKEN_S:g} s: check its flow control"
            )

    def _write(self, data: bytes) -> None:
        taken = self._port.write_some(data)
        self._rest = data[taken:]
        if taken:
            self._taken_s = time.monotonic()

    def wake(self) -> None:
        self._bell.ring()

    def close(self) -> None:
        self._bell.close()
        self._port.close()
