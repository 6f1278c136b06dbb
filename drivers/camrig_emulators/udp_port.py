"""The UDP port of an emulated device."""

from __future__ import annotations

import contextlib
import selectors
import socket

from camrig_emulators.socket_port import DatagramDevice, SocketPort

_DATAGRAM_BYTES = 2048
_READ_AT_ONCE = 64  # so that a flood does not keep telemetry waiting


class UdpPort(SocketPort[DatagramDevice]):
    """Serves one protocol by datagrams: it answers whoever speaks to it."""

    kind = "UDP"

    @staticmethod
    def _opened(port: int) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            opened.bind(("127.0.0.1", port))
        except OSError:
            opened.close()
            raise
        return opened

    def _turn(self, selector: selectors.BaseSelector) -> None:
        self._listen()
        for address, data in self._due():
            if self._socket is not None and not self._faults.silent:
                with contextlib.suppress(OSError):  # datagrams may be lost
                    self._socket.sendto(self._faults.spoil(data, self._rng), address)

    def _listen(self) -> None:
        for _ in range(_READ_AT_ONCE):
            if self._socket is None:
                return
            try:
                data, address = self._socket.recvfrom(_DATAGRAM_BYTES)
            except OSError:  # nothing more to read, or a peer that is gone
                return
            self._hear(address, data)
