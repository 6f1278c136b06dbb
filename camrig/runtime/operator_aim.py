"""Where an operator wants a head: both axes inside its limits, or a sentence that says what is allowed. Pure."""

from __future__ import annotations

import math

from camrig.errors import HardwareError, InputError
from camrig.messages import HeadAim
from camrig.rig import Interval
from camrig.runtime.operator_status import View

_SLACK_DEG = 1e-6


def operator_aim(view: View, head: str, pan_deg: float | None, tilt_deg: float | None) -> HeadAim:
    """Return the aim; an axis that is not named stays where an operator has sent it before, or else where it is.

    Raises InputError outside the limits and where neither axis is named, HardwareError where it is not known where an
    axis is that is to stay.
    """
    if pan_deg is None and tilt_deg is None:
        raise InputError(f"where to aim head '{head}'? Give pan_deg, tilt_deg or both")
    spec = view.rig.heads[head]
    stays = view.aimed.get(head) or _present(view, head)
    if stays is None and (pan_deg is None or tilt_deg is None):
        raise HardwareError(f"it is not known where head {head} points now: give both its pan and its tilt")
    return HeadAim(
        _inside("pan", head, pan_deg, spec.pan_limits_rad, stays.pan_rad if stays else 0.0),
        _inside("tilt", head, tilt_deg, spec.tilt_limits_rad, stays.tilt_rad if stays else 0.0),
    )


def _present(view: View, head: str) -> HeadAim | None:
    history = view.state.histories.heads.get(head)
    found = history.at(view.now_s) if history is not None else None
    return None if found is None else HeadAim(float(found.angles_rad[0]), float(found.angles_rad[1]))


def _inside(axis: str, head: str, angle_deg: float | None, limits_rad: Interval, stays_rad: float) -> float:
    """Return the angle in radians; one that only stays is brought within the limits."""
    low_deg, high_deg = map(math.degrees, limits_rad)
    if angle_deg is not None and not low_deg - _SLACK_DEG <= angle_deg <= high_deg + _SLACK_DEG:
        allowed = f"{low_deg:g} to {high_deg:g} deg"
        raise InputError(f"head '{head}' is not moved: {axis} {angle_deg:g} deg is outside its limits, {allowed}")
    wanted_rad = stays_rad if angle_deg is None else math.radians(angle_deg)
    return min(max(wanted_rad, limits_rad[0]), limits_rad[1])
