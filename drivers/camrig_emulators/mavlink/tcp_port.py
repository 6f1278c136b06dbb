"""The TCP port of the emulated drone: several connections, none of which outlives a boot."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from typing import Protocol

from camrig.clock import Clock
from camrig_emulators.delayed import Address
from camrig_emulators.faults import Faults
from camrig_emulators.socket_port import DatagramDevice, SocketPort

_READ_BYTES = 4096


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


class TcpPort(SocketPort[StreamDevice]):
    """Serves one protocol by streams."""

    kind = "TCP"

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
        self._clients: dict[Address, socket.socket] = {}
        self._boots = protocol.boots
        super().__init__(name, protocol, lock, clock, faults, seed, port)

    @staticmethod
    def _opened(port: int) -> socket.socket:
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

    def _plug(self, selector: selectors.BaseSelector) -> None:
        """Open or close the port; a reboot ends every connection."""
        with self._lock:
            boots = self._protocol.boots
        if boots != self._boots:
            self._boots = boots
            self._speak(selector)  # the acknowledgement of the reboot is still delivered
            self._hang_up(selector)
        super()._plug(selector)

    def _turn(self, selector: selectors.BaseSelector) -> None:
        self._accept(selector)
        for address in tuple(self._clients):
            self._listen(selector, address)
        self._speak(selector)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # nobody is there, or gone again
            client, address = self._socket.accept()
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
        if data:
            self._hear(address, data)
        else:
            self._drop(selector, address)

    def _speak(self, selector: selectors.BaseSelector) -> None:
        for address, data in self._due():
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
        super()._hang_up(selector)
