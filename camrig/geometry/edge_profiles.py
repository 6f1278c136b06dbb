"""Where a tag's edges cross grey profiles drawn across them, to a hundredth of a pixel. Compiled; one tag at a time.

Across an edge the grey value is ``middle + step (Phi((x - shift) / sigma) - 1/2)``: two levels, blurred by optics and
pixels. Linear in middle, step and step times shift, so each is what one fixed filter makes of a profile. The filter of
the shift is even and the blur's effect odd: a wrong sigma costs precision and moves nothing.

The levels of one profile are noisy where it is short, and a wrong level moves the edge. A tag is printed in one black
on one white, so its levels are taken from all its edges together: a plane each over the tag, for light that falls off
to one side. Where that is not so (a shadow, a reflection), the edge's profiles are each judged by their own.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.jit import compiled

Flags = npt.NDArray[np.bool_]

SAMPLES = 11
"""Samples along each profile."""
SIGMAS_PX = (0.6, 0.8, 1.05, 1.4, 1.9, 2.6)
"""Blurs that are told apart: from sharp optics with their pixels to what is too much for a profile of 3 px each way."""
SHARP_PX = 0.8
LEAST_STEP, MOST_STEP = 0.5, 1.5
"""Times the tag's median step between black and white; a profile with less or more shows something else."""
UNEVEN = 0.013
UNEVEN_REACH_PX = 2.0
"""Steps by which levels may scatter about the tag's planes in even light: what sensor noise makes at a reach of 2 px
and more; below that it grows with the square of what the profile lacks (0.05 at 1 px). Photographs ask for no more:
their levels are never quite even, and own levels fit better there where profiles are long enough.
"""
OWN_LEVELS_PX = 1.2
"""A profile must reach this far to tell levels of its own; a shorter one in uneven light tells nothing."""

_SQRT_2, _SQRT_2PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)


@compiled
def cross(
    image: GreyImage, at_px: Array, outward: Array, reach_px: Array, sigma_px: Array, shift_px: Array, seen: Flags
) -> None:
    """Find a tag's edges near (4, n, 2) pixels, looking ``reach_px`` (4,) along unit vectors ``outward`` and against.

    ``sigma_px`` (4,) is the blur of each edge; where it is 0 it is not known yet, and is filled in. Fills ``shift_px``
    (4, n) with how far outwards the edge is, ``seen`` with whether each profile shows the edge at all.
    """
    n = at_px.shape[1]
    middle, step, bent, on_slope = np.empty((4, n)), np.empty((4, n)), np.empty((4, n)), np.empty((4, n))
    area, energy = np.empty(4), np.empty(4)
    grey = np.empty((n, SAMPLES))
    for edge in range(4):
        for i in range(n):
            seen[edge, i] = _sample(image, at_px[edge, i], outward[edge, i], reach_px[edge], grey[i])
        if sigma_px[edge] <= 0.0:
            sigma_px[edge] = _blur(grey, reach_px[edge])
        area[edge], energy[edge] = _fit(
            grey, reach_px[edge], sigma_px[edge], middle[edge], step[edge], bent[edge], on_slope[edge]
        )
    usual = upper_median(step.ravel())
    for edge in range(4):
        for i in range(n):
            contrast = step[edge, i] / usual if abs(usual) > 1.0 else 0.0
            seen[edge, i] &= LEAST_STEP < contrast < MOST_STEP
    plane_middle, plane_step = np.empty((4, n)), np.empty((4, n))
    _plane(at_px, middle, seen, plane_middle)
    _plane(at_px, step, seen, plane_step)
    for edge in range(4):
        uneven, count = 0.0, 0
        for i in range(n):
            if seen[edge, i]:
                uneven += (middle[edge, i] - plane_middle[edge, i]) ** 2
                count += 1
        most = UNEVEN * max(1.0, (UNEVEN_REACH_PX / reach_px[edge]) ** 2) * usual
        even = uneven <= most * most * count
        for i in range(n):
            level, known = step[edge, i], bent[edge, i]
            if even:
                level = plane_step[edge, i]
                known = (on_slope[edge, i] - plane_middle[edge, i] * area[edge]) / energy[edge]
            shift_px[edge, i] = -known / level if abs(level) > 1.0 else 0.0
            within = abs(shift_px[edge, i]) <= reach_px[edge]
            seen[edge, i] &= within and (even or reach_px[edge] >= OWN_LEVELS_PX)


@compiled
def upper_median(values: Array) -> float:
    """Return the median of (n,) values; of an even number, the larger middle one."""
    half = len(values) // 2
    return np.partition(values, half)[half]  # type: ignore[no-any-return]


