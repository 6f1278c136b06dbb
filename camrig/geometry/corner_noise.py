"""How noisy tags' corners are: one sigma in pixels from the tag's size in the picture and its place.

Measured on tag36h11 drawn through a lens with k1 = -0.336 at f = 828 px, PSF 0.7 px, noise 4 grey levels, pyapriltags,
decimate 1; docs/accuracy.md has the tables. Three laws:

- *refined* corners (geometry.refine_corners): hypot(0.014, 0.6 / width), wherever the lens sees them;
- the *detector's* own: 0.06 px for tags of 25 to 60 px, growing as 1/width for smaller ones; and the bend: the lens
  bends an edge of ``width`` pixels by a sagitta of |k1| r width^2 / (4 f) and the detector fits a straight line to it,
  which moves a corner by 2/3 of that. A straighter lens bends less: there the law errs on the safe side;
- what a *plan* may expect of refinement: the cells of tags below some 22 px may be too small for it.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array

REFINED_PX = 0.014
REFINED_PX2 = 0.6

NOISE_PX = 0.06
SMALL_TAG_PX2 = 2.5
BEND_PER_PX = (2.0 / 3.0) * 0.336 / (4.0 * 828.0)

UNREFINED_WIDTH_PX = 8.8
UNREFINED_POWER = 5.0
"""What corners that could not be refined add, the information of all taken together: (8.8 / width)^5."""


def refined_sigma_px(width_px: Array) -> Array:
    """Return one sigma per pixel coordinate of refined corners of tags ``width_px`` wide; any shape."""
    return np.hypot(REFINED_PX, REFINED_PX2 / np.maximum(width_px, 1.0))


def detected_sigma_px(width_px: Array, radius: Array) -> Array:
    """Return that of the detector's corners; ``radius`` = tan(off-axis angle); any shape."""
    noise = np.maximum(NOISE_PX, SMALL_TAG_PX2 / np.maximum(width_px, 1.0))
    return np.hypot(noise, BEND_PER_PX * radius * width_px * width_px)


def planned_sigma_px(width_px: Array) -> Array:
    """Return that of corners which will be refined where they can be; any shape."""
    unrefined = (UNREFINED_WIDTH_PX / np.maximum(width_px, 1.0)) ** UNREFINED_POWER
    return np.hypot(refined_sigma_px(width_px), unrefined)


def tag_width_px(corners_px: Array) -> Array:
    """Return the root of the area of tags with (..., 4, 2) corners: their width, for an oblique one the mean width."""
    x, y = corners_px[..., 0], corners_px[..., 1]
    twice_area = (x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1)
    return np.asarray(np.sqrt(np.abs(twice_area) / 2.0))
