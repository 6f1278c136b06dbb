"""Who may speak on a line: first come, first served; a stop goes before everybody and wakes whoever listens."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Turns:
    """Any thread; whoever is inside ``turn`` or ``stop_turn`` has the line to itself."""

    def __init__(
        self,
        wake: Callable[[], None],
        *,
        quiet_s: Callable[[], float] = lambda: 0.0,
        make_condition: Callable[[], threading.Condition] = threading.Condition,
    ) -> None:
        """Build them; ``wake`` makes a listener look at ``stop_waits`` at once, ``quiet_s`` tells how much longer the
        line must be quiet before the next turn. A stop does not wait for that. Simulated time brings its condition.
        """
        self._wake = wake
        self._quiet_s = quiet_s
        self._changed = make_condition()
        self._queue: deque[object] = deque()
        self._stops_waiting = 0
        self._busy = False

    @property
    def stop_waits(self) -> bool:
        """Whether whoever has the turn should give it up."""
        return self._stops_waiting > 0

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Wait for one's turn."""
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
            try:
                while (wait_s := self._wait_s(ticket)) is None or wait_s > 0.0:
                    self._changed.wait(wait_s)
                self._busy = True
            finally:
                self._queue.remove(ticket)
                self._changed.notify_all()
        yield from self._holding()

    def _wait_s(self, ticket: object) -> float | None:
        """Return how long to wait for the line's quiet, None for until something changes."""
        if self._busy or self._stops_waiting or self._queue[0] is not ticket:
            return None
        return self._quiet_s()

    @contextmanager
    def stop_turn(self) -> Iterator[None]:
        """Take the line as soon as whoever has it lets go, which it is told to do at once."""
        with self._changed:
            self._stops_waiting += 1
            try:
                if self._busy:
                    self._wake()
                self._changed.wait_for(lambda: not self._busy)
                self._busy = True
            finally:
                self._stops_waiting -= 1
                self._changed.notify_all()
        yield from self._holding()

    def _holding(self) -> Iterator[None]:
        try:
            yield
        finally:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
