"""OpenCV's fisheye (equidistant, Kannala-Brandt): theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8).

Source: OpenCV calib3d, namespace ``fisheye``. Ideal coordinates reach less than 90 degrees off the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array, Coefficients, Numbers
from camrig.geometry.lens import pinhole

R_MAX_FISHEYE = 11.43
"""tan(85 deg): a fisheye sees far past an ordinary lens's sqrt(2)."""


@dataclass(frozen=True, slots=True, eq=False)
class FisheyeLens:
    """OpenCV's fisheye; ``r_max`` None means the smaller of tan(85 deg) and where it stops being one-to-one."""

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    r_max: float = None  # type: ignore[assignment]  # filled in below, never None outside
    _inverse: pinhole.InverseTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if len(self.distortion) != 4:
            raise InputError(f"a fisheye's distortion has 4 numbers, not {len(self.distortion)}")
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        if self.r_max is None:
            object.__setattr__(self, "r_max", pinhole.one_to_one_radius(self, R_MAX_FISHEYE))
        object.__setattr__(self, "_inverse", pinhole.inverse_table(self))

    def distort(self, ideal: Array) -> Array:
        return np.stack(fisheye_sensor(self.distortion, ideal[..., 0], ideal[..., 1]), axis=-1)

    def jacobian(self, ideal: Array) -> Array:
        return pinhole.matrix(ideal, fisheye_slopes(self.distortion, ideal[..., 0], ideal[..., 1]))

    def undistort(self, sensor: Array) -> Array:
        return pinhole.undistort(self, self._inverse, sensor)

    def project(self, points_camera: Array) -> Array:
        return pinhole.project(self, points_camera)

    def unproject(self, pixels: Array) -> Array:
        return pinhole.unproject(self, pixels)


# The formulas, for numbers and for arrays alike (geometry.jit); k holds k1..k4.

_NEAR_AXIS = 1e-6
_NEAR_AXIS_CURVED = 0.02
"""Within these radii a series replaces quotients that lose their digits."""


def fisheye_sensor(k: Coefficients, a: Numbers, b: Numbers) -> tuple[Numbers, Numbers]:
    """Return the sensor coordinates (u, v) of ideal (a, b)."""
    r = np.hypot(a, b)
    t = np.arctan(r)
    t2 = t * t
    theta_d = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    scale = np.where(r < _NEAR_AXIS, 1.0, theta_d / np.maximum(r, _NEAR_AXIS))
    return a * scale, b * scale


def fisheye_slopes(k: Coefficients, a: Numbers, b: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return du/da, du/db, dv/da, dv/db."""
    r = np.hypot(a, b)
    t = np.arctan(r)
    t2 = t * t
    safe = np.maximum(r, _NEAR_AXIS)
    theta_d = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    first = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
    scale = np.where(r < _NEAR_AXIS, 1.0, theta_d / safe)
    slope = np.where(r < _NEAR_AXIS, 2.0 * (k[0] - 1.0 / 3.0), (first / (1.0 + r * r) - scale) / (safe * safe))
    cross = a * b * slope
    return scale + a * a * slope, cross, cross, scale + b * b * slope


def fisheye_curvatures(
    k: Coefficients, a: Numbers, b: Numbers
) -> tuple[Numbers, Numbers, Numbers, Numbers, Numbers, Numbers]:
    """Return the second derivatives of u by aa, ab, bb, then those of v."""
    r = np.hypot(a, b)
    safe = np.maximum(r, _NEAR_AXIS_CURVED)
    t = np.arctan(safe)
    t2 = t * t
    scale = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / safe
    first = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
    second = t * (6.0 * k[0] + t2 * (20.0 * k[1] + t2 * (42.0 * k[2] + t2 * 72.0 * k[3])))
    slope = (first / (1.0 + safe * safe) - scale) / (safe * safe)
    steep = (second - 2.0 * safe * first) / ((1.0 + safe * safe) ** 2 * safe**3) - 3.0 * slope / (safe * safe)
    # theta_d / r = 1 + (k1 - 1/3) r^2 + (1/5 - k1 + k2) r^4 + ...
    fourth = 0.2 - k[0] + k[1]
    flat1, flat2 = 2.0 * (k[0] - 1.0 / 3.0) + 4.0 * fourth * r * r, 8.0 * fourth
    g1, g2 = np.where(r < _NEAR_AXIS_CURVED, flat1, slope), np.where(r < _NEAR_AXIS_CURVED, flat2, steep)
    aab, abb = b * g1 + a * a * b * g2, a * g1 + a * b * b * g2
    return 3.0 * a * g1 + a * a * a * g2, aab, abb, aab, abb, 3.0 * b * g1 + b * b * b * g2
