"""The world's end of a rendered camera: a Unix socket, a grid of times, and a picture only when one is asked for."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from camrig.clock import Clock
from camrig.geometry.arrays import GreyImage
from camrig_emulators.faults import Faults
from camrig_emulators.frame_wire import HEADER, SCHEME

_UNPLUGGED_CHECK_S = 0.5


@dataclass(frozen=True, slots=True)
class FrameGrid:
    """When a camera exposes: frame k has its middle at ``first_s + k * period_s`` and lasts ``exposure_s``."""

    first_s: float
    period_s: float
    exposure_s: float

    def stamp_s(self, sequence: int) -> float:
        """Return the middle of a frame's exposure."""
        return self.first_s + sequence * self.period_s

    def ready_s(self, sequence: int) -> float:
        """Return the end of a frame's exposure."""
        return self.stamp_s(sequence) + self.exposure_s / 2.0

    def newest(self, now_s: float) -> int:
        """Return the number of the last frame whose exposure has ended; -1 before the first has."""
        return max(-1, math.floor((now_s - self.first_s - self.exposure_s / 2.0) / self.period_s + 1e-9))


class FrameServer:
    """Serves one camera to one client at a time, from a thread of its own; ``faults`` from any thread."""

    def __init__(
        self, camera_id: str, path: Path, grid: FrameGrid, draw: Callable[[float, int], GreyImage], clock: Clock
    ) -> None:
        """Build it; ``draw(stamp_s, sequence)`` returns the picture and is called from the server's thread."""
        self.faults = Faults()
        self.url = f"{SCHEME}{path}"
        self._path = path
        self._grid = grid
        self._draw = draw
        self._clock = clock
        self._stopping = False
        self._wake_read, self._wake_write = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=f"emulated {camera_id}")
        self._client: socket.socket | None = None
        self._last_drawn: GreyImage | None = None
        self.faults.watch(self._wake)

    def start(self) -> None:
        """Serve from now on; the socket is there when this returns."""
        self._listener = self._listen()
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the socket."""
        self._stopping = True
        self._wake()
        self._thread.join()
        self._wake_read.close()
        self._wake_write.close()

    def _wake(self) -> None:
        """Make the thread look again whether it may go on; one that is stuck in sending is cut off if not."""
        self._wake_write.send(b"w")
        client = self._client
        if client is not None and not self._up():
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def _listen(self) -> socket.socket:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(self._path))
        listener.listen(1)
        return listener

    def _run(self) -> None:
        while not self._stopping:
            with self._listener:
                while self._up():
                    if self._wait(self._listener, None):
                        self._client, _ = self._listener.accept()
                        with self._client:
                            self._serve(self._client)
            self._path.unlink(missing_ok=True)
            while not self._stopping and not self.faults.plugged:
                self._wait(None, self._clock.now_s() + _UNPLUGGED_CHECK_S)
            if not self._stopping:
                self._listener = self._listen()

    def _up(self) -> bool:
        return self.faults.plugged and not self._stopping

    def _serve(self, client: socket.socket) -> None:
        """Answer one client until it goes, or until the camera is unplugged or stopped."""
        sent = self._grid.newest(self._clock.now_s())
        try:
            while self._up():
                if self._wait(client, None):
                    if not client.recv(64):
                        return
                    found = self._next(client, sent)
                    if found is None:
                        return
                    sent = found
        except OSError:
            return  # the client went away in the middle of a frame

    def _next(self, client: socket.socket, sent: int) -> int | None:
        """Send the newest frame after ``sent``, waiting for it if need be; None where the client or camera went."""
        sequence = max(sent + 1, self._grid.newest(self._clock.now_s()))
        while self._up():
            due_s = self._grid.ready_s(sequence) + self.faults.latency_s
            if self._clock.now_s() < due_s:
                if self._wait(client, due_s):
                    return None  # a client that waits for a frame says nothing: it has hung up
                continue
            if not self.faults.silent and not self.faults.take_drop():
                self._send(client, sequence)
                return sequence
            sequence += 1
        return None

    def _send(self, client: socket.socket, sequence: int) -> None:
        stamp_s = self._grid.stamp_s(sequence)
        if self._last_drawn is None or not self.faults.freeze:
            self._last_drawn = self._draw(stamp_s, sequence)
        height, width = self._last_drawn.shape
        client.sendall(HEADER.pack(stamp_s, sequence, width, height))
        client.sendall(self._last_drawn.data.cast("B"))

    def _wait(self, end: socket.socket | None, until_s: float | None) -> bool:
        """Block until ``end`` is readable (True), or somebody wakes us or the time has come (False)."""
        patience_s = None if until_s is None else max(0.0, until_s - self._clock.now_s())
        ready, _, _ = select.select([self._wake_read, *([end] if end else [])], [], [], patience_s)
        if self._wake_read in ready:
            self._wake_read.recv(4096)
        return end in ready
