"""A camera in memory."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable

from camrig.clock import Clock, RealClock
from camrig.errors import EndOfInput, LinkLost
from camrig.geometry.arrays import GreyImage
from camrig.messages import Frame
from camrig_emulators.faults import Faults

_REAL_CLOCK = RealClock()


class FakeCamera:
    """Frames that a test pushes, read in order, or that ``picture(stamp_s)`` draws ``fps`` times a second."""

    def __init__(
        self,
        camera_id: str,
        picture: Callable[[float], GreyImage] | None = None,
        *,
        fps: float = 10.0,
        clock: Clock = _REAL_CLOCK,
    ) -> None:
        self.camera_id = camera_id
        self.faults = Faults()
        self._picture = picture
        self._period_s = 1.0 / fps
        self._clock = clock
        self._changed = threading.Condition()
        self._frames: deque[Frame] = deque()
        self._sequence = 0
        self._next_s = math.inf
        self._woken = self._ended = False
        self._last_image: GreyImage | None = None
        self.faults.watch(self._wake_up)

    def push(self, image: GreyImage, stamp_s: float | None = None, note: str = "") -> None:
        """Let the camera capture a picture, now or at a stamp, with what it notes of it; any thread."""
        with self._changed:
            self._capture(image, self._clock.now_s() if stamp_s is None else stamp_s, note)
        self._wake_up()

    def end(self) -> None:
        """Let ``read`` raise EndOfInput once what was pushed is read; any thread."""
        self._ended = True
        self._wake_up()

    def open(self) -> None:
        self._need_link()
        with self._changed:
            self._woken = False
            self._next_s = self._clock.now_s() if self._picture else math.inf

    def read(self, timeout_s: float) -> Frame | None:
        with self._changed:
            if not self._ready():
                self._changed.wait(min(timeout_s, max(0.0, self._next_s - self._clock.now_s())))
                self._ready()
            woken, self._woken = self._woken, False
            if woken or (not self._frames and not self._ended):
                return None
            if not self._frames:
                raise EndOfInput
            return self._frames.popleft()

    def wake(self) -> None:
        self._woken = True
        self._wake_up()

    def close(self) -> None:
        self.wake()

    def _ready(self) -> bool:
        """Capture what is due; say whether ``read`` has something to return."""
        self._need_link()
        now_s = self._clock.now_s()
        if self._picture is not None and now_s >= self._next_s:
            missed = math.floor((now_s - self._next_s) / self._period_s)
            stamp_s = self._next_s + missed * self._period_s
            self._next_s = stamp_s + self._period_s
            self._sequence += missed
            self._capture(self._picture(stamp_s), stamp_s)
        return bool(self._frames) or self._woken or self._ended

    def _capture(self, image: GreyImage, stamp_s: float, note: str = "") -> None:
        self._sequence += 1
        if self.faults.silent or self.faults.take_drop():
            return
        if self._last_image is None or not self.faults.freeze:
            self._last_image = image
        self._frames.append(Frame(self.camera_id, self._last_image, stamp_s, self._sequence, note=note))

    def _wake_up(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _need_link(self) -> None:
        if not self.faults.plugged:
            raise LinkLost(f"camera {self.camera_id}: the fake is unplugged")
