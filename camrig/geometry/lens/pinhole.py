"""What all lens models share: pixels, the numerical inverse, and how far a model is one-to-one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens.interface import Lens

R_MAX_DEFAULT = math.sqrt(2.0)
"""Radius tan(beta) beyond which an uncalibrated lens is not trusted (docs: a^2 + b^2 <= 2)."""

_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-12
_RADII = 2048
_DIRECTIONS = 32


@dataclass(frozen=True, slots=True, eq=False)
class InverseTable:
    """Where Newton's method starts: ideal by sensor radius, (n,), and the sensor radius nothing visible exceeds."""

    sensor_radius: Array
    scale: Array
    reach: float


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


def matrix(ideal: Array, slopes: tuple[Array, Array, Array, Array]) -> Array:
    """Return (..., 2, 2) from du/da, du/db, dv/da, dv/db at (..., 2) points."""
    J = np.empty((*ideal.shape, 2))
    J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1] = slopes
    return J


def inverse_table(lens: Lens) -> InverseTable:
    """Tabulate the lens along one spoke, and how far its disc of radius ``r_max`` reaches on the sensor."""
    radii = np.linspace(0.0, lens.r_max, _RADII)[1:]
    spoke = lens.distort(np.stack([radii, np.zeros_like(radii)], axis=-1))
    sensor_radius = np.maximum.accumulate(np.linalg.norm(spoke, axis=-1))
    rim = lens.distort(lens.r_max * _directions())
    # 1.001: between two directions the rim of a lens with tangential terms bulges a little further.
    reach = 1.001 * float(np.linalg.norm(rim, axis=-1).max())
    return InverseTable(sensor_radius, radii / sensor_radius, reach)


def undistort(lens: Lens, table: InverseTable, sensor: Array) -> Array:
    """Invert ``lens.distort`` by Newton's method from the table's guess; NaN where it has no solution.

    The guess of a lens without tangential terms is right to 1e-7, so one step does.
    """
    sensor_radius = np.hypot(sensor[..., 0], sensor[..., 1])
    scale = np.interp(sensor_radius, table.sensor_radius, table.scale)
    # What lies beyond the rim has no solution; as NaN it keeps no other point waiting.
    ideal = sensor * np.where(sensor_radius <= table.reach, scale, np.nan)[..., None]
    residual = lens.distort(ideal) - sensor
    for _ in range(_NEWTON_STEPS):
        if not np.any(np.abs(residual) > _NEWTON_TOLERANCE):
            break
        ideal = _within(1.25 * lens.r_max, ideal - _solve_2x2(lens.jacobian(ideal), residual))
        residual = lens.distort(ideal) - sensor
    solved = np.abs(residual).max(axis=-1) < 1e-9
    solved &= np.hypot(ideal[..., 0], ideal[..., 1]) <= lens.r_max * (1.0 + 1e-9)
    return np.asarray(np.where(solved[..., None], ideal, np.nan))


def one_to_one_radius(lens: Lens, limit: float) -> float:
    """Return the radius tan(beta), at most ``limit``, up to which ``det d sensor / d ideal`` stays positive."""
    radii = np.linspace(0.0, limit, _RADII)
    J = lens.jacobian(radii[:, None, None] * _directions())
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    folded = np.flatnonzero((det <= 0.0).any(axis=1))
    return float(radii[max(0, folded[0] - 1)]) if folded.size else limit


def _directions() -> Array:
    """Return (n, 2) unit vectors all round."""
    angles = np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _within(limit: float, ideal: Array) -> Array:
    """Pull points that a Newton step threw far out back to the circle of radius ``limit``."""
    radius = np.hypot(ideal[..., 0], ideal[..., 1])
    far = radius > limit
    return (
        np.where(far[..., None], ideal * (limit / np.where(far, radius, 1.0))[..., None], ideal) if far.any() else ideal
    )


def _solve_2x2(J: Array, residual: Array) -> Array:
    a, b, c, d = J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1]
    u, v = residual[..., 0], residual[..., 1]
    step = np.empty_like(residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = a * d - b * c
        step[..., 0] = (d * u - b * v) / det
        step[..., 1] = (a * v - c * u) / det
    return step
