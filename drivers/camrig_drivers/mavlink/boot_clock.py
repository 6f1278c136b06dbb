"""Maps an autopilot's ``time_boot_ms`` to our clock.

A message arrives after it was sampled, by a delay that varies but is never negative: the least (arrival − boot time) of
the last seconds is the offset of the clocks plus the shortest delay. The window slides, to follow clock drift.
"""

from __future__ import annotations

from collections import deque

_WINDOW_S = 5.0
_RESTART_S = 1.0
"""Datagrams may overtake one another by milliseconds; a clock that falls back further has started anew."""


class BootClock:
    """The offset between one autopilot's clock, since its last boot, and ours."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[float, float]] = deque()  # (arrival, offset), offsets ascending
        self._newest_s = 0.0

    def update(self, boot_s: float, arrival_s: float) -> bool:
        """Take a boot time that arrived at ``arrival_s``; return whether the autopilot has rebooted.

        The wrap of 32-bit milliseconds after 49.7 days counts as a reboot.
        """
        rebooted = boot_s < self._newest_s - _RESTART_S
        if rebooted:
            self._offsets.clear()
        self._newest_s = boot_s if rebooted else max(boot_s, self._newest_s)
        offset_s = arrival_s - boot_s
        while self._offsets and self._offsets[-1][1] >= offset_s:
            self._offsets.pop()
        self._offsets.append((arrival_s, offset_s))
        while self._offsets[0][0] < arrival_s - _WINDOW_S:
            self._offsets.popleft()
        return rebooted

    def stamp_s(self, boot_s: float) -> float:
        """Return a boot time in our clock; needs one ``update`` before."""
        return boot_s + self._offsets[0][1]
