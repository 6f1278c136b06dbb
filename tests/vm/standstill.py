"""Finds out when an emulated computer stood still, because its host was busy: nothing in it can then be on time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

TICK_S = 0.01
LATE_S = 0.005
"""What is told of: less is every computer's."""


class Standstills:
    """When some processor stood still, of CLOCK_MONOTONIC; known once the watch has ended."""

    def __init__(self) -> None:
        self.times_s: list[tuple[float, float]] = []
        """Begin and end of each."""

    @property
    def longest_s(self) -> float:
        return max((end_s - begin_s for begin_s, end_s in self.times_s), default=0.0)

    def between(self, begin_s: float, end_s: float, longer_s: float) -> list[tuple[float, float]]:
        """Return those longer than so much that touch an interval."""
        return [each for each in self.times_s if each[1] - each[0] > longer_s and each[0] < end_s and each[1] > begin_s]


@contextmanager
def watched() -> Iterator[Standstills]:
    """Have a process on every processor sleep and wake, and see how much too late it does."""
    found = Standstills()
    ends = [_start(processor) for processor in sorted(os.sched_getaffinity(0))]
    try:
        yield found
    finally:
        for pid, _ in ends:
            os.kill(pid, signal.SIGTERM)
        for pid, told in ends:
            with os.fdopen(told) as lines:
                for line in lines.read().splitlines():
                    begin_s, end_s = map(float, line.split())
                    found.times_s.append((begin_s, end_s))
            os.waitpid(pid, 0)


def _start(processor: int) -> tuple[int, int]:
    """Fork a watcher that writes every standstill it sees; return its process and the pipe's end to read."""
    told, tell = os.pipe()
    pid = os.fork()
    if pid:
        os.close(tell)
        return pid, told
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.sched_setaffinity(0, {processor})
    while True:
        due_s = time.monotonic() + TICK_S
        time.sleep(TICK_S)
        woken_s = time.monotonic()
        if woken_s - due_s > LATE_S:
            os.write(tell, f"{due_s:.4f} {woken_s:.4f}\n".encode())
