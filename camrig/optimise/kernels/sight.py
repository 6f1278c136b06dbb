"""What a camera sees of targets and anchors from a pose. Compiled."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.airspace import crosses_box
from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import ALPHA, R_MAX, pixel_at
from camrig.optimise.kernels.problem import (
    CONE,
    CORNERS,
    LEAST_FACING,
    MARGIN,
    MIN_TAG_PX,
    NORMAL,
    POINT,
    RANGE,
    REACH,
    ROOM,
    TAGGED,
)
from camrig.sensing.view import ANGLE_SLACK_RAD, in_cone, in_image

NEAR_M = 0.05
"""Nothing nearer in front of a lens counts as seen; keeps Q away from 0."""

_crosses_box = compiled(crosses_box)


@compiled
def to_camera(R: Array, origin: Array, row: Array, at: int) -> tuple[float, float, float]:
    """Return the world point that begins at a column of a row, in the camera's optical frame."""
    dx, dy, dz = row[at] - origin[0], row[at + 1] - origin[1], row[at + 2] - origin[2]
    return (
        R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz,
        R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz,
        R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz,
    )


@compiled
def cone_cosine(settings: Array, lens: Array) -> float:
    """Return the cosine of the angle off the axis up to which a point that stays counts as seen under ``cone``."""
    angle_rad = min(lens[ALPHA], math.atan(lens[R_MAX])) - settings[MARGIN] + ANGLE_SLACK_RAD
    if angle_rad <= 0.0:
        return 2.0
    return max(math.cos(angle_rad), 0.0)


@compiled
def sees(settings: Array, boxes: Array, lens: Array, cosine: float, R: Array, origin: Array, target: Array) -> bool:
    """Tell whether a target or an anchor (a row) is seen: in view with its margin, near enough, from its front, large
    enough for the detector, and nothing in the way. ``cosine`` is ``cone_cosine``.
    """
    x, y, z = to_camera(R, origin, target, POINT)
    if z <= NEAR_M:
        return False
    distance2 = x * x + y * y + z * z
    if distance2 > settings[RANGE] ** 2:
        return False
    if settings[CONE] > 0.0:
        if z * z < cosine * cosine * distance2:
            return False
        if target[REACH] > 0.0 and not in_cone(lens, x, y, z, settings[MARGIN] + math.atan(target[REACH] / z)):
            return False
    elif not _in_picture(settings, lens, R, origin, target, x, y, z):
        return False
    if target[TAGGED] > 0.0 and not _readable(settings, lens, R, origin, target):
        return False
    for b in range(len(boxes)):  # an index: what a loop over an array yields has no known layout, and compiles anew
        if _crosses_box(origin, target, boxes[b, 0], boxes[b, 1]):
            return False
    return True


@compiled
def _in_picture(
    settings: Array, lens: Array, R: Array, origin: Array, target: Array, x: float, y: float, z: float
) -> bool:
    """Tell whether the whole of a target, centre at (x, y, z) in the camera's frame, is in the picture."""
    if target[TAGGED] <= 0.0:
        return in_image(lens, x, y, z, settings[MARGIN])
    if not in_image(lens, x, y, z, min(settings[MARGIN], 0.0)):
        return False
    for k in range(4):
        x, y, z = to_camera(R, origin, target, ROOM + 3 * k)
        if not in_image(lens, x, y, z, settings[MARGIN]):
            return False
    return True


@compiled
def _readable(settings: Array, lens: Array, R: Array, origin: Array, target: Array) -> bool:
    """Tell whether a tag is seen from its front, not too flat, and large enough for the detector."""
    facing, distance2 = 0.0, 0.0
    for k in range(3):
        back = origin[k] - target[POINT + k]
        facing += back * target[NORMAL + k]
        distance2 += back * back
    if facing <= settings[LEAST_FACING] * math.sqrt(distance2):
        return False
    return bool(settings[MIN_TAG_PX] <= 0.0 or _narrow_side_px(lens, R, origin, target) >= settings[MIN_TAG_PX])


@compiled
def _narrow_side_px(lens: Array, R: Array, origin: Array, target: Array) -> float:
    """Return the shorter of a tag's two mean sides in the picture; 0 where a corner is behind the camera."""
    pixels = np.empty((4, 2))
    for k in range(4):
        x, y, z = to_camera(R, origin, target, CORNERS + 3 * k)
        if z <= 0.0:
            return 0.0
        pixels[k, 0], pixels[k, 1] = pixel_at(lens, x, y, z)
    sides = np.empty(4)
    for k in range(4):
        before = (k + 3) % 4
        sides[k] = math.hypot(pixels[k, 0] - pixels[before, 0], pixels[k, 1] - pixels[before, 1])
    return float(min(sides[0] + sides[2], sides[1] + sides[3]) / 2.0)
