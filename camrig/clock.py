"""The one clock: seconds of CLOCK_MONOTONIC, injected wherever time matters."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Where ``runtime`` and the drivers get their time; mathematics takes ``now_s`` instead."""

    def now_s(self) -> float:
        """Return seconds of a clock that never steps back; V4L2 stamps are of the same clock."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Block the calling thread for ``duration_s`` of this clock's time."""
        ...


class RealClock:
    """CLOCK_MONOTONIC."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        time.sleep(max(0.0, duration_s))


class ManualClock:
    """A clock that moves only when a test says so; sleepers wake when their time has come."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._moved = threading.Condition()

    def now_s(self) -> float:
        with self._moved:
            return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        with self._moved:
            wake_s = self._now_s + duration_s
            self._moved.wait_for(lambda: self._now_s >= wake_s)

    def advance(self, duration_s: float) -> None:
        """Move the clock on by ``duration_s`` >= 0 and wake whoever waited for it."""
        if duration_s < 0.0:
            raise ValueError("a monotonic clock is never moved back")
        with self._moved:
            self._now_s += duration_s
            self._moved.notify_all()
