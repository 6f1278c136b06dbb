"""Threads in simulated time: one runs at a time, and when all of them wait the clock jumps to whoever is due first.

Real code with real threads and locks runs in it, hours in seconds and every run the same, as long as it waits only
through what is here: the clock, its conditions, and ports that wait by ``wait_until``.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import cast


@dataclass(eq=False)
class _Runner:
    """One thread; it waits for ``go``."""

    order: int
    due_s: float = -math.inf
    waits_for: object = None
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))


class SimulatedTime:
    """A ``camrig.clock.Clock``. The thread that makes it takes part; others are started by ``running``."""

    def __init__(self, start_s: float = 100.0) -> None:
        self._now_s = start_s
        self._turns = 0
        self._runners = {threading.get_ident(): _Runner(0)}

    def now_s(self) -> float:
        return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        self.wait_until(self._now_s + max(0.0, duration_s))

    def condition(self) -> threading.Condition:
        """Return a condition whose waits are of this time."""
        return cast("threading.Condition", _Condition(self))

    def wait_until(self, stamp_s: float, what: object = None) -> None:
        """Let others run until ``stamp_s``, or until ``what`` is notified."""
        me = self._runners[threading.get_ident()]
        me.due_s, me.waits_for = max(stamp_s, self._now_s), what
        self._switch(me)

    def notify(self, what: object) -> None:
        """Make everybody due who waits for ``what``."""
        for runner in self._runners.values():
            if runner.waits_for is what:
                runner.due_s, runner.waits_for = self._now_s, None

    @contextmanager
    def running(self, name: str, work: Callable[[], None]) -> Iterator[None]:
        """Run ``work`` in a thread beside the block; what it raises is raised at the block's end, which waits."""
        failures: list[BaseException] = []
        ended = object()
        started = threading.Event()

        def run() -> None:
            me = _Runner(len(self._runners), self._now_s)
            self._runners[threading.get_ident()] = me
            started.set()
            me.go.acquire()
            try:
                work()
            except BaseException as error:  # handed to the thread that started it
                failures.append(error)
            del self._runners[threading.get_ident()]
            thread_is_alive.clear()
            self.notify(ended)
            self._next().go.release()

        thread = threading.Thread(target=run, name=name, daemon=True)
        thread_is_alive = threading.Event()
        thread_is_alive.set()
        thread.start()
        started.wait()
        try:
            yield
        finally:
            while thread_is_alive.is_set():
                self.wait_until(math.inf, ended)
            thread.join()
        if failures:
            raise failures[0]

    def _switch(self, me: _Runner) -> None:
        chosen = self._next()
        if chosen is not me:
            chosen.go.release()
            me.go.acquire()

    def _next(self) -> _Runner:
        """Return who runs next, its time having come; of several that are due, who has waited longest."""
        chosen = min(self._runners.values(), key=lambda runner: (runner.due_s, runner.order))
        if chosen.due_s == math.inf:
            raise RuntimeError("every thread waits for another: a deadlock")
        self._turns += 1
        chosen.order = self._turns + len(self._runners)
        self._now_s = max(self._now_s, chosen.due_s)
        chosen.waits_for = None
        return chosen


class _Condition:
    """As ``threading.Condition``; its lock is never contended, since only one thread runs."""

    def __init__(self, time: SimulatedTime) -> None:
        self._time = time

    def __enter__(self) -> bool:
        return True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def wait(self, timeout: float | None = None) -> bool:
        until_s = math.inf if timeout is None else self._time.now_s() + timeout
        self._time.wait_until(until_s, self)
        return True

    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
        until_s = math.inf if timeout is None else self._time.now_s() + timeout
        while not predicate() and self._time.now_s() < until_s:
            self._time.wait_until(until_s, self)
        return predicate()

    def notify_all(self) -> None:
        self._time.notify(self)
