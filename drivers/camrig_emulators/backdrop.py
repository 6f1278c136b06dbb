"""The room behind all things: a smooth grey floor with a slight pattern that stays in place, and grey walls."""

from __future__ import annotations

import cv2
import numpy as np

from camrig.geometry.arrays import GreyImage, Transform
from camrig_emulators.lens_rays import LensRays

_CELL_PX = 16
_FLOOR_GREY = 124.0
_WALL_GREY = 96.0
_WAVES = ((1.7, 0.6, 7.0), (-0.9, 2.3, 5.0), (3.1, -2.7, 3.0))
"""Per wave of the pattern: radians per metre along x and y, and its height in grey levels."""


class Backdrop:
    """Draws the room of one camera, coarsely: it holds nothing sharp."""

    def __init__(self, rays: LensRays) -> None:
        width, height = rays.size_px
        self._size_px = rays.size_px
        cells = (max(1, width // _CELL_PX), max(1, height // _CELL_PX))
        ideal = cv2.resize(rays.crop(0, 0, width, height), cells, interpolation=cv2.INTER_AREA)
        self._rays = np.dstack([ideal, np.ones(ideal.shape[:2], dtype=np.float32)])

    def draw(self, T_world_camera: Transform) -> GreyImage:
        """Return the (height, width) picture of the empty room."""
        direction = self._rays @ T_world_camera[:3, :3].T.astype(np.float32)
        eye = T_world_camera[:3, 3]
        down = np.minimum(direction[..., 2], -1e-3)
        reach = -max(float(eye[2]), 1e-3) / down
        x, y = eye[0] + reach * direction[..., 0], eye[1] + reach * direction[..., 1]
        grey = np.full(x.shape, _FLOOR_GREY)
        for along_x, along_y, height in _WAVES:
            grey += height * np.sin(along_x * x + along_y * y)
        # Far floor fades into the wall: no edge, and no pattern finer than the cells.
        fade = np.clip((8.0 - reach) / 4.0, 0.0, 1.0)
        grey = _WALL_GREY + fade * (grey - _WALL_GREY)
        coarse = np.rint(grey).astype(np.uint8)
        return np.asarray(cv2.resize(coarse, self._size_px, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
