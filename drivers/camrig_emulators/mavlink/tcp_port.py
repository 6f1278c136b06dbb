"""The TCP port of the emulated drone: one thread between its connections and the protocol, and the link's faults."""

from __future__ import annotations

import contextlib
import os
import random
import selectors
import socket
import threading
from typing import Protocol

from camrig.clock import Clock
from camrig.errors import InputError
from camrig_emulators.delayed import Address, Datagram, Delayed
from camrig_emulators.faults import Faults
from camrig_emulators.udp_port import DatagramDevice

_READ_BYTES = 4096
_LONGEST_WAIT_S = 0.1


class StreamDevice(DatagramDevice, Protocol):
    """What sits behind the port; called by the port's thread, under its lock."""

    @property
    def boots(self) -> int:
        """How often it has started; connections do not outlive a boot."""
        ...

    def attach(self, now_s: float, address: Address) -> None:
        """Talk to this address until ``detach``."""
        ...

    def detach(self, address: Address) -> None:
        """Forget an address."""
        ...


class TcpPort:
    """Serves one protocol on a TCP port of 127.0.0.1 until ``close``; ``lock`` guards the protocol."""

    def __init__(
        self,
        name: str,
        protocol: StreamDevice,
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
        self._clients: dict[Address, socket.socket] = {}
        self._boots = protocol.boots
        try:
            listener = _listening(port)
        except OSError as error:
            raise InputError(f"TCP port {port} of 127.0.0.1: {error.strerror}; give another one, or 0") from error
        self.port: int = listener.getsockname()[1]
        self._listener: socket.socket | None = listener
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        self._stopping = threading.Event()
        faults.watch(self._wake)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End every connection, stop the thread and release the port."""
        self._stopping.set()
        self._wake()
        self._thread.join()
        wake_write, self._wake_write = self._wake_write, -1
        os.close(wake_write)
        os.close(self._wake_read)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # a fault may be set after the end
            os.write(self._wake_write, b"!")

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake_read, selectors.EVENT_READ)
            if self._listener is not None:
                selector.register(self._listener, selectors.EVENT_READ)
            while not self._stopping.is_set():
                self._plug(selector)
                self._accept(selector)
                for address in tuple(self._clients):
                    self._listen(selector, address)
                self._speak(selector)
                selector.select(self._wait_s())
                with contextlib.suppress(BlockingIOError):
                    os.read(self._wake_read, 1024)
            self._hang_up(selector)
        if self._listener is not None:
            self._listener.close()

    def _plug(self, selector: selectors.BaseSelector) -> None:
        """Open or close the port; a reboot ends every connection."""
        with self._lock:
            boots = self._protocol.boots
        if boots != self._boots:
            self._boots = boots
            self._speak(selector)  # the acknowledgement of the reboot is still delivered
            self._hang_up(selector)
        if self._faults.plugged and self._listener is None:
            self._listener = _listening(self.port)
            selector.register(self._listener, selectors.EVENT_READ)
        elif not self._faults.plugged and self._listener is not None:
            selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
            self._hang_up(selector)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        if self._listener is None:
            return
        with contextlib.suppress(OSError):  # nobody is there, or gone again
            client, address = self._listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            selector.register(client, selectors.EVENT_READ)
            self._clients[address] = client
            with self._lock:
                self._protocol.attach(self._clock.now_s(), address)

    def _listen(self, selector: selectors.BaseSelector, address: Address) -> None:
        try:
            data = self._clients[address].recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(selector, address)
            return
        with self._lock:
            out = self._protocol.receive(self._clock.now_s(), address, self._faults.spoil(data, self._rng))
        self._post(out)

    def _speak(self, selector: selectors.BaseSelector) -> None:
        with self._lock:
            out = self._protocol.poll(self._clock.now_s())
        self._post(out)
        for address, data in self._late.due(self._clock.now_s()):
            if address in self._clients and not self._faults.silent:
                try:
                    self._clients[address].sendall(self._faults.spoil(data, self._rng))
                except BlockingIOError:  # it does not read: part of a message may be lost, as on a full line
                    continue
                except OSError:
                    self._drop(selector, address)

    def _drop(self, selector: selectors.BaseSelector, address: Address) -> None:
        client = self._clients.pop(address)
        selector.unregister(client)
        client.close()
        with self._lock:
            self._protocol.detach(address)

    def _hang_up(self, selector: selectors.BaseSelector) -> None:
        for address in tuple(self._clients):
            self._drop(selector, address)
        self._late.clear()

    def _post(self, datagrams: list[Datagram]) -> None:
        self._late.post(datagrams, self._clock.now_s() + self._faults.latency_s)

    def _wait_s(self) -> float:
        now_s = self._clock.now_s()
        with self._lock:
            due_s = min(self._protocol.next_due_s(now_s), self._late.next_s())
        return max(0.0, min(_LONGEST_WAIT_S, due_s - now_s))


def _listening(port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind(("127.0.0.1", port))
        opened.listen()
    except OSError:
        opened.close()
        raise
    opened.setblocking(False)
    return opened
