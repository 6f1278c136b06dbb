"""Whether what an axis reports can be true: some heads report where they are going, some what they last knew. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_FASTER = 1.25
"""Moves to a position may be this much faster than the rig says the head is."""
_JUMP_SLACK_RAD = math.radians(0.5)
_SETTLE_S = 1.0
"""What a head takes beyond distance over speed: its start, its ramps and the swing at the end."""
_START_S = 0.35
"""A head that was sent somewhere has begun to move so long after."""
_MOVED_RAD = math.radians(0.05)
_WORTH_RAD = math.radians(0.5)


@dataclass(slots=True)
class Watch:
    """One axis's reports, each judged against the one before and against what the head was told."""

    speed_rad_s: float
    disbelieved: int = 0
    _last: tuple[float, float] | None = None
    _doubt_until_s: float = -math.inf
    _told: tuple[float, float] | None = field(default=None)
    """Where it stood when it was sent away, and when that was."""

    def told(self, target_rad: float, now_s: float) -> None:
        """Note that the head was sent to a position (or an infinite one: turned on) at ``now_s``."""
        if self._last is not None and abs(target_rad - self._last[0]) > _WORTH_RAD:
            if self._told is None or abs(self._last[0] - self._told[0]) > _MOVED_RAD:
                self._told = (self._last[0], now_s)
        else:
            self._told = None

    def stood(self) -> None:
        """Note that the head is not expected to move any more."""
        self._told = None

    def believes(self, angle_rad: float, stamp_s: float) -> bool:
        """Judge a report; what is not believed is to be taken as unknown.

        A jump that is faster than the head means that either this report or the ones before were not the truth: an
        honest head would need the distance over its speed to get there, so nothing is believed before that. A head
        that was told to move and reports that it stands is not believed until it is seen to move, or given up.
        """
        last, self._last = self._last, (angle_rad, stamp_s)
        if last is not None:
            travel_rad = abs(angle_rad - last[0])
            reach_rad = _FASTER * self.speed_rad_s * max(0.0, stamp_s - last[1]) + _JUMP_SLACK_RAD
            if travel_rad > reach_rad:
                self._doubt_until_s = stamp_s + travel_rad / self.speed_rad_s + _SETTLE_S
        believed = stamp_s >= self._doubt_until_s and not self._should_have_moved(angle_rad, stamp_s)
        self.disbelieved += not believed
        return believed

    def _should_have_moved(self, angle_rad: float, stamp_s: float) -> bool:
        if self._told is None:
            return False
        from_rad, told_s = self._told
        if abs(angle_rad - from_rad) > _MOVED_RAD:
            self._told = None
            return False
        return stamp_s > told_s + _START_S
