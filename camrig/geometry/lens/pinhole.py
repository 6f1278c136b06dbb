"""What all lens models share: pixels, the numerical inverse, and how far a model is one-to-one."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens.interface import Lens

R_MAX_DEFAULT = math.sqrt(2.0)
"""Radius tan(beta) beyond which an uncalibrated lens is not trusted (docs: a^2 + b^2 <= 2)."""

_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-12
_RADII = 2048
_DIRECTIONS = 32


def project(lens: Lens, points_camera: Array) -> Array:
    """Map (..., 3) optical-frame points to (..., 2) pixels; NaN behind the camera or past ``r_max``."""
    depth = points_camera[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ideal = points_camera[..., :2] / depth[..., None]
        visible = (depth > 0.0) & (np.hypot(ideal[..., 0], ideal[..., 1]) <= lens.r_max * (1.0 + 1e-12))
    ideal = np.where(visible[..., None], ideal, np.nan)
    return np.asarray(lens.distort(ideal) * np.asarray(lens.focal_px) + np.asarray(lens.centre_px))


def unproject(lens: Lens, pixels: Array) -> Array:
    """Map (..., 2) pixels to (..., 2) ideal coordinates; NaN where there are none."""
    return lens.undistort((pixels - np.asarray(lens.centre_px)) / np.asarray(lens.focal_px))


def undistort(lens: Lens, sensor: Array) -> Array:
    """Invert ``lens.distort`` by Newton's method from a radial first guess; NaN where it has no solution."""
    radii = np.linspace(0.0, lens.r_max, 257)
    spokes = lens.distort(np.stack([radii, np.zeros_like(radii)], axis=-1))
    sensor_radius = np.linalg.norm(sensor, axis=-1)
    guess_radius = np.interp(sensor_radius, np.maximum.accumulate(np.linalg.norm(spokes, axis=-1)), radii)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(sensor_radius > 0.0, guess_radius / sensor_radius, 1.0)
    ideal = sensor * scale[..., None]
    limit = 1.25 * lens.r_max
    for _ in range(_NEWTON_STEPS):
        residual = lens.distort(ideal) - sensor
        if not np.any(np.abs(residual) > _NEWTON_TOLERANCE):
            break
        ideal = ideal - _solve_2x2(lens.jacobian(ideal), residual)
        radius = np.linalg.norm(ideal, axis=-1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal = np.where(radius > limit, ideal * (limit / radius), ideal)
    residual = np.abs(lens.distort(ideal) - sensor).max(axis=-1)
    solved = (residual < 1e-9) & (np.linalg.norm(ideal, axis=-1) <= lens.r_max * (1.0 + 1e-9))
    return np.asarray(np.where(solved[..., None], ideal, np.nan))


def one_to_one_radius(lens: Lens, limit: float) -> float:
    """Return the radius tan(beta), at most ``limit``, up to which ``det d sensor / d ideal`` stays positive."""
    radii = np.linspace(0.0, limit, _RADII)
    angles = np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False)
    points = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    J = lens.jacobian(points)
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    folded = np.flatnonzero((det <= 0.0).any(axis=1))
    return float(radii[max(0, folded[0] - 1)]) if folded.size else limit


def _solve_2x2(J: Array, residual: Array) -> Array:
    a, b, c, d = J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1]
    u, v = residual[..., 0], residual[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.stack([d * u - b * v, a * v - c * u], axis=-1) / (a * d - b * c)[..., None]
    return np.asarray(step)
