"""What an emulated device has said and the link has not delivered yet."""

from __future__ import annotations

import heapq

Address = tuple[str, int]
Datagram = tuple[Address, bytes]


class Delayed:
    """Datagrams by the time at which they leave; those of one time leave in order."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Datagram]] = []
        self._posted = 0

    def post(self, datagrams: list[Datagram], due_s: float) -> None:
        """Let all leave at ``due_s``."""
        for datagram in datagrams:
            self._posted += 1
            heapq.heappush(self._heap, (due_s, self._posted, datagram))

    def due(self, now_s: float) -> list[Datagram]:
        """Take what leaves by now."""
        leaving = []
        while self._heap and self._heap[0][0] <= now_s:
            leaving.append(heapq.heappop(self._heap)[2])
        return leaving

    def next_s(self) -> float:
        """Return when the next one leaves; infinity for never."""
        return self._heap[0][0] if self._heap else float("inf")

    def clear(self) -> None:
        """Lose all."""
        self._heap.clear()
