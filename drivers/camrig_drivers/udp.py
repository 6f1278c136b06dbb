"""A non-blocking UDP socket with a time-out and a way to wake whoever waits for it."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import urlsplit

from camrig.errors import InputError

_DATAGRAM = 65536
_BATCH = 256
"""Datagrams taken in a row: a flood must not keep us from sending."""
Peer = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A parsed url."""

    listens: bool
    host: str
    port: int

    @classmethod
    def parse(cls, url: str) -> Endpoint:
        """Read ``udp://host:port`` or ``udpout://host:port``; raises InputError for anything else."""
        parts = urlsplit(url)
        try:
            port = parts.port
        except ValueError:
            port = None
        if parts.scheme not in {"udp", "udpout"} or not parts.hostname or not port or parts.path or parts.query:
            raise InputError(f"url '{url}' must be udp://host:port (listen there) or udpout://host:port (send there)")
        return cls(parts.scheme == "udp", parts.hostname, port)


class UdpSocket:
    """Opened when built; raises OSError. One thread uses it; ``wake`` is for the others."""

    def __init__(self, endpoint: Endpoint) -> None:
        address = socket.getaddrinfo(endpoint.host, endpoint.port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        with contextlib.ExitStack() as undo:
            self._socket = undo.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._socket.setblocking(False)
            # Connected, the kernel drops what others send, and a closed port is an error instead of silence.
            (self._socket.bind if endpoint.listens else self._socket.connect)(address)
            self._woken, self._waker = (undo.enter_context(end) for end in socket.socketpair())
            self._woken.setblocking(False)
            self._waker.setblocking(False)
            self._selector = undo.enter_context(selectors.DefaultSelector())
            for end in (self._socket, self._woken):
                self._selector.register(end, selectors.EVENT_READ)
            self._close = undo.pop_all().close
        self.remote: Peer | None = None if endpoint.listens else self._socket.getpeername()

    @property
    def fd(self) -> int:
        """The descriptor, for a guardian."""
        return self._socket.fileno()

    def wait(self, timeout_s: float) -> None:
        """Return when something has arrived, ``wake`` was called, or the time is over."""
        self._selector.select(max(0.0, timeout_s))
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(_DATAGRAM)

    def received(self) -> Iterator[tuple[Peer, bytes]]:
        """Yield (sender, datagram) for what has arrived."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(_BATCH):
                data, peer = self._socket.recvfrom(_DATAGRAM)
                yield peer, data

    def send(self, data: bytes, peer: Peer) -> None:
        """Send one datagram; a full buffer drops it, as the air does."""
        with contextlib.suppress(BlockingIOError):
            if self.remote is None:
                self._socket.sendto(data, peer)
            else:
                self._socket.send(data)

    def wake(self) -> None:
        """Make ``wait`` return; any thread, also after ``close``."""
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def close(self) -> None:
        self._close()
