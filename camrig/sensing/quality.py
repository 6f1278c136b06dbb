"""The paper's sensing quality Q = q_p q_d in metres per pixel: smaller is better. Vectorised, pure.

Source: Zhang et al., "Toward Global Sensing Quality Maximization: A Configuration Optimization Scheme for Camera
Networks": perspective, distortion, and the harmonic fusion of several cameras.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens


def q_p(lens: Lens, depth_m: Array) -> Array:
    """Return the perspective term Z / f: metres per pixel at the target's depth, f = sqrt(fx fy).

    The paper writes 2 |op| cos(beta) tan(alpha) / w, which is the same at the pinhole half angle of view.
    """
    fx, fy = lens.focal_px
    return np.asarray(depth_m / math.sqrt(fx * fy))


def q_d(lens: Lens, ideal: Array) -> Array:
    """Return the distortion term at (..., 2) ideal points: metres of ideal image per metre of sensor image, by axis.

    The paper multiplies the partials d ideal_x / d sensor_x and d ideal_y / d sensor_y. A lens here maps ideal to
    sensor, so with J = d sensor / d ideal these are the diagonal of J^-1: q_d = J11 J22 / det(J)^2, above 1 where the
    lens squeezes. The product of J's own diagonal would be below 1 there and would reward the edge of the image.
    """
    J = lens.jacobian(ideal)
    across, down = J[..., 0, 0], J[..., 1, 1]
    det = across * down - J[..., 0, 1] * J[..., 1, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(across * down / (det * det))


def pixel_quality(lens: Lens, points_camera: Array) -> Array:
    """Return Q = q_p q_d of (..., 3) optical-frame points in metres; infinite at and behind the camera's plane."""
    depth = points_camera[..., 2]
    ahead = depth > 0.0
    ideal = points_camera[..., :2] / np.where(ahead, depth, 1.0)[..., None]
    return np.where(ahead, q_p(lens, depth) * q_d(lens, ideal), np.inf)


def fused(gain: Array) -> Array:
    """Return 1 / sum V/Q over the first axis of (cameras, ...) gains V/Q in 1/m; infinite where nothing sees.

    Harmonic: another camera never makes it worse.
    """
    total = gain.sum(axis=0)
    with np.errstate(divide="ignore"):
        return np.where(total > 0.0, 1.0 / total, np.inf)
