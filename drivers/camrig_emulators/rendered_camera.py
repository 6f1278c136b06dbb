"""``driver: rendered``: a camera of the emulated world, as the daemon sees it.

The world renders in a process of its own and only what is asked for; this end is as thin as a driver of a real
camera. Frames lie on a fixed grid of times; the sequence number counts the grid, so that gaps show.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, LinkLost
from camrig.interfaces import Camera, Driver
from camrig.messages import Frame
from camrig.rig import CameraSpec
from camrig_emulators.frame_wire import ASK, HEADER, SCHEME

_CONNECT_TIMEOUT_S = 2.0
_REAL_CLOCK = RealClock()


class RenderedSection(BaseModel):
    """The keys of a rendered camera; ``url`` is filled in by the world."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    url: Annotated[str, Field(min_length=1)]
    fps: Annotated[float, Field(gt=0.0, le=240.0)] = 10.0


class RenderedCamera:
    """A client of the world's socket; ``wake`` may be called from any thread, all else from one."""

    def __init__(self, spec: CameraSpec, section: RenderedSection, clock: Clock = _REAL_CLOCK) -> None:
        self._spec = spec
        self._path = section.url.removeprefix(SCHEME)
        self._clock = clock
        self._link: socket.socket | None = None
        self._wake: tuple[socket.socket, socket.socket] | None = None
        width, height = spec.lens.size_px
        self._received = bytearray(HEADER.size + width * height)
        self._have = 0
        self._asked = False

    def open(self) -> None:
        self.close()
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            link.settimeout(_CONNECT_TIMEOUT_S)
            link.connect(self._path)
        except OSError as error:
            link.close()
            raise LinkLost(f"camera {self._spec.id}: no emulated world answers at {self._path} ({error})") from error
        link.setblocking(False)
        self._link, self._wake = link, socket.socketpair()
        self._have, self._asked = 0, False

    def read(self, timeout_s: float) -> Frame | None:
        deadline_s = self._clock.now_s() + timeout_s
        if self._link is None or self._wake is None:
            raise LinkLost(f"camera {self._spec.id} is not open")
        try:
            if not self._asked:
                self._link.send(ASK)
                self._asked = True
            while self._have < len(self._received):
                patience_s = max(0.0, deadline_s - self._clock.now_s())
                ready, _, _ = select.select([self._link, self._wake[0]], [], [], patience_s)
                if self._wake[0] in ready:
                    self._wake[0].recv(4096)
                    return None
                if not ready:
                    return None
                self._receive(self._link)
        except OSError as error:
            raise LinkLost(f"camera {self._spec.id}: the emulated world is gone ({error})") from error
        self._have, self._asked = 0, False
        return self._frame()

    def wake(self) -> None:
        pair = self._wake
        if pair is not None:
            try:
                pair[1].send(b"w")
            except OSError:
                return  # closed meanwhile: nobody is left to wake

    def close(self) -> None:
        link, pair = self._link, self._wake
        self._link = self._wake = None
        for end in (link, *(pair or ())):
            if end is not None:
                end.close()

    def _receive(self, link: socket.socket) -> None:
        count = link.recv_into(memoryview(self._received)[self._have :])
        if count == 0:
            raise LinkLost(f"camera {self._spec.id}: the emulated world closed its link")
        self._have += count
        if self._have >= HEADER.size and self._size_px() != self._spec.lens.size_px:
            raise HardwareError(
                f"camera {self._spec.id} sends pictures of {self._size_px()} pixels, its lens is of "
                f"{self._spec.lens.size_px}"
            )

    def _size_px(self) -> tuple[int, int]:
        _, _, width, height = HEADER.unpack_from(self._received)
        return width, height

    def _frame(self) -> Frame:
        stamp_s, sequence, width, height = HEADER.unpack_from(self._received)
        grey = np.frombuffer(self._received, dtype=np.uint8, offset=HEADER.size)
        return Frame(self._spec.id, grey.reshape(height, width), stamp_s, sequence)


def _make(cameras: Mapping[str, tuple[CameraSpec, RenderedSection]]) -> Mapping[str, Camera]:
    return {name: RenderedCamera(spec, section) for name, (spec, section) in cameras.items()}


driver: Driver[CameraSpec, Camera] = Driver(section=RenderedSection, make=_make)
