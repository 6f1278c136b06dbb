"""A lens as a row of numbers, and its formulas compiled: what the kernels here, in ``sensing`` and in ``optimise`` use.

A zoom lens is several rows; between two of them everything is interpolated.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.lens.brown import brown_curvatures, brown_sensor, brown_slopes
from camrig.geometry.lens.fisheye import fisheye_curvatures, fisheye_sensor, fisheye_slopes

FX, FY, CX, CY, WIDTH, HEIGHT, R_MAX, ALPHA, IS_FISHEYE, REFINED, COEFFICIENTS = range(11)
SIZE = COEFFICIENTS + 12

_brown_sensor, _fisheye_sensor = compiled(brown_sensor), compiled(fisheye_sensor)
_brown_slopes, _fisheye_slopes = compiled(brown_slopes), compiled(fisheye_slopes)
_brown_curvatures, _fisheye_curvatures = compiled(brown_curvatures), compiled(fisheye_curvatures)


def half_angle(lens: Lens) -> float:
    """Return the paper's half angle of view: atan(w / (2 sqrt(fx fy)))."""
    fx, fy = lens.focal_px
    return math.atan(lens.size_px[0] / (2.0 * math.sqrt(fx * fy)))


def lens_row(lens: Lens, alpha_rad: float | None = None, *, refined: bool = False) -> Array:
    """Return the (SIZE,) row of a lens; ``alpha_rad`` is the half angle of its cone where it is not its own;
    ``refined`` tells whether corners of tags seen by it are refined (geometry.corner_noise).

    Raises InputError for a lens model that the kernels do not know.
    """
    if not isinstance(lens, BrownLens | FisheyeLens):
        raise InputError(f"the kernels know Brown-Conrady and fisheye lenses, not {type(lens).__name__}")
    row = np.zeros(SIZE)
    row[FX], row[FY] = lens.focal_px
    row[CX], row[CY] = lens.centre_px
    row[WIDTH], row[HEIGHT] = lens.size_px
    row[R_MAX] = lens.r_max
    row[ALPHA] = half_angle(lens) if alpha_rad is None else alpha_rad
    row[IS_FISHEYE], row[REFINED] = isinstance(lens, FisheyeLens), refined
    row[COEFFICIENTS : COEFFICIENTS + len(lens.distortion)] = lens.distortion
    return row


def lens_from_row(row: Array) -> Lens:
    """Return the lens of a row."""
    geometry = ((int(row[WIDTH]), int(row[HEIGHT])), (float(row[FX]), float(row[FY])), (float(row[CX]), float(row[CY])))
    distortion, r_max = tuple(row[COEFFICIENTS:].tolist()), float(row[R_MAX])
    if row[IS_FISHEYE] > 0.0:
        return FisheyeLens(*geometry, distortion[:4], r_max)
    return BrownLens(*geometry, distortion, r_max)


@compiled
def sensor_at(lens: Array, a: float, b: float) -> tuple[float, float]:
    """Return sensor (u, v) of ideal (a, b)."""
    if lens[IS_FISHEYE] > 0.0:
        u, v = _fisheye_sensor(lens[COEFFICIENTS:], a, b)
        return float(u), float(v)
    return _brown_sensor(lens[COEFFICIENTS:], a, b)


@compiled
def slopes_at(lens: Array, a: float, b: float) -> tuple[float, float, float, float]:
    """Return du/da, du/db, dv/da, dv/db."""
    if lens[IS_FISHEYE] > 0.0:
        ua, ub, va, vb = _fisheye_slopes(lens[COEFFICIENTS:], a, b)
        return float(ua), float(ub), float(va), float(vb)
    return _brown_slopes(lens[COEFFICIENTS:], a, b)


@compiled
def curvatures_at(lens: Array, a: float, b: float) -> tuple[float, float, float, float, float, float]:
    """Return the second derivatives of u by aa, ab, bb, then those of v."""
    if lens[IS_FISHEYE] > 0.0:
        uaa, uab, ubb, vaa, vab, vbb = _fisheye_curvatures(lens[COEFFICIENTS:], a, b)
        return float(uaa), float(uab), float(ubb), float(vaa), float(vab), float(vbb)
    return _brown_curvatures(lens[COEFFICIENTS:], a, b)


@compiled
def pixel_at(lens: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the pixel of an optical-frame point; far past ``r_max`` that of a point there, in the same direction."""
    a, b = x / z, y / z
    radius = math.hypot(a, b)
    if radius > 2.0 * lens[R_MAX]:  # a polynomial lens is meaningless there, and r_max has long said no
        a, b = a * 2.0 * lens[R_MAX] / radius, b * 2.0 * lens[R_MAX] / radius
    u, v = sensor_at(lens, a, b)
    return lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
