"""The host as the bench around a guest: emulated heads on its UARTs, their wires logged, pictures for its cameras."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import serial

from camrig.rig import CameraSpec
from camrig_emulators.rendered_camera import RenderedCamera, RenderedSection
from tests.vm.machine import connected

STOP = bytes.fromhex("ff010000000001")
_SET_POSITION = (0x4B, 0x4D)
_FRAME = 7
_BAUD = 9600
_PICTURE = struct.Struct("<dd")


class Wire:
    """Joins a guest's UART to an emulated head's port, and notes when each command passed."""

    def __init__(self, uart: socket.socket, port: str) -> None:
        self.commands: list[tuple[float, bytes]] = []
        self._uart = uart
        self._head = serial.Serial(port, _BAUD, timeout=0)
        self._bytes = bytearray()

    def serve(self, stopping: threading.Event) -> None:
        """Pass bytes on, both ways, until ``stopping``."""
        while not stopping.is_set():
            ends: list[Any] = [self._uart, self._head]
            ready, _, _ = select.select(ends, [], [], 0.1)
            if self._uart in ready:
                data = self._uart.recv(256)
                if not data:
                    return
                self._note(data)
                self._head.write(data)
            if self._head in ready:
                self._uart.sendall(self._head.read(256))

    def close(self) -> None:
        self._head.close()
        self._uart.close()

    def stops(self, since_s: float) -> list[float]:
        """Return when a stop passed."""
        return [stamp_s for stamp_s, frame in list(self.commands) if frame == STOP and stamp_s > since_s]

    def motions(self, since_s: float) -> list[float]:
        """Return when the head was sent somewhere."""
        return [s for s, frame in list(self.commands) if frame[3] in _SET_POSITION and s > since_s]

    def _note(self, data: bytes) -> None:
        self._bytes += data
        while len(self._bytes) >= _FRAME:
            frame = bytes(self._bytes[:_FRAME])
            if frame[0] == 0xFF and sum(frame[1:6]) & 0xFF == frame[6]:
                self.commands.append((time.monotonic(), frame))
                del self._bytes[:_FRAME]
            else:
                del self._bytes[0]


def feed(spec: CameraSpec, url: str, line: socket.socket, stopping: threading.Event) -> None:
    """Answer whenever the guest asks for a picture: how long that took, how old the picture is by then, its pixels."""
    camera = RenderedCamera(spec, RenderedSection(url=url))
    camera.open()
    line.settimeout(0.5)
    try:
        while not stopping.is_set():
            with suppress(TimeoutError):
                if not line.recv(1):
                    return
                asked_s = time.monotonic()
                while (frame := camera.read(0.5)) is None and not stopping.is_set():
                    pass
                if frame is not None:
                    now_s = time.monotonic()
                    _send(line, _PICTURE.pack(now_s - asked_s, now_s - frame.stamp_s) + frame.image.tobytes(), stopping)
    finally:
        camera.close()


def _send(line: socket.socket, data: bytes, stopping: threading.Event) -> None:
    left = memoryview(data)
    while left and not stopping.is_set():
        with suppress(TimeoutError):  # the guest takes its time
            left = left[line.send(left) :]


@contextmanager
def bench(share: Path, ports: dict[str, str], spec: CameraSpec, timeout_s: float) -> Iterator[Wire]:
    """Serve the guest's UART "head" and its picture line "camera" while inside; yields the wire."""
    stopping = threading.Event()
    wire = Wire(connected(share / "head.sock", timeout_s), ports["pt1"])
    line = connected(share / "camera.sock", timeout_s)
    threads = [
        threading.Thread(target=wire.serve, args=(stopping,), name="wire"),
        threading.Thread(target=feed, args=(spec, ports[spec.id], line, stopping), name="feed"),
    ]
    for thread in threads:
        thread.start()
    try:
        yield wire
    finally:
        stopping.set()
        for thread in threads:
            thread.join()
        wire.close()
        line.close()
