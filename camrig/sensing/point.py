"""Quality models of a point: the paper's pixel Q, and a perspective one that knows no lens. Compiled, pure.

A *gain* is 1/Q in 1/m: what cameras add up. Points are in the camera's optical frame, in metres, in front of it.
"""

from __future__ import annotations

import math

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens_row import FX, FY, curvatures_at, slopes_at


@compiled
def pixel_gain(lens: Array, x: float, y: float, z: float) -> float:
    """Return 1/Q of the paper: f / Z over q_d = J11 J22 / det(J)^2 (sensing.quality says why that way round)."""
    ua, ub, va, vb = slopes_at(lens, x / z, y / z)
    det = ua * vb - ub * va
    return math.sqrt(lens[FX] * lens[FY]) * det * det / (z * ua * vb)


@compiled
def pixel_gain_slopes(lens: Array, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return 1/Q and its derivatives by x, y and z."""
    a, b = x / z, y / z
    ua, ub, va, vb = slopes_at(lens, a, b)
    uaa, uab, ubb, vaa, vab, vbb = curvatures_at(lens, a, b)
    det = ua * vb - ub * va
    gain = math.sqrt(lens[FX] * lens[FY]) * det * det / (z * ua * vb)
    det_a = uaa * vb + ua * vab - uab * va - ub * vaa
    det_b = uab * vb + ua * vbb - ubb * va - ub * vab
    by_a = gain * (2.0 * det_a / det - uaa / ua - vab / vb)
    by_b = gain * (2.0 * det_b / det - uab / ua - vbb / vb)
    return gain, by_a / z, by_b / z, -(gain + a * by_a + b * by_b) / z


@compiled
def perspective_gain(lens: Array, x: float, y: float, z: float) -> float:
    """Return f cos(beta) / distance: distance and angle off the axis alone, in the manner of Arslan et al. (2018)."""
    return math.sqrt(lens[FX] * lens[FY]) * z / (x * x + y * y + z * z)


@compiled
def perspective_gain_slopes(lens: Array, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the perspective gain and its derivatives by x, y and z."""
    square = x * x + y * y + z * z
    gain = math.sqrt(lens[FX] * lens[FY]) * z / square
    return gain, -2.0 * gain * x / square, -2.0 * gain * y / square, gain / z - 2.0 * gain * z / square
