"""How noisy a detector's corners are: one sigma in pixels from the tag's size in the picture and its place.

A law for library corners (no refinement through the lens), fitted to what was measured with rendered tag36h11 through
a lens with k1 = -0.336 at f = 828 px, PSF 0.7 px, noise 4 grey levels:

- noise proper: 0.06 px for tags of 25 to 60 px, growing as 1/width for smaller ones;
- the bend: the lens bends an edge of ``width`` pixels by a sagitta of |k1| r width^2 / (4 f) and the detector fits a
  straight line to it, which moves a corner by 2/3 of that. Measured: 0.07 to 0.29 px at 60 to 90 px, 0.16 to 0.40 px
  above. A straighter lens bends less: there the law errs on the safe side.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array

_NOISE_PX = 0.06
_SMALL_TAG_PX2 = 2.0
_BEND_PER_PX = (2.0 / 3.0) * 0.336 / (4.0 * 828.0)


def corner_sigma_px(width_px: Array, radius: Array) -> Array:
    """Return one sigma per pixel coordinate of tags ``width_px`` wide, ``radius`` = tan(off-axis angle); any shape."""
    noise = np.maximum(_NOISE_PX, _SMALL_TAG_PX2 / np.maximum(width_px, 1.0))
    return np.hypot(noise, _BEND_PER_PX * radius * width_px * width_px)


def tag_width_px(corners_px: Array) -> Array:
    """Return the root of the area of tags with (..., 4, 2) corners: their width, for an oblique one the mean width."""
    x, y = corners_px[..., 0], corners_px[..., 1]
    twice_area = (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1)
    return np.asarray(np.sqrt(np.abs(twice_area) / 2.0))
