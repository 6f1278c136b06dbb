"""What a lens's calibration may be off by (focal length, centre, first coefficient), and where it shows."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens.fisheye import FisheyeLens
from camrig.geometry.lens.interface import Lens

LensSigma = tuple[float, float, float, float]

TYPICAL_SIGMA: LensSigma = (0.0006, 0.4, 0.4, 0.0005)
"""One sigma of [relative focal length, cx px, cy px, k1] that a good calibration leaves (docs/accuracy.md)."""


def error_slopes(lens: Lens, ideal: Array) -> Array:
    """Return (..., 2, 4): how the pixel of an (..., 2) ideal point moves with [d f / f, d cx, d cy, d k1]."""
    slopes = np.zeros((*ideal.shape[:-1], 2, 4))
    focal = np.asarray(lens.focal_px)
    slopes[..., 0] = focal * lens.distort(ideal)
    slopes[..., 0, 1] = slopes[..., 1, 2] = 1.0
    slopes[..., 3] = focal * ideal * _bend(lens, ideal)[..., None]
    return slopes


def _bend(lens: Lens, ideal: Array) -> Array:
    """Return by what part of an ideal point's radius its sensor point moves with k1."""
    r2 = (ideal * ideal).sum(axis=-1)
    if not isinstance(lens, FisheyeLens):
        return np.asarray(r2)
    r = np.sqrt(r2)
    return np.asarray(np.arctan(r) ** 3 / np.maximum(r, 1e-9))
