"""Maps an autopilot's clock, milliseconds since its boot, to ours.

Two measurements of the offset between them. TIMESYNC, where it is answered: half of the round trip at its shortest. And
always: a message arrives after it was sampled, by a delay that varies but is never negative, so the least (arrival −
boot time) of the last seconds is the offset plus the shortest delay. The windows slide, to follow clock drift.
"""

from __future__ import annotations

from collections import deque

_WINDOW_S = 5.0
_RESTART_S = 1.0
"""Datagrams may overtake one another by milliseconds; a clock that falls back further has started anew."""
_WRAP_S = 2.0**32 / 1e3
_TOLERANCE_S = 5.0
"""How well the next boot time is foretold: a clock that wraps lands as near to it, one that starts anew does not."""
_MAX_ROUND_TRIP_S = 0.05
_MAX_DELAY_S = 1.0
_SYNC_WINDOW_S = 15.0


class BootClock:
    """The offset between one autopilot's clock, since its last boot, and ours."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[float, float]] = deque()  # (arrival, offset), offsets ascending
        self._syncs: deque[tuple[float, float, float]] = deque()  # (arrival, round trip, offset), round trips ascending
        self._newest_s = 0.0
        self._arrival_s = 0.0

    def update(self, time_boot_ms: int, arrival_s: float) -> tuple[float, bool]:
        """Take a boot time that arrived at ``arrival_s``.

        Returns it in seconds, without the wrap of its 32 bits after 49.7 days, and whether the autopilot has rebooted.
        """
        told_s = time_boot_ms / 1e3
        boot_s = told_s
        if self._offsets:
            foretold_s = self._newest_s + arrival_s - self._arrival_s
            unwrapped_s = told_s + _WRAP_S * round((foretold_s - told_s) / _WRAP_S)
            if unwrapped_s >= 0.0 and abs(unwrapped_s - foretold_s) < _TOLERANCE_S:
                boot_s = unwrapped_s
        rebooted = boot_s < self._newest_s - _RESTART_S
        if rebooted:
            boot_s = told_s
            self._offsets.clear()
            self._syncs.clear()
        if rebooted or boot_s >= self._newest_s:
            self._newest_s, self._arrival_s = boot_s, arrival_s
        offset_s = arrival_s - boot_s
        while self._offsets and self._offsets[-1][1] >= offset_s:
            self._offsets.pop()
        self._offsets.append((arrival_s, offset_s))
        while self._offsets[0][0] < arrival_s - _WINDOW_S:
            self._offsets.popleft()
        return boot_s, rebooted

    def synchronise(self, asked_s: float, theirs_s: float, arrival_s: float) -> None:
        """Take an answer to TIMESYNC: asked at ``asked_s``, here at ``arrival_s``, theirs in between."""
        round_trip_s = arrival_s - asked_s
        if not 0.0 <= round_trip_s <= _MAX_ROUND_TRIP_S:
            return
        while self._syncs and self._syncs[-1][1] >= round_trip_s:
            self._syncs.pop()
        self._syncs.append((arrival_s, round_trip_s, (asked_s + arrival_s) / 2.0 - theirs_s))
        while self._syncs[0][0] < arrival_s - _SYNC_WINDOW_S:
            self._syncs.popleft()

    @property
    def synchronised(self) -> bool:
        """Whether TIMESYNC tells the offset now."""
        return self._sync_offset_s() is not None

    def stamp_s(self, boot_s: float) -> float:
        """Return a boot time of ``update`` in our clock; needs one ``update`` before."""
        offset_s = self._sync_offset_s()
        return boot_s + (self._offsets[0][1] if offset_s is None else offset_s)

    def _sync_offset_s(self) -> float | None:
        """Return TIMESYNC's offset where it is fresh and is of the clock that stamps: some count another epoch."""
        if not self._syncs or not self._offsets or self._syncs[0][0] < self._offsets[-1][0] - _SYNC_WINDOW_S:
            return None
        _, round_trip_s, offset_s = self._syncs[0]
        delay_s = self._offsets[0][1] - offset_s
        return offset_s if -round_trip_s / 2.0 - 1e-3 <= delay_s <= _MAX_DELAY_S else None
