"""What each firmware reads from a SET_POSITION_TARGET_LOCAL_NED: frames and masks differ between the two."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig_emulators.mavlink.cockpit import Cockpit
from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.frames import swap, swap_yaw

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9  # MAV_FRAME
ARDUPILOT_FRAMES = (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED)
PX4_FRAMES = (LOCAL_NED, BODY_NED)

_POSITION_BITS, _VELOCITY_BITS, _ACCELERATION_BITS = (
    (0x001, 0x002, 0x004),
    (0x008, 0x010, 0x020),
    (0x040, 0x080, 0x100),
)
_FORCE = 0x200
_IGNORE_YAW, _IGNORE_YAW_RATE = 0x400, 0x800
# position, velocity, acceleration: what ArduCopter has a controller for
_ARDUPILOT_COMBINATIONS = {
    (True, False, False),
    (True, True, False),
    (True, True, True),
    (False, True, False),
    (False, True, True),
    (False, False, True),
}


@dataclass(frozen=True, slots=True, eq=False)
class SetPoint:
    """The message as it came; triples (3,) in its own frame."""

    coordinate_frame: int
    type_mask: int
    position: Array
    velocity: Array
    acceleration: Array
    yaw_rad: float
    yaw_rate_rad_s: float

    @property
    def has_yaw(self) -> bool:
        """Whether the mask lets the yaw count."""
        return not self.type_mask & _IGNORE_YAW

    @property
    def has_yaw_rate(self) -> bool:
        """Whether the mask lets the yaw rate count."""
        return not self.type_mask & _IGNORE_YAW_RATE


def ardupilot_goal(point: SetPoint, cockpit: Cockpit, kept_yaw_rad: float) -> Demand | None:
    """Return what ArduCopter flies then; None where it stops instead: a frame, mask or number it does not take.

    Any ignored axis drops its whole triple.
    """
    positioned = not point.type_mask & sum(_POSITION_BITS)
    moving = not point.type_mask & sum(_VELOCITY_BITS)
    pushed = not point.type_mask & sum(_ACCELERATION_BITS)
    numbers = [*point.position] * positioned + [*point.velocity] * moving + [*point.acceleration] * pushed
    numbers += [point.yaw_rad] * point.has_yaw + [point.yaw_rate_rad_s] * point.has_yaw_rate
    known = point.coordinate_frame in ARDUPILOT_FRAMES and not point.type_mask & _FORCE
    combined = (positioned, moving, pushed) in _ARDUPILOT_COMBINATIONS
    if not known or not combined or not np.all(np.isfinite(numbers)):
        return None
    goal = Demand(yaw_rad=kept_yaw_rad)
    if point.has_yaw:
        relative = point.coordinate_frame in {BODY_NED, BODY_OFFSET_NED}
        goal = Demand(yaw_rad=cockpit.yaw_rad - point.yaw_rad if relative else swap_yaw(point.yaw_rad))
    elif point.has_yaw_rate:
        goal = Demand(yaw_rate_rad_s=-point.yaw_rate_rad_s)
    if positioned:
        goal = replace(goal, position_m=_ardupilot_place(point, cockpit))
    if moving:
        goal = replace(goal, velocity_m_s=_ardupilot_vector(point, cockpit, point.velocity))
    if pushed:
        goal = replace(goal, acceleration_m_s2=_ardupilot_vector(point, cockpit, point.acceleration))
    return goal


def px4_goal(point: SetPoint, cockpit: Cockpit, kept_yaw_rad: float) -> Demand | None:
    """Return what PX4 flies then; None where the set-point holds nothing. Each axis may be ignored singly."""
    position = _masked(point.position, point.type_mask, _POSITION_BITS)
    velocity = _masked(point.velocity, point.type_mask, _VELOCITY_BITS)
    acceleration = _masked(point.acceleration, point.type_mask, _ACCELERATION_BITS)
    if point.coordinate_frame == BODY_NED:  # its position is ignored
        position = np.full(3, np.nan)
        if not np.all(np.isnan(velocity)):
            velocity = swap(_from_body(cockpit, np.nan_to_num(velocity, nan=0.0)))
        if not np.all(np.isnan(acceleration)):
            acceleration = swap(_from_body(cockpit, np.nan_to_num(acceleration, nan=0.0)))
    if np.all(np.isnan([position, velocity, acceleration])):
        return None
    goal = Demand(cockpit.frame.to_world(position), swap(velocity), swap(acceleration), yaw_rad=kept_yaw_rad)
    if point.has_yaw and math.isfinite(point.yaw_rad):
        return replace(goal, yaw_rad=swap_yaw(point.yaw_rad))
    if point.has_yaw_rate and math.isfinite(point.yaw_rate_rad_s):
        return replace(goal, yaw_rad=math.nan, yaw_rate_rad_s=-point.yaw_rate_rad_s)
    return goal


def _ardupilot_place(point: SetPoint, cockpit: Cockpit) -> Array:
    if point.coordinate_frame == LOCAL_NED:
        return cockpit.frame.to_world(point.position)
    return np.asarray(cockpit.sample.position_m + _ardupilot_vector(point, cockpit, point.position))


def _ardupilot_vector(point: SetPoint, cockpit: Cockpit, vector: Array) -> Array:
    if point.coordinate_frame in {LOCAL_NED, LOCAL_OFFSET_NED}:
        return swap(vector)
    return _from_body(cockpit, vector)


def _from_body(cockpit: Cockpit, forward_right_down: Array) -> Array:
    """Turn a vector along the heading into the world."""
    forward, right, down = forward_right_down
    c, s = math.cos(cockpit.yaw_rad), math.sin(cockpit.yaw_rad)
    return np.array([c * forward + s * right, s * forward - c * right, -down])


def _masked(values: Array, type_mask: int, bits: tuple[int, int, int]) -> Array:
    ignored = [bool(type_mask & bit) for bit in bits]
    return np.where(ignored | ~np.isfinite(values), np.nan, values)
