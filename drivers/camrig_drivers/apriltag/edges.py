"""Sub-pixel corners of a black square on white: each side is fitted as a line through the steepest grey steps.

The idea is AprilTag's (Wang and Olson, "AprilTag 2", section III-C). A corner search (cv2.cornerSubPix) looks at
the corner alone, where blur rounds it: it is off by 1.2 px on the tags of 100 px in the hallway test pictures.
"""

from __future__ import annotations

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage

_POINTS = 32
"""Points along each side; the ends are left out, where the neighbouring side bends the step."""
_TRIM = 0.1
_STEP_PX = 0.25
_REACH_CELLS = 0.8
"""How far from a given side the true one is looked for: within one cell there is no other step of this sense."""
_NEAR_PX = 1.5
"""The same for the second round, which starts from sides that are nearly right."""


def refine_corners(image: GreyImage, corners_px: Array, cell_px: float) -> Array | None:
    """Refine (4, 2) corners, in order round a square of cells ``cell_px`` wide, the outermost of them black.

    Returns None where the picture shows no such square within one cell of them.
    """
    refined = corners_px
    for reach_px in (max(_REACH_CELLS * cell_px, _NEAR_PX), _NEAR_PX):
        lines = _sides(image, refined, reach_px)
        if lines is None:
            return None
        refined = _crossings(lines)
    moved_px = np.linalg.norm(refined - corners_px, axis=1)
    return refined if (moved_px <= max(cell_px, 2.0 * _NEAR_PX)).all() else None


def _sides(image: GreyImage, corners: Array, reach_px: float) -> Array | None:
    """Return (4, 3) homogeneous lines, side k from corner k to k + 1; None where a side shows no grey step."""
    ends = np.roll(corners, -1, axis=0)
    along = np.linspace(_TRIM, 1.0 - _TRIM, _POINTS)[None, :, None]
    points = corners[:, None] * (1.0 - along) + ends[:, None] * along  # (4, P, 2)
    outward = _outward(corners, ends)  # (4, 2)
    offsets = np.arange(-reach_px, reach_px + _STEP_PX / 2.0, _STEP_PX)  # (K,)
    steps = _grey(image, points, outward, offsets + 0.5) - _grey(image, points, outward, offsets - 0.5)  # (4, P, K)
    weights = np.square(np.maximum(steps, 0.0))  # white must be outside
    total = weights.sum(axis=2)
    if (np.count_nonzero(total, axis=1) < 2).any():
        return None
    shift = (weights @ offsets) / np.maximum(total, 1e-12)
    found = points + shift[..., None] * outward[:, None]
    return _lines(found, total)


def _outward(corners: Array, ends: Array) -> Array:
    direction = (ends - corners) / np.linalg.norm(ends - corners, axis=1, keepdims=True)
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    middle = (corners + ends) / 2.0 - corners.mean(axis=0)
    return np.asarray(normal * np.sign(np.sum(normal * middle, axis=1, keepdims=True)))


def _grey(image: GreyImage, points: Array, outward: Array, offsets: Array) -> Array:
    """Sample (4, P, K) grey values at ``points`` moved by ``offsets`` along ``outward``, bilinearly."""
    at = points[:, :, None] + offsets[:, None] * outward[:, None, None]
    flat = at.reshape(4 * _POINTS, -1, 2).astype(np.float32)
    grey = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.astype(np.float64).reshape(4, _POINTS, -1)


def _lines(points: Array, weights: Array) -> Array:
    """Fit (4, 3) homogeneous lines ``l . (x, y, 1) = 0`` to (4, P, 2) points, weighted: total least squares."""
    share = weights / weights.sum(axis=1, keepdims=True)
    centre = np.einsum("sp,spi->si", share, points)
    apart = points - centre[:, None]
    moments = np.einsum("sp,spi,spj->sij", share, apart, apart)
    normal = np.linalg.eigh(moments).eigenvectors[..., 0]
    return np.column_stack([normal, -np.sum(normal * centre, axis=1)])


def _crossings(lines: Array) -> Array:
    """Return the corners (4, 2), each where its line meets the one before; far away where they are parallel."""
    x, y, w = np.cross(np.roll(lines, 1, axis=0), lines).T
    return np.column_stack([x, y]) / np.where(np.abs(w) > 1e-9, w, 1e-9)[:, None]
