"""OpenCV's fisheye (equidistant, Kannala-Brandt): theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8).

Source: OpenCV calib3d, namespace ``fisheye``. Ideal coordinates reach less than 90 degrees off the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
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
        scale, _ = self._scale(ideal)
        return np.asarray(ideal * scale[..., None])

    def jacobian(self, ideal: Array) -> Array:
        scale, slope = self._scale(ideal)
        outer = ideal[..., :, None] * ideal[..., None, :]
        return np.asarray(scale[..., None, None] * np.eye(2) + slope[..., None, None] * outer)

    def undistort(self, sensor: Array) -> Array:
        return pinhole.undistort(self, self._inverse, sensor)

    def project(self, points_camera: Array) -> Array:
        return pinhole.project(self, points_camera)

    def unproject(self, pixels: Array) -> Array:
        return pinhole.unproject(self, pixels)

    def _scale(self, ideal: Array) -> tuple[Array, Array]:
        """Return theta_d / r, and (d(theta_d / r) / dr) / r."""
        k1, k2, k3, k4 = self.distortion
        r = np.hypot(ideal[..., 0], ideal[..., 1])
        theta = np.arctan(r)
        t2 = theta * theta
        theta_d = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        d_theta_d = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        small = r < 1e-6
        safe = np.where(small, 1.0, r)
        scale = np.where(small, 1.0, theta_d / safe)
        slope = (d_theta_d / (1.0 + r * r) - scale) / (safe * safe)
        # Series at the axis: theta_d / r = 1 + (k1 - 1/3) r^2 + ..., so its slope over r is 2 (k1 - 1/3).
        return scale, np.where(small, 2.0 * (k1 - 1.0 / 3.0), slope)
