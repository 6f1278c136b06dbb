"""A board's points in a picture, to a fraction of a pixel.

Chessboards are found by OpenCV's two finders, the fast one first; ChArUco boards by its ChArUco detector; AprilGrids
by the detector of tags, and those of Kalibr's kind by OpenCV's ArUco detector, the only one that reads a border of two
bits. Where black meets black at a corner it is refined as a saddle point of the picture, within a window that holds
nothing of its neighbours; corners of plain tags are where the detector's lines meet.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np

from camrig.calibrate.boards import AprilGrid, Board, BoardView, Charuco, Chessboard, Ids
from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.lens import Lens
from camrig.interfaces import TagDetector

LEAST_SIDE_PX = 32
"""A smaller picture shows no board that could be measured."""

APRILTAG_FROM_ARUCO = (1, 0, 3, 2)
"""OpenCV begins an AprilTag's corners elsewhere: p0..p3 are these of its four."""

_FAST = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_THOROUGH = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
_LARGEST_WINDOW_PX = 11
_WINDOW_SHARE = 0.3
"""Half the window over the distance to the nearest neighbour: the corner and nothing of the next."""

_CELLS = 8
"""Of a tag36h11 between its corners."""

_FEWEST_CHARUCO = 4
_FEWEST_TAGS = 2


def find_board(image: GreyImage, board: Board, tags: TagDetector | None = None) -> BoardView | None:
    """Find a board in a (height, width) picture; None where it is not there, or too little of it. ``tags`` finds those
    of AprilGrids; without it they are found by OpenCV, fewer and less precisely.

    Raises InputError for a picture with a side under ``LEAST_SIDE_PX``.
    """
    if min(image.shape) < LEAST_SIDE_PX:
        height, width = image.shape
        raise InputError(f"a picture of {width}x{height} px is too small for a board: {LEAST_SIDE_PX} px at least")
    if tags is not None and isinstance(board, AprilGrid) and not board.like_kalibrs:
        return _plain_tags(board, *_detected(image, tags))
    return _finder(board)(image)


@lru_cache(maxsize=8)
def _finder(board: Board) -> Callable[[GreyImage], BoardView | None]:
    if isinstance(board, Chessboard):
        return lambda image: _find_chessboard(image, board)
    if isinstance(board, Charuco):
        detector = cv2.aruco.CharucoDetector(board.opencv())
        return lambda image: _find_charuco(image, board, detector)
    markers = marker_detector(cv2.aruco.DICT_APRILTAG_36h11, board.border_bits)
    if board.like_kalibrs:
        return lambda image: _find_kalibrs(image, board, markers)
    return lambda image: _plain_tags(board, *_in_order(*find_markers(image, markers)))


def marker_detector(dictionary: int, border_bits: int = 1) -> cv2.aruco.ArucoDetector:
    """Return a detector; it corrects bits of AprilTags alone: misread, others are markers of the same dictionary."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    if dictionary != cv2.aruco.DICT_APRILTAG_36h11:
        parameters.errorCorrectionRate = 0.0
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary), parameters)


def find_markers(image: GreyImage, detector: cv2.aruco.ArucoDetector) -> tuple[Ids, Array]:
    """Return (n,) ids and (n, 4, 2) corners as OpenCV orders them; an id that is there twice is left out."""
    quads, ids, _ = detector.detectMarkers(image)
    if ids is None or not len(ids):
        return np.zeros(0, np.int64), np.zeros((0, 4, 2))
    found = np.asarray(ids, np.int64).ravel()
    corners = np.asarray(quads, np.float64).reshape(-1, 4, 2)
    values, counts = np.unique(found, return_counts=True)
    once = np.isin(found, values[counts == 1])
    return found[once], corners[once]


def _find_chessboard(image: GreyImage, board: Chessboard) -> BoardView | None:
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCorners(image, size, flags=_FAST)
    if not found and min(size) >= 3:
        found, corners = cv2.findChessboardCornersSB(image, size, flags=_THOROUGH)
    if not found or corners is None:
        return None
    corners_px = np.asarray(corners, np.float64).reshape(-1, 2)
    refined = refine(image, corners_px, _spacing_px(corners_px.reshape(board.rows, board.columns, 2)))
    return BoardView(np.arange(len(refined)), refined)


def _find_charuco(image: GreyImage, board: Charuco, detector: cv2.aruco.CharucoDetector) -> BoardView | None:
    """Look for the board from its front, then from behind: some are printed through, or on film."""
    seen = 255 - image if board.inverted else image
    return _charuco(seen, board, detector) or _mirrored(
        _charuco(np.ascontiguousarray(seen[:, ::-1]), board, detector), image
    )


def _mirrored(view: BoardView | None, image: GreyImage) -> BoardView | None:
    if view is None:
        return None
    return BoardView(view.ids, np.array([image.shape[1] - 1.0, 0.0]) + np.array([-1.0, 1.0]) * view.corners_px)


def _charuco(seen: GreyImage, board: Charuco, detector: cv2.aruco.CharucoDetector) -> BoardView | None:
    corners, ids, _, _ = detector.detectBoard(seen)
    if ids is None or len(ids) < _FEWEST_CHARUCO:
        return None
    # OpenCV's own corners: its window ends where the markers begin, which a wider one would mistake for the corner.
    return BoardView(np.asarray(ids, np.int64).ravel(), np.asarray(corners, np.float64).reshape(-1, 2))


def _find_kalibrs(image: GreyImage, board: AprilGrid, detector: cv2.aruco.ArucoDetector) -> BoardView | None:
    view = _plain_tags(board, *_in_order(*find_markers(image, detector)))
    if view is None:
        return None
    corners = view.corners_px.reshape(-1, 4, 2)
    side_px = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).min(axis=1)
    near_px = side_px * min(1.0, board.gap_m / board.tag_m)
    return BoardView(view.ids, refine(image, view.corners_px, np.repeat(near_px, 4)))


def _detected(image: GreyImage, tags: TagDetector) -> tuple[Ids, Array]:
    """Return the ids and (n, 4, 2) corners of tags that were read without an error."""
    found = [tag for tag in tags.detect(image) if tag.key.family == "tag36h11" and tag.hamming == 0]
    corners = np.array([tag.corners_px for tag in found]).reshape(-1, 4, 2)
    return np.array([tag.key.id for tag in found], np.int64), corners


def _in_order(ids: Ids, corners: Array) -> tuple[Ids, Array]:
    """Return tags with their corners in AprilTag's order."""
    return ids, corners[:, APRILTAG_FROM_ARUCO]


