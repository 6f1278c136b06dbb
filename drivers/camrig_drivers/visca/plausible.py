"""Doubts about positions: a serial VISCA line has no checksum, so a flipped bit may pass for an answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

HASTE = 1.5
"""How much faster than it is said to be a head may move and still be believed."""
_REST_RAD_S = math.radians(1.0)
"""A head that nobody has moved drifts no faster."""


@dataclass
class Doubt:
    """Believes a position that its head can have reached since the one before; any other only when the next agrees.

    ``digit_rad`` is the largest of the axes' counts, ``speed_rad_s`` the head's speed.
    """

    speed_rad_s: float
    digit_rad: float
    _last: tuple[float, float, float] | None = field(default=None, init=False)
    _jumped: bool = field(default=False, init=False)

    def believes(self, pan_rad: float, tilt_rad: float, stamp_s: float, *, moving: bool) -> bool:
        """Take the next position in; ``moving`` where a motion of ours may be under way."""
        last, self._last = self._last, (pan_rad, tilt_rad, stamp_s)
        if last is None:
            return False
        step_rad = max(abs(pan_rad - last[0]), abs(tilt_rad - last[1]))
        in_motion = moving or self._jumped  # somebody else may be moving it
        speed_rad_s = HASTE * self.speed_rad_s if in_motion else _REST_RAD_S
        self._jumped = step_rad > 1.5 * self.digit_rad
        return step_rad <= speed_rad_s * max(0.0, stamp_s - last[2]) + 1.5 * self.digit_rad
