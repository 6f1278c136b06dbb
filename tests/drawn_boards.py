"""Pictures of a calibration board as a camera with a known lens takes them, for tests and figures of the docs."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from camrig.calibrate.board_face import picture
from camrig.calibrate.boards import AprilGrid, Board
from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_x, rotation_y, rotation_z

_DETAIL = 1.5
"""Pixels of the board's face over those of the picture, where it is nearest."""


class BoardCamera:
    """Draws a board at poses; the lens's rays are worked out once."""

    def __init__(self, lens: Lens, board: Board, *, noise: float = 2.0, seed: int = 0) -> None:
        self.lens = lens
        self.board = board
        self._noise = noise
        self._random = np.random.default_rng(seed)
        width, height = lens.size_px
        x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
        ideal = lens.unproject(np.stack([x, y], axis=-1))
        self._rays = np.concatenate([ideal, np.ones((height, width, 1))], axis=-1)
        corner = board.points_m[:, :2]
        self.centre_m = np.append(0.5 * (corner.min(axis=0) + corner.max(axis=0)), 0.0)
        self.size_m = float(np.ptp(corner, axis=0).max())

    def draw(self, T_camera_board: Transform, blur_px: float = 0.7) -> GreyImage:
        """Take a picture."""
        nearest_m = max(
            float((T_camera_board[:3, 3] + T_camera_board[:3, :3] @ self.centre_m)[2]) - 0.5 * self.size_m, 0.05
        )
        face, to_px = picture(self.board, _DETAIL * self.lens.focal_px[0] / nearest_m, 0.1 * self.size_m)
        R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
        depth = (R[:, 2] @ t) / np.where(np.isnan(self._rays[..., 0]), np.nan, self._rays @ R[:, 2])
        on_board = (self._rays * depth[..., None] - t) @ R
        where = (on_board[..., :2] @ to_px[:, :2].T + to_px[:, 2]).astype(np.float32)
        where = np.where(np.isfinite(where) & (depth > 0.0)[..., None], where, np.float32(-1e6))
        x, y = np.ascontiguousarray(where[..., 0]), np.ascontiguousarray(where[..., 1])
        seen = cv2.remap(face, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
        seen = cv2.GaussianBlur(seen, (0, 0), blur_px).astype(float) * 0.8 + 25.0
        seen += self._random.normal(0.0, self._noise, seen.shape) if self._noise else 0.0
        return np.clip(np.round(seen), 0, 255).astype(np.uint8)

    def pose(
        self, place_px: tuple[float, float], distance_m: float, turns_rad: tuple[float, float, float]
    ) -> Transform:
        """Return ``T_camera_board`` with the board's centre at a pixel, so far ahead, turned about x, y, z."""
        a, b = self.lens.unproject(np.array(place_px))
        upright = np.diag([1.0, -1.0, -1.0]) if isinstance(self.board, AprilGrid) else np.eye(3)
        R = rotation_x(turns_rad[0]) @ rotation_y(turns_rad[1]) @ rotation_z(turns_rad[2]) @ upright
        return transform(R, distance_m * np.array([a, b, 1.0]) - R @ self.centre_m)

    def poses(self, count: int, *, seed: int = 1, tilt_rad: float = math.radians(38.0)) -> Iterator[Transform]:
        """Yield poses of a good calibration: all over the picture, near and far, tilted to all sides."""
        random = np.random.default_rng(seed)
        width, height = self.lens.size_px
        fits_m = 1.25 * self.size_m * self.lens.focal_px[0] / min(width, height)
        for index in range(count):
            x, y = ((index * step + 0.5) % 1.0 for step in (0.618, 0.755))
            place = (width * (0.22 + 0.56 * x), height * (0.25 + 0.5 * y))
            side = index * 2.4
            tilt = tilt_rad * (0.4 + 0.6 * random.random())
            turns = (tilt * math.sin(side), tilt * math.cos(side), 0.3 * random.standard_normal())
            yield self.pose(place, fits_m * (0.75 + 0.9 * random.random()), turns)


def points_px(lens: Lens, board: Board, T_camera_board: Transform) -> Array:
    """Return (n, 2): where the board's points truly are in the picture."""
    return lens.project(board.points_m @ T_camera_board[:3, :3].T + T_camera_board[:3, 3])
