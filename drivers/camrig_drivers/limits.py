"""What every head driver holds its set-points to, whatever commands them. Pure."""

from __future__ import annotations

import math

from camrig.errors import InputError
from camrig.rig import Interval

_SLACK_RAD = 1e-9


def check_within(name: str, angle_rad: float, limits_rad: Interval) -> None:
    """Raise InputError for an angle of the axis ``name`` outside its limits (or for NaN)."""
    low_rad, high_rad = limits_rad
    if not low_rad - _SLACK_RAD <= angle_rad <= high_rad + _SLACK_RAD:
        allowed = f"{math.degrees(low_rad):.2f}..{math.degrees(high_rad):.2f}"
        raise InputError(f"{name} {math.degrees(angle_rad):.2f} deg is outside {allowed} deg")