def _plain_tags(board: AprilGrid, ids: Ids, corners: Array) -> BoardView | None:
    mine = (ids >= board.first_id) & (ids < board.first_id + board.columns * board.rows)
    if mine.sum() < _FEWEST_TAGS:
        return None
    order = np.argsort(ids[mine])
    tags = ids[mine][order] - board.first_id
    return BoardView((4 * tags[:, None] + np.arange(4)).ravel(), corners[mine][order].reshape(-1, 2))


def refined_through(lens: Lens, image: GreyImage, view: BoardView) -> BoardView:
    """Return a view of a plain AprilGrid with its tags' edges followed as the lens bends them: a detector's straight
    lines miss the corners by what an edge bends. The first call of a process loads machine code, or compiles it.
    """
    from camrig.geometry.refine_corners import refine_corners  # noqa: PLC0415 - loads numba, which few boards need

    quads = view.corners_px.reshape(-1, 4, 2)
    found = refine_corners(image, lens, quads, np.full(len(quads), float(_CELLS)))
    return BoardView(view.ids, found.corners_px.reshape(-1, 2))


def refine(image: GreyImage, corners_px: Array, near_px: Array) -> Array:
    """Return (n, 2) corners as saddle points of the picture, each judged within ``_WINDOW_SHARE`` of ``near_px`` (n,)
    or as many of its neighbours; where that runs away the corner stays as it was.
    """
    half = np.clip(_WINDOW_SHARE * near_px.ravel(), 2.0, _LARGEST_WINDOW_PX).astype(int)
    refined = corners_px.copy()
    for size in np.unique(half):
        these = half == size
        start = np.ascontiguousarray(corners_px[these], np.float32).reshape(-1, 1, 2)
        window = (int(size), int(size))
        refined[these] = cv2.cornerSubPix(image, start, window, (-1, -1), _CRITERIA).reshape(-1, 2)
    away = np.linalg.norm(refined - corners_px, axis=-1) > half
    refined[away] = corners_px[away]
    return refined


def _spacing_px(grid_px: Array) -> Array:
    """Return (rows, columns): how far each point of a (rows, columns, 2) grid, NaN where not seen, is from its nearest
    neighbour; of one without any, the median.
    """
    padded = np.full((grid_px.shape[0] + 2, grid_px.shape[1] + 2, 2), np.nan)
    padded[1:-1, 1:-1] = grid_px
    around = [padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]]
    distance = np.stack([np.linalg.norm(grid_px - each, axis=-1) for each in around])
    nearest = np.where(np.isnan(distance), np.inf, distance).min(axis=0)
    alone = np.isinf(nearest)
    return np.asarray(np.where(alone, np.median(nearest[~alone]) if not alone.all() else 10.0, nearest))
