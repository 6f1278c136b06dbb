"""Serves the operator's socket in a thread of its own; see operator_socket for the protocol."""

from __future__ import annotations

import json
import logging
import os
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from camrig.clock import Clock, RealClock
from camrig.errors import InputError
from camrig.runtime.operator import Answer, Operator
from camrig.runtime.operator_socket import MAX_LINE_BYTES

log = logging.getLogger(__name__)

MAX_CLIENTS = 16
"""One more, and the one that has been quiet longest must go: whoever holds connections keeps nobody from a stop."""
WATCH_S = 0.5
JOIN_S = 0.5
"""A command in hand takes one exchange with a device; the rig's coming to rest waits no longer for it."""
_SO_PEERGROUPS = 59  # socket(7) since Linux 4.13; Python has no name for it. The value of x86, ARM and RISC-V.
_MAX_GROUPS_BYTES = 1024


@dataclass(frozen=True, slots=True)
class Peer:
    """Who is at the other end of a connection, by the kernel's word when it was made."""

    pid: int
    uid: int
    groups: frozenset[int]

    def may_command(self, uid: int, gid: int) -> bool:
        """Tell whether this one may command a daemon of that user and group."""
        return self.uid in {0, uid} or gid in self.groups

    def __str__(self) -> str:
        return f"uid {self.uid} pid {self.pid}"


def peer_of(channel: socket.socket) -> Peer:
    """Return who is at the other end."""
    size = struct.calcsize("3i")
    pid, uid, gid = struct.unpack("3i", channel.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    try:
        raw = channel.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MAX_GROUPS_BYTES)
    except OSError:  # an old kernel, or a member of more groups than fit: then the first group alone counts
        raw = b""
    groups = struct.unpack(f"{len(raw) // 4}I", raw)
    return Peer(pid, uid, frozenset({gid, *groups}))


@contextmanager
def serving(listener: socket.socket, operator: Operator, on_failure: Callable[[], None]) -> Iterator[None]:
    """Answer on a bound socket while inside; a failure that is a bug calls ``on_failure`` and is raised at the end."""
    server = OperatorServer(listener, operator, on_failure)
    server.start()
    try:
        yield
    finally:
        server.close()
    if server.failed is not None:
        raise server.failed


@dataclass(eq=False)
class _Client:
    channel: socket.socket
    sender: str
    used_s: float
    received: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    closing: bool = False
    """Nothing more is read; the connection ends when what is unsent is sent."""

    @property
    def interest(self) -> int:
        """What to wait for. A client gets one answer a turn and is read again when it has taken them all."""
        if self.unsent or self.closing or b"\n" in self.received:
            return selectors.EVENT_WRITE
        return selectors.EVENT_READ

    def next_line(self) -> bytes | None:
        """Take the oldest complete line; raises InputError where it is too long."""
        end = self.received.find(b"\n")
        if end > MAX_LINE_BYTES or (end < 0 and len(self.received) > MAX_LINE_BYTES):
            raise InputError(f"a request is one line of at most {MAX_LINE_BYTES} bytes")
        if end < 0:
            return None
        line = bytes(self.received[:end])
        del self.received[: end + 1]
        return line


class OperatorServer:
    """One thread, one selector; a slow or hostile client delays nobody."""

    def __init__(
        self, listener: socket.socket, operator: Operator, on_failure: Callable[[], None], clock: Clock | None = None
    ) -> None:
        """Take a bound socket over; ``close`` closes it."""
        self.failed: BaseException | None = None
        self._listener = listener
        self._operator = operator
        self._on_failure = on_failure
        self._clock = clock or RealClock()
        self._selector = selectors.DefaultSelector()
        self._waker, self._wake = socket.socketpair()
        self._stopping = threading.Event()
        self._clients: list[_Client] = []
        self._thread = threading.Thread(target=self._run, name="operator", daemon=True)

    def start(self) -> None:
        """Begin to answer."""
        self._listener.setblocking(False)
        self._listener.listen(MAX_CLIENTS)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._thread.start()
        log.info("operator: answering at %s", self._listener.getsockname())

    def close(self) -> None:
        """Finish the request in hand, end every connection and stop listening."""
        self._stopping.set()
        self._waker.send(b"\0")
        self._thread.join(JOIN_S)
        if self._thread.is_alive():  # it ends with the process; the rig must come to rest now
            log.error("operator: did not end within %.1f s", JOIN_S)
            return
        for closable in (self._selector, self._listener, self._waker, self._wake):
            closable.close()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
        except BaseException as error:  # whatever it is, the rig must come to rest and exit
            log.exception("operator: unexpected failure")
            self.failed = error
            self._on_failure()
        finally:
            for client in self._clients:
                client.channel.close()

    def _turn(self) -> None:
        self._operator.watch()
        for key, events in self._selector.select(WATCH_S):
            if key.fileobj is self._listener:
                self._accept()
            elif isinstance(key.data, _Client) and key.data in self._clients:
                self._attend(key.data, events)

    def _accept(self) -> None:
        try:
            channel, _ = self._listener.accept()
        except (BlockingIOError, ConnectionError):
            return  # it has gone again
        channel.setblocking(False)
        peer = peer_of(channel)
        client = _Client(channel, str(peer), self._clock.now_s())
        if len(self._clients) >= MAX_CLIENTS:
            self._drop(min(self._clients, key=lambda other: other.used_s))
        self._clients.append(client)
        self._selector.register(channel, client.interest, client)
        if not peer.may_command(os.geteuid(), os.getegid()):
            self._refuse(client, f"user {peer.uid} may not command this rig: be its user, or a member of its group")
            self._flush(client)

    def _attend(self, client: _Client, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._receive(client)
            if not client.unsent:
                self._answer_one(client)
        except InputError as error:
            self._refuse(client, str(error))
        except OSError:
            self._drop(client)
            return
        self._flush(client)

    def _receive(self, client: _Client) -> None:
        data = client.channel.recv(MAX_LINE_BYTES)
        client.received += data
        client.used_s = self._clock.now_s()
        client.closing = not data

    def _answer_one(self, client: _Client) -> None:
        line = client.next_line()
        if line is not None:
            client.unsent += _line(self._operator.handle(_decoded(line), client.sender))

    def _refuse(self, client: _Client, reason: str) -> None:
        log.warning("operator: %s: refused: %s", client.sender, reason)
        client.unsent += _line({"ok": False, "error": reason, "exit_code": InputError.exit_code})
        client.received.clear()
        client.closing = True

    def _flush(self, client: _Client) -> None:
        try:
            if client.unsent:
                del client.unsent[: client.channel.send(client.unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        if client.closing and not client.unsent and b"\n" not in client.received:
            self._drop(client)
            return
        self._selector.modify(client.channel, client.interest, client)

    def _drop(self, client: _Client) -> None:
        self._selector.unregister(client.channel)
        self._clients.remove(client)
        client.channel.close()


def _line(answer: Answer) -> bytes:
    return json.dumps(answer, allow_nan=False).encode() + b"\n"


def _decoded(line: bytes) -> Mapping[str, object]:
    try:
        request: object = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError("a request is one line of JSON") from error
    if not isinstance(request, dict):
        raise InputError('a request is a JSON object, such as {"command": "status"}')
    return request