@compiled
def _sample(image: GreyImage, at_px: Array, outward: Array, reach_px: float, grey: Array) -> bool:
    """Fill ``grey`` (SAMPLES,) with bilinear values along a profile; tell whether all of it lies in the picture.

    Not by cv2.remap, which rounds places to 1/32 px and values to whole grey levels.
    """
    height, width = image.shape
    inside = True
    for j in range(SAMPLES):
        offset = reach_px * (2.0 * j / (SAMPLES - 1) - 1.0)
        x, y = at_px[0] + offset * outward[0], at_px[1] + offset * outward[1]
        if not (0.0 <= x < width - 1.0 and 0.0 <= y < height - 1.0):  # NaN too
            inside = False
            x = min(max(x, 0.0), width - 1.001) if x == x else 0.0  # noqa: PLR0124
            y = min(max(y, 0.0), height - 1.001) if y == y else 0.0  # noqa: PLR0124
        column, row = int(x), int(y)
        right, down = x - column, y - row
        upper = image[row, column] + right * (float(image[row, column + 1]) - image[row, column])
        lower = image[row + 1, column] + right * (float(image[row + 1, column + 1]) - image[row + 1, column])
        grey[j] = upper + down * (lower - upper)
    return inside


@compiled
def _model(reach_px: float, sigma_px: float, rise: Array, slope: Array) -> tuple[float, float, float]:
    """Fill in (SAMPLES,) what profiles are made of beside a level: ``rise``, the step about its middle, and ``slope``,
    the step's derivative; return the sums of slope, of its squares, and of rise's squares.

    On samples at both sides alike, 1 and slope are even and rise is odd, so that it goes by itself.
    """
    area, energy, rise_energy = 0.0, 0.0, 0.0
    for j in range(SAMPLES):
        z = reach_px * (2.0 * j / (SAMPLES - 1) - 1.0) / sigma_px
        rise[j], slope[j] = 0.5 * math.erf(z / _SQRT_2), math.exp(-0.5 * z * z) / (_SQRT_2PI * sigma_px)
        area += slope[j]
        energy += slope[j] * slope[j]
        rise_energy += rise[j] * rise[j]
    return area, energy, rise_energy


@compiled
def _fit(
    grey: Array, reach_px: float, sigma_px: float, middle: Array, step: Array, bent: Array, on_slope: Array
) -> tuple[float, float]:
    """Fill in (n,) the middle level, the step, minus the step times the shift of (n, SAMPLES) profiles, by least
    squares, and what each has along the model's slope; return the sums of that slope and of its squares.
    """
    rise, slope = np.empty(SAMPLES), np.empty(SAMPLES)
    area, energy, rise_energy = _model(reach_px, sigma_px, rise, slope)
    det = SAMPLES * energy - area * area
    for i in range(len(grey)):
        total, along_slope, along_rise = 0.0, 0.0, 0.0
        for j in range(SAMPLES):
            total += grey[i, j]
            along_slope += grey[i, j] * slope[j]
            along_rise += grey[i, j] * rise[j]
        middle[i], step[i] = (energy * total - area * along_slope) / det, along_rise / rise_energy
        bent[i], on_slope[i] = (SAMPLES * along_slope - area * total) / det, along_slope
    return area, energy


@compiled
def _blur(grey: Array, reach_px: float) -> float:
    """Return the sigma that explains the mean of an edge's (n, SAMPLES) profiles best."""
    mean = np.zeros((1, SAMPLES))
    for i in range(len(grey)):
        for j in range(SAMPLES):
            mean[0, j] += grey[i, j] / len(grey)
    middle, step, bent, on_slope = np.empty(1), np.empty(1), np.empty(1), np.empty(1)
    rise, slope = np.empty(SAMPLES), np.empty(SAMPLES)
    best, least = SHARP_PX, np.inf
    for sigma_px in SIGMAS_PX:
        _model(reach_px, sigma_px, rise, slope)
        _fit(mean, reach_px, sigma_px, middle, step, bent, on_slope)
        rest = 0.0
        for j in range(SAMPLES):
            rest += (mean[0, j] - middle[0] - step[0] * rise[j] - bent[0] * slope[j]) ** 2
        if rest < least:
            best, least = sigma_px, rest
    return best


@compiled
def _plane(at_px: Array, level: Array, seen: Flags, plane: Array) -> None:
    """Fit a plane over the tag to a level (4, n) where profiles show their edge; fill in what it is at each, (4, n)."""
    n = level.shape[1]
    count, x0, y0, level0 = 1e-300, 0.0, 0.0, 0.0
    for k in range(4 * n):
        if seen[k // n, k % n]:
            count += 1.0
            x0 += at_px[k // n, k % n, 0]
            y0 += at_px[k // n, k % n, 1]
            level0 += level[k // n, k % n]
    x0, y0, level0 = x0 / count, y0 / count, level0 / count
    xx, xy, yy, xl, yl = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(4 * n):
        if seen[k // n, k % n]:
            dx, dy = at_px[k // n, k % n, 0] - x0, at_px[k // n, k % n, 1] - y0
            rise = level[k // n, k % n] - level0
            xx, xy, yy, xl, yl = xx + dx * dx, xy + dx * dy, yy + dy * dy, xl + dx * rise, yl + dy * rise
    det = xx * yy - xy * xy
    flat = det <= 1e-9 * (xx + yy) ** 2  # profiles of one edge alone: no plane
    along_x, along_y = (0.0, 0.0) if flat else ((yy * xl - xy * yl) / det, (xx * yl - xy * xl) / det)
    for k in range(4 * n):
        dx, dy = at_px[k // n, k % n, 0] - x0, at_px[k // n, k % n, 1] - y0
        plane[k // n, k % n] = level0 + along_x * dx + along_y * dy
