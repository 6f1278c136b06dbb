"""Brown-Conrady with rational radial part, tangential and thin-prism terms, in OpenCV's order.

Source: OpenCV calib3d, "Detailed description": (k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array, Coefficients, Numbers
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
        return np.stack(brown_sensor(self.distortion, ideal[..., 0], ideal[..., 1]), axis=-1)

    def jacobian(self, ideal: Array) -> Array:
        return pinhole.matrix(ideal, brown_slopes(self.distortion, ideal[..., 0], ideal[..., 1]))

    def undistort(self, sensor: Array) -> Array:
        return pinhole.undistort(self, self._inverse, sensor)

    def project(self, points_camera: Array) -> Array:
        return pinhole.project(self, points_camera)

    def unproject(self, pixels: Array) -> Array:
        return pinhole.unproject(self, pixels)


# The formulas, for numbers and for arrays alike (geometry.jit); k holds the twelve coefficients in OpenCV's order.


def brown_sensor(k: Coefficients, a: Numbers, b: Numbers) -> tuple[Numbers, Numbers]:
    """Return the sensor coordinates (u, v) of ideal (a, b)."""
    r2 = a * a + b * b
    g = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    u = a * g + 2.0 * k[2] * a * b + k[3] * (r2 + 2.0 * a * a) + r2 * (k[8] + k[9] * r2)
    v = b * g + k[2] * (r2 + 2.0 * b * b) + 2.0 * k[3] * a * b + r2 * (k[10] + k[11] * r2)
    return u, v


def brown_slopes(k: Coefficients, a: Numbers, b: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return du/da, du/db, dv/da, dv/db."""
    r2 = a * a + b * b
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    g = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / below
    g1 = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]) - g * (k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7]))) / below
    cross = a * b * g1 + 2.0 * (k[2] * a + k[3] * b)
    prism_u, prism_v = 2.0 * (k[8] + 2.0 * k[9] * r2), 2.0 * (k[10] + 2.0 * k[11] * r2)
    ua = g + a * a * g1 + 2.0 * k[2] * b + 6.0 * k[3] * a + a * prism_u
    vb = g + b * b * g1 + 6.0 * k[2] * b + 2.0 * k[3] * a + b * prism_v
    return ua, cross + b * prism_u, cross + a * prism_v, vb


def brown_curvatures(
    k: Coefficients, a: Numbers, b: Numbers
) -> tuple[Numbers, Numbers, Numbers, Numbers, Numbers, Numbers]:
    """Return the second derivatives of u by aa, ab, bb, then those of v."""
    r2 = a * a + b * b
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    below1 = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7])
    g = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / below
    by_r2 = (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]) - g * below1) / below
    second = 2.0 * k[1] + r2 * 6.0 * k[4] - 2.0 * by_r2 * below1 - g * (2.0 * k[6] + r2 * 6.0 * k[7])
    g1, g2 = 2.0 * by_r2, 4.0 * second / below
    prism_u, prism_v = 2.0 * (k[8] + 2.0 * k[9] * r2), 2.0 * (k[10] + 2.0 * k[11] * r2)
    aab, abb = b * g1 + a * a * b * g2 + 2.0 * k[2], a * g1 + a * b * b * g2 + 2.0 * k[3]
    uaa = 3.0 * a * g1 + a * a * a * g2 + 6.0 * k[3] + prism_u + 8.0 * k[9] * a * a
    vbb = 3.0 * b * g1 + b * b * b * g2 + 6.0 * k[2] + prism_v + 8.0 * k[11] * b * b
    uab, ubb = aab + 8.0 * k[9] * a * b, abb + prism_u + 8.0 * k[9] * b * b
    vaa, vab = aab + prism_v + 8.0 * k[11] * a * a, abb + 8.0 * k[11] * a * b
    return uaa, uab, ubb, vaa, vab, vbb
