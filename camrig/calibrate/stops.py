"""Where heads are sent so that their cameras together look at all that they can reach."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens
from camrig.rig import Interval

MARGIN_RAD = math.radians(1.0)
"""So far from its limits a head is not sent."""

_SHARE = 0.6
"""Of its view a camera is turned from stop to stop, so that most tags are seen from two."""

MOST = 40


def stops_over(pan: Interval, tilt: Interval, lens: Lens) -> list[tuple[float, float]]:
    """Return aims (pan, tilt) in radians that show all within limits, in rows, each begun where the last one ended; no
    more than ``MOST``.
    """
    steps = [
        _SHARE * 2.0 * math.atan(0.5 * size / focal) for size, focal in zip(lens.size_px, lens.focal_px, strict=True)
    ]
    wider = 1.0
    while len(found := _rows(pan, tilt, steps, wider)) > MOST:
        wider *= 1.1
    return found


def _rows(pan: Interval, tilt: Interval, steps: list[float], wider: float) -> list[tuple[float, float]]:
    pans, tilts = (_across(limits, wider * step) for limits, step in zip((pan, tilt), steps, strict=True))
    return [(float(p), float(t)) for k, t in enumerate(tilts) for p in (pans if k % 2 == 0 else pans[::-1])]


def _across(limits: Interval, step: float) -> Array:
    low, high = limits[0] + MARGIN_RAD, limits[1] - MARGIN_RAD
    if low >= high:
        return np.array([0.5 * (limits[0] + limits[1])])
    return np.linspace(low, high, max(2, 1 + math.ceil((high - low) / step)))
