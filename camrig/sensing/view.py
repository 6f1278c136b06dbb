"""What a camera sees: the paper's cone, or the true distorted image rectangle. Compiled, pure.

Each is a *clearance* (>= 0 is visible), smooth enough for a solver's constraints. Points are in the camera's optical
frame, in metres; ``margin_rad`` shrinks what counts as visible.
"""

from __future__ import annotations

import math

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import ALPHA, CX, CY, FX, FY, HEIGHT, R_MAX, WIDTH, sensor_at, slopes_at

ANGLE_SLACK_RAD = 1e-9
"""A target exactly on the edge of view counts as seen; optima sit there."""

PIXEL_SLACK = 1e-6
_BISECTIONS = 30


@compiled
def cone_clearance(lens: Array, x: float, y: float, z: float, margin_rad: float) -> float:
    """Return how far inside the cone a point is, in radians. ``r_max`` bounds the cone too."""
    beta = math.atan2(math.hypot(x, y), z)
    return float(min(lens[ALPHA], math.atan(lens[R_MAX])) - margin_rad - beta)


@compiled
def image_clearance(
    lens: Array, x: float, y: float, z: float, margin_rad: float
) -> tuple[float, float, float, float, float]:
    """Return the pixels that a point is inside the left, right, upper and lower edge and inside ``r_max``.

    The image spans [0, width] x [0, height] pixels. The margin is an angle: by first order it takes
    ``margin_rad`` |d pixel / d angle| from every edge, with the lens's own scale at that place. -inf behind.
    """
    if z <= 0.0:
        return -math.inf, -math.inf, -math.inf, -math.inf, -math.inf
    a, b = x / z, y / z
    radius = math.hypot(a, b)
    rim = (lens[R_MAX] - radius) * lens[FX]
    if margin_rad != 0.0:
        rim = (math.tan(math.atan(lens[R_MAX]) - margin_rad) - radius) * lens[FX]
    if radius > 2.0 * lens[R_MAX]:  # a polynomial lens is meaningless there, and the rim has long said no
        a, b = a * 2.0 * lens[R_MAX] / radius, b * 2.0 * lens[R_MAX] / radius
    u, v = sensor_at(lens, a, b)
    across, down = lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
    inset_x, inset_y = 0.0, 0.0
    if margin_rad != 0.0:
        # On the sphere a step of one radian at (a, b) moves (a, b) by sqrt(1 + r^2) (I + (a b)^T (a b))^(1/2), so the
        # squared length of a pixel coordinate's gradient g is (1 + r^2) (|g|^2 + (g . (a, b))^2).
        ua, ub, va, vb = slopes_at(lens, a, b)
        stretch = 1.0 + a * a + b * b
        inset_x = margin_rad * lens[FX] * math.sqrt(stretch * (ua * ua + ub * ub + (ua * a + ub * b) ** 2))
        inset_y = margin_rad * lens[FY] * math.sqrt(stretch * (va * va + vb * vb + (va * a + vb * b) ** 2))
    return across - inset_x, lens[WIDTH] - across - inset_x, down - inset_y, lens[HEIGHT] - down - inset_y, rim


@compiled
def in_cone(lens: Array, x: float, y: float, z: float, margin_rad: float) -> bool:
    """Tell whether the cone holds a point."""
    return cone_clearance(lens, x, y, z, margin_rad) >= -ANGLE_SLACK_RAD


@compiled
def in_image(lens: Array, x: float, y: float, z: float, margin_rad: float) -> bool:
    """Tell whether a point falls on the true distorted image, within ``r_max``."""
    left, right, above, below, rim = image_clearance(lens, x, y, z, margin_rad)
    return min(left, right, above, below, rim) >= -PIXEL_SLACK


@compiled
def side_angles(lens: Array) -> tuple[float, float, float, float]:
    """Return the angles off the axis at which the picture ends to the left, to the right, above and below."""
    return (
        _side_angle(lens, -1.0, 0.0),
        _side_angle(lens, 1.0, 0.0),
        _side_angle(lens, 0.0, -1.0),
        _side_angle(lens, 0.0, 1.0),
    )


@compiled
def _side_angle(lens: Array, x: float, y: float) -> float:
    low, high = 0.0, math.atan(lens[R_MAX])
    for _ in range(_BISECTIONS):
        angle = (low + high) / 2.0
        if in_image(lens, x * math.sin(angle), y * math.sin(angle), math.cos(angle), 0.0):
            low = angle
        else:
            high = angle
    return low
