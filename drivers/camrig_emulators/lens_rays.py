"""A lens as OpenCV sees it: rays of pixels and pixels of points, computed by OpenCV alone.

camrig.geometry has lens models of its own; pictures drawn with these would hide their mistakes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens

FloatImage = npt.NDArray[np.float32]

BORDER_PX = 16
"""How far the table of rays reaches beyond the picture, so that tags cut by its edge are drawn right."""

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
_NEAR_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class LensRays:
    """The ideal (X/Z, Y/Z) ray of every pixel of the picture and of a border of ``BORDER_PX`` around it.

    ``ideal`` is (height + 2 border, width + 2 border, 2); ``dark`` (height, width) marks pixels past ``r_max``, None
    where there are none; ``reach`` is the largest radius tan(beta) in the table.
    """

    size_px: tuple[int, int]
    ideal: FloatImage
    dark: npt.NDArray[np.bool_] | None
    reach: float
    matrix: Array
    distortion: Array
    fisheye: bool

    def crop(self, x0: int, y0: int, x1: int, y1: int) -> FloatImage:
        """Return the rays of columns x0 to x1 and rows y0 to y1 (not included); the border may be asked for too."""
        part: FloatImage = self.ideal[y0 + BORDER_PX : y1 + BORDER_PX, x0 + BORDER_PX : x1 + BORDER_PX]
        return np.ascontiguousarray(part)

    def project(self, points_camera: Array) -> Array:
        """Map (n, 3) optical-frame points in metres to (n, 2) pixels; NaN behind the camera or past the table."""
        depth = points_camera[:, 2]
        near = depth > _NEAR_M
        ideal = points_camera[:, :2] / np.where(near, depth, 1.0)[:, None]
        seen = near & (np.hypot(ideal[:, 0], ideal[:, 1]) <= self.reach)
        pixels = np.full((len(points_camera), 2), np.nan)
        if seen.any():
            pixels[seen] = _project(points_camera[seen], self.matrix, self.distortion, fisheye=self.fisheye)
        return pixels


def lens_rays(lens: Lens) -> LensRays:
    """Compute the table of a lens; a third of a second for a megapixel. Raises InputError for an unknown model."""
    if not isinstance(lens, BrownLens | FisheyeLens):
        raise InputError(f"the emulated world cannot draw through a {type(lens).__name__}; it knows brown and fisheye")
    width, height = lens.size_px
    fisheye = isinstance(lens, FisheyeLens)
    matrix = np.array(
        [[lens.focal_px[0], 0.0, lens.centre_px[0]], [0.0, lens.focal_px[1], lens.centre_px[1]], [0, 0, 1]]
    )
    distortion = np.asarray(lens.distortion, dtype=float)
    v, u = np.mgrid[-BORDER_PX : height + BORDER_PX, -BORDER_PX : width + BORDER_PX].astype(float)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    with np.errstate(all="ignore"):
        ideal = _undistort(pixels, matrix, distortion, fisheye=fisheye).reshape(*u.shape, 2)
        radius = np.hypot(ideal[..., 0], ideal[..., 1])
        valid = np.isfinite(radius) & (radius <= lens.r_max * (1.0 + 1e-6))
    dark = ~valid[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    return LensRays(
        size_px=lens.size_px,
        ideal=np.where(valid[..., None], ideal, 0.0).astype(np.float32),
        dark=dark if dark.any() else None,
        reach=float(radius[valid].max()) if valid.any() else 0.0,
        matrix=matrix,
        distortion=distortion,
        fisheye=fisheye,
    )


def _project(points: Array, matrix: Array, distortion: Array, *, fisheye: bool) -> Array:
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    pixels, _ = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


def _undistort(pixels: Array, matrix: Array, distortion: Array, *, fisheye: bool) -> Array:
    if fisheye:
        return np.asarray(cv2.fisheye.undistortPoints(pixels, matrix, distortion))
    # OpenCV 4 has the iterative version under a name of its own; the plain one stops after five steps there.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    return np.asarray(undistort(pixels, matrix, distortion, R=None, P=None, criteria=_CRITERIA))
