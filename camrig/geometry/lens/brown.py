"""Brown-Conrady with rational radial part, tangential and thin-prism terms, in OpenCV's order.

Source: OpenCV calib3d, "Detailed description": (k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import pinhole

_ALLOWED_LENGTHS = (0, 4, 5, 8, 12, 14)


@dataclass(frozen=True, slots=True, eq=False)
class BrownLens:
    """OpenCV's default lens; ``r_max`` None means the smaller of sqrt(2) and where it stops being one-to-one."""

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...] = ()
    r_max: float = None  # type: ignore[assignment]  # filled in below, never None outside
    _inverse: pinhole.InverseTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if len(self.distortion) not in _ALLOWED_LENGTHS:
            raise InputError(f"distortion has {len(self.distortion)} numbers; OpenCV's order takes 4, 5, 8, 12 or 14")
        if any(self.distortion[12:]):
            raise InputError("a tilted sensor (tau_x, tau_y) is not supported; both must be 0")
        full = tuple(float(k) for k in self.distortion[:12])
        object.__setattr__(self, "distortion", full + (0.0,) * (12 - len(full)))
        if self.r_max is None:
            object.__setattr__(self, "r_max", pinhole.one_to_one_radius(self, pinhole.R_MAX_DEFAULT))
        object.__setattr__(self, "_inverse", pinhole.inverse_table(self))

    def distort(self, ideal: Array) -> Array:
        a, b = ideal[..., 0], ideal[..., 1]
        r2 = a * a + b * b
        sensor = np.asarray(ideal * self._radial(r2)[0][..., None])
        p1, p2 = self.distortion[2:4]
        if p1 or p2:
            ab = a * b
            sensor[..., 0] += 2.0 * p1 * ab + p2 * (r2 + 2.0 * a * a)
            sensor[..., 1] += p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * ab
        s1, s2, s3, s4 = self.distortion[8:]
        if s1 or s2 or s3 or s4:
            sensor[..., 0] += r2 * (s1 + s2 * r2)
            sensor[..., 1] += r2 * (s3 + s4 * r2)
        return sensor

    def jacobian(self, ideal: Array) -> Array:
        a, b = ideal[..., 0], ideal[..., 1]
        r2 = a * a + b * b
        g, dg = self._radial(r2)
        slope_a, slope_b = 2.0 * a * dg, 2.0 * b * dg
        J = np.empty((*np.shape(a), 2, 2))
        J[..., 0, 0] = g + a * slope_a
        J[..., 0, 1] = J[..., 1, 0] = a * slope_b
        J[..., 1, 1] = g + b * slope_b
        p1, p2 = self.distortion[2:4]
        if p1 or p2:
            cross = 2.0 * (p1 * a + p2 * b)
            J[..., 0, 0] += 2.0 * p1 * b + 6.0 * p2 * a
            J[..., 0, 1] += cross
            J[..., 1, 0] += cross
            J[..., 1, 1] += 6.0 * p1 * b + 2.0 * p2 * a
        s1, s2, s3, s4 = self.distortion[8:]
        if s1 or s2 or s3 or s4:
            twice_ideal = 2.0 * ideal
            J[..., 0, :] += twice_ideal * (s1 + 2.0 * s2 * r2)[..., None]
            J[..., 1, :] += twice_ideal * (s3 + 2.0 * s4 * r2)[..., None]
        return J

    def undistort(self, sensor: Array) -> Array:
        return pinhole.undistort(self, self._inverse, sensor)

    def project(self, points_camera: Array) -> Array:
        return pinhole.project(self, points_camera)

    def unproject(self, pixels: Array) -> Array:
        return pinhole.unproject(self, pixels)

    def _radial(self, r2: Array) -> tuple[Array, Array]:
        """Return the radial factor g and its derivative by r^2."""
        k1, k2, _, _, k3, k4, k5, k6 = self.distortion[:8]
        numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        d_numerator = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
        d_denominator = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)
        g = numerator / denominator
        return g, (d_numerator - g * d_denominator) / denominator
