"""Pictures of a board taken as it is moved before a camera: when one is worth keeping, and when there are enough."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from camrig.calibrate.boards import Board, BoardView
from camrig.calibrate.lens_fit import LensFit, fit_lens, points_of
from camrig.calibrate.lens_forms import FX, LADDER
from camrig.calibrate.shots import FEWEST_POINTS, Gauges, Shot, gauges, next_pose, shift_px
from camrig.errors import InputError
from camrig.geometry.arrays import Array

STILL_S = 0.4
_STILL_SHARE = 0.001
"""A board that moved by less than this share of the picture's width in ``STILL_S`` is held still."""

_NEW_SHARE = 0.04
"""And is worth another picture where it is this far from all before."""

_SOFT = 1.6
_SHARP_PX, _SOFTEST_PX = 3.0, 6.0
"""A picture is sharp whose edges are no wider than the first, or than so many times the sharpest, up to the second."""

_FEWEST, MOST = 12, 40
_FIT_FROM = 6
_COVERED, _SIDES, _SIZES = 0.75, 4, 1.4
_FLAT = 0.05
"""More pictures are no use where the last three lowered the focal length's sigma by less than this share."""


@dataclass
class Collector:
    """Takes what each frame shows; keeps the pictures worth keeping."""

    board: Board
    size_px: tuple[int, int]
    shots: list[Shot] = field(default_factory=list)
    says: str = "no board in view"
    sigmas_px: list[float] = field(default_factory=list)
    """One sigma of the focal length after each picture, from the first that could be fitted."""
    fit: LensFit | None = None
    _still_since_s: float = 0.0
    _where: BoardView | None = None
    _sharpest_px: float = np.inf

    def take(self, view: BoardView | None, edge_px: float, stamp_s: float) -> bool:
        """Judge a frame; say whether it was kept."""
        width = self.size_px[0]
        if view is None or len(view.ids) < FEWEST_POINTS:
            self._where, self.says = None, "no board in view" if view is None else "too little of the board in view"
            return False
        if self._where is None or shift_px(self._where, view) > _STILL_SHARE * width:
            self._where, self._still_since_s, self.says = view, stamp_s, "hold it still"
            return False
        self._sharpest_px = min(self._sharpest_px, edge_px)
        if edge_px > min(max(_SOFT * self._sharpest_px, _SHARP_PX), _SOFTEST_PX):
            self.says = f"blurred: edges {edge_px:.1f} px wide; more light, or check the focus"
            return False
        if stamp_s - self._still_since_s < STILL_S:
            self.says = "hold it still"
            return False
        if any(shift_px(shot.view, view) < _NEW_SHARE * width for shot in self.shots):
            self.says = "taken; move on"
            return False
        self.shots.append(Shot(f"shot {len(self.shots) + 1}", view, edge_px))
        self.says = "taken"
        self._judge()
        return True

    @property
    def gauges(self) -> Gauges:
        """Return what the pictures cover so far."""
        return gauges([shot.view for shot in self.shots], self.board, self.size_px, self._leans())

    @property
    def next_pose(self) -> str:
        """Say how to hold the board next."""
        return next_pose([shot.view for shot in self.shots], self.board, self.size_px)

    @property
    def is_enough(self) -> bool:
        """Tell whether more pictures are no use."""
        if len(self.shots) >= MOST:
            return True
        if len(self.shots) < _FEWEST or len(self.sigmas_px) < 4:
            return False
        covered = self.gauges
        wide = covered.coverage >= _COVERED and covered.sides >= _SIDES and covered.size_ratio >= _SIZES
        return wide and self.sigmas_px[-1] > (1.0 - _FLAT) * self.sigmas_px[-4]

    def _judge(self) -> None:
        """Fit a lens of middling freedom; what comes of it is for the gauges alone."""
        if len(self.shots) < _FIT_FROM:
            return
        views = [(self.board.points_m[shot.view.ids], shot.view.corners_px) for shot in self.shots]
        try:
            self.fit = fit_lens(points_of(self.size_px, views), LADDER[2])
        except InputError:
            self.fit = None
            return
        self.sigmas_px.append(float(np.sqrt(max(self.fit.covariance[FX, FX], 0.0))))

    def _leans(self) -> Array | None:
        if self.fit is None or len(self.fit.T_camera_board) != len(self.shots):
            return None
        normals = self.fit.T_camera_board[:, :3, 2]
        return np.asarray(-np.sign(normals[:, 2:]) * normals[:, :2])
