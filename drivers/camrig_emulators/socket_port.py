"""A port of an emulated device: one thread between a socket and the protocol, and the faults of the link."""

from __future__ import annotations

import contextlib
import os
import random
import selectors
import socket
import threading
from abc import ABC, abstractmethod
from typing import ClassVar, Generic, Protocol, TypeVar

from camrig.clock import Clock
from camrig.errors import InputError
from camrig_emulators.delayed import Address, Datagram, Delayed
from camrig_emulators.faults import Faults

_LONGEST_WAIT_S = 0.1


class DatagramDevice(Protocol):
    """What sits behind the port; called by the port's thread, under its lock."""

    def receive(self, now_s: float, address: Address, data: bytes) -> list[Datagram]:
        """Take one datagram; return what is said at once."""
        ...

    def poll(self, now_s: float) -> list[Datagram]:
        """Return what is due by now."""
        ...

    def next_due_s(self, now_s: float) -> float:
        """Return when ``poll`` should be called next; infinity for not before it is spoken to."""
        ...


DeviceT = TypeVar("DeviceT", bound=DatagramDevice)


class SocketPort(ABC, Generic[DeviceT]):
    """Serves one protocol on a port of 127.0.0.1 until ``close``; ``lock`` guards the protocol and what it moves.

    What a kind of socket does is in the abstract methods; all are called by the port's thread.
    """

    kind: ClassVar[str]

    def __init__(
        self,
        name: str,
        protocol: DeviceT,
        lock: threading.Lock,
        clock: Clock,
        faults: Faults,
        seed: int,
        port: int = 0,
    ) -> None:
        """``port`` 0 takes a free one. Raises InputError for one that is taken."""
        self._protocol = protocol
        self._lock = lock
        self._clock = clock
        self._faults = faults
        self._rng = random.Random(seed)
        self._late = Delayed()
        try:
            opened = self._opened(port)
        except OSError as error:
            told = f"{self.kind} port {port} of 127.0.0.1: {error.strerror}; give another one, or 0"
            raise InputError(told) from error
        self.port: int = opened.getsockname()[1]
        self._socket: socket.socket | None = opened
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        self._stopping = threading.Event()
        faults.watch(self._wake)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End what is open, stop the thread and release the port."""
        self._stopping.set()
        self._wake()
        self._thread.join()
        wake_write, self._wake_write = self._wake_write, -1
        os.close(wake_write)
        os.close(self._wake_read)

    @staticmethod
    @abstractmethod
    def _opened(port: int) -> socket.socket:
        """Return a socket on the port that does not block; raises OSError."""

    @abstractmethod
    def _turn(self, selector: selectors.BaseSelector) -> None:
        """Hear what came, and say what is due."""

    def _hang_up(self, selector: selectors.BaseSelector) -> None:
        """End whatever depends on the port being there; what was said and not delivered is lost."""
        self._late.clear()

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # a fault may be set after the end
            os.write(self._wake_write, b"!")

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake_read, selectors.EVENT_READ)
            if self._socket is not None:
                selector.register(self._socket, selectors.EVENT_READ)
            while not self._stopping.is_set():
                self._plug(selector)
                self._turn(selector)
                selector.select(self._wait_s())
                with contextlib.suppress(BlockingIOError):
                    os.read(self._wake_read, 1024)
            self._hang_up(selector)
        if self._socket is not None:
            self._socket.close()

    def _plug(self, selector: selectors.BaseSelector) -> None:
        """Open or close the port as the faults say."""
        if self._faults.plugged and self._socket is None:
            self._socket = self._opened(self.port)
            selector.register(self._socket, selectors.EVENT_READ)
        elif not self._faults.plugged and self._socket is not None:
            selector.unregister(self._socket)
            self._socket.close()
            self._socket = None
            self._hang_up(selector)

    def _hear(self, address: Address, data: bytes) -> None:
        with self._lock:
            out = self._protocol.receive(self._clock.now_s(), address, self._faults.spoil(data, self._rng))
        self._post(out)

    def _due(self) -> list[Datagram]:
        """Return what leaves now."""
        with self._lock:
            out = self._protocol.poll(self._clock.now_s())
        self._post(out)
        return self._late.due(self._clock.now_s())

    def _post(self, datagrams: list[Datagram]) -> None:
        self._late.post(datagrams, self._clock.now_s() + self._faults.latency_s)

    def _wait_s(self) -> float:
        now_s = self._clock.now_s()
        with self._lock:
            due_s = min(self._protocol.next_due_s(now_s), self._late.next_s())
        return max(0.0, min(_LONGEST_WAIT_S, due_s - now_s))
