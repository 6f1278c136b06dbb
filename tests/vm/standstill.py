"""Finds out when an emulated computer stood still, because its host was busy: nothing in it can then be on time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

TICK_S = 0.01


class Standstills:
    """How long each processor stood still at the longest; known once the watch has ended."""

    longest_s: float = 0.0


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
                found.longest_s = max(found.longest_s, *map(float, ["0", *lines.read().split()]))
            os.waitpid(pid, 0)


def _start(processor: int) -> tuple[int, int]:
    """Fork a watcher that writes every record it sees; return its process and the pipe's end to read."""
    told, tell = os.pipe()
    pid = os.fork()
    if pid:
        os.close(tell)
        return pid, told
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.sched_setaffinity(0, {processor})
    longest_s = 0.0
    while True:
        begun_s = time.monotonic()
        time.sleep(TICK_S)
        late_s = time.monotonic() - begun_s - TICK_S
        if late_s > longest_s:
            longest_s = late_s
            os.write(tell, f"{late_s}\n".encode())
