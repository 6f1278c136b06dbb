"""How noisy a detector's corners are: one sigma in pixels from the tag's size in the picture and its place.

A law for library corners (no refinement through the lens), of rendered tag36h11 through a lens with k1 = -0.336 at
f = 828 px, PSF 0.7 px, noise 4 grey levels:

- noise proper: 0.06 px for tags of 25 to 60 px, growing as 1/width for smaller ones;
- the bend: the lens bends an edge of ``width`` pixels by a sagitta of |k1| r width^2 / (4 f) and the detector fits a
  straight line to it, which moves a corner by 2/3 of that. A straighter lens bends less: there the law errs on the
  safe side.

Checked on 471 rendered views (seed 0, pyapriltags, decimate 1), law over measured: 2.0 at 25 to 60 px on the axis, 1.2
to 1.5 off it and for larger tags. Most of it repeats from frame to frame while nothing moves: the new part is 0.02 px.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array

NOISE_PX = 0.06
SMALL_TAG_PX2 = 2.5
BEND_PER_PX = (2.0 / 3.0) * 0.336 / (4.0 * 828.0)


def corner_sigma_px(width_px: Array, radius: Array) -> Array:
    """Return one sigma per pixel coordinate of tags ``width_px`` wide, ``radius`` = tan(off-axis angle); any shape."""
    noise = np.maximum(NOISE_PX, SMALL_TAG_PX2 / np.maximum(width_px, 1.0))
    return np.hypot(noise, BEND_PER_PX * radius * width_px * width_px)


def tag_width_px(corners_px: Array) -> Array:
    """Return the root of the area of tags with (..., 4, 2) corners: their width, for an oblique one the mean width."""
    x, y = corners_px[..., 0], corners_px[..., 1]
    twice_area = (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1)
    return np.asarray(np.sqrt(np.abs(twice_area) / 2.0))
