"""Which board is it? Kind, columns and rows, pattern and colours, from pictures of it alone.

Markers tell by the order of their numbers: each layout that could be is laid over the markers seen, plane to plane, and
the one that fits best is the board. A chessboard is grown from a patch of it, and the size that most pictures agree on
is its own. Only the scale no picture shows: sizes are in squares (an AprilGrid's in tags) until somebody gives one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import minimize_scalar

from camrig.calibrate.boards import DICTIONARIES, AprilGrid, Board, Charuco, Chessboard, Ids
from camrig.calibrate.find_boards import APRILTAG_FROM_ARUCO, find_board, find_markers, marker_detector
from camrig.geometry.arrays import Array, GreyImage

_FEWEST_MARKERS = 5
"""Fewer fit almost any layout."""

_AT_FIRST, _AT_LAST = 2, 6
"""So many pictures are searched for every kind of marker, which is slow; and so many where nothing was found."""

_ENOUGH_PX = 800
"""Pictures of at least twice this are searched smaller."""

_GOOD_MISFIT, _WORST_MISFIT = 0.12, 0.5
"""Of a layout, over the side of a marker: what most lenses bend, and a fisheye; wrong layouts are off by squares."""

_ALONE = 2.0
"""Where the misfit is not good, every other layout must be worse by this factor."""

_WIDEST = 24
_NARROWEST_CHESSBOARD = 3
_VOTES, _AGREED = 3, 0.25
"""Chessboard sizes that are tried on all pictures, and what share of these must show one."""

_FAST = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_CLEARLY = 0.7
"""A border of one bit is believed where its corners fit by so much better than those of two."""

_UNIT_TAG = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])

_APRIL = "apriltag_36h11"


@dataclass(frozen=True, slots=True, eq=False)
class _Markers:
    """The markers of one picture, mirrored or not as they were read, and which dictionary and colours read them."""

    ids: Ids
    corners_px: Array


@dataclass(frozen=True, slots=True)
class _Layout:
    """A board that could be, and by what its centres miss, over a marker's side."""

    board: Board
    misfit: float


def recognise(images: Sequence[GreyImage]) -> Board | None:
    """Return the board that (height, width) pictures show, sizes in squares; None where they show none they agree on.

    A handful of pictures does; work grows with them.
    """
    smaller = [_shrunk(image) for image in images]
    board = _with_markers(_some(smaller, _AT_FIRST)) or _chessboard(smaller)
    if board is None and len(images) > _AT_FIRST:
        board = _with_markers(_some(smaller, _AT_LAST))
    return _measured(board, images) if isinstance(board, AprilGrid) else board


def _measured(board: AprilGrid, images: Sequence[GreyImage]) -> AprilGrid:
    """Return the grid with its gap as corners of the full pictures tell, refined: each row of tags is a ruler."""
    views = [view for image in images if (view := find_board(image, board)) is not None]
    return with_measured_gap(board, [(view.ids, view.corners_px) for view in views])


def with_measured_gap(board: AprilGrid, views: Sequence[tuple[Ids, Array]]) -> AprilGrid:
    """Return the grid with the gap at which (4 k,) ids and (4 k, 2) corners lie best on a plane; of corners in ideal
    coordinates it is exact, of those in pixels as good as the lens is straight.
    """
    gaps = []
    for ids, corners in views:
        tags = ids[::4] // 4
        finite = np.isfinite(corners.reshape(-1, 8)).all(axis=1)
        if finite.sum() >= _FEWEST_MARKERS:
            y, x = np.divmod(tags[finite], board.columns)
            cells = np.stack([x, y], axis=-1).astype(float)
            gaps.append(_gap(corners.reshape(-1, 4, 2)[finite], cells, board.gap_m / board.tag_m))
    return replace(board, gap_m=round(float(np.median(gaps)), 3) * board.tag_m) if gaps else board


def _gap(corners_px: Array, cells: Array, gap: float) -> float:
    """Return the gap, in tags, at which (n, 4, 2) corners of tags in (n, 2) cells lie best on a plane."""

    def misfit(trial: float) -> float:
        places = (cells[:, None] * (1.0 + trial) + _UNIT_TAG).reshape(-1, 2)
        H, _ = cv2.findHomography(places, corners_px.reshape(-1, 2), 0)
        if H is None:
            return float("inf")
        return float(np.square(cv2.perspectiveTransform(places[None], H)[0] - corners_px.reshape(-1, 2)).sum())

    return float(minimize_scalar(misfit, bounds=(0.5 * gap, 1.5 * gap), method="bounded", options={"xatol": 1e-4}).x)


def _some(images: Sequence[GreyImage], count: int) -> Sequence[GreyImage]:
    """Return at most so many, evenly."""
    return images[:: -(-len(images) // count)] if images else images


def _shrunk(image: GreyImage) -> GreyImage:
    """Return a picture of a side that is enough to tell boards apart."""
    factor = max(image.shape) // _ENOUGH_PX
    if factor < 2:
        return image
    height, width = (side // factor for side in image.shape)
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _with_markers(images: Sequence[GreyImage]) -> Board | None:
    """Try every dictionary, black on white first, until the markers found lie as on a board."""
    for inverted in (False, True):
        for dictionary in DICTIONARIES:
            layouts = [_best_charuco(list(_seen(images, dictionary, inverted=inverted)), dictionary, inverted=inverted)]
            if dictionary == _APRIL and not inverted:
                layouts.append(_either_border(images))
            fitting = [layout for layout in layouts if layout is not None]
            if fitting:
                return min(fitting, key=lambda layout: layout.misfit).board
    return None


def _either_border(images: Sequence[GreyImage]) -> _Layout | None:
    """Return the AprilGrid of the border that fits: with the wrong one the right ids may be read, at wrong corners."""
    wide, narrow = (_aprilgrid(images, bits) for bits in (2, 1))
    if wide is None or (narrow is not None and narrow.misfit < _CLEARLY * wide.misfit):
        return narrow
    return wide


def _seen(images: Sequence[GreyImage], dictionary: str, *, inverted: bool, border_bits: int = 1) -> Iterator[_Markers]:
    """Yield the markers of every picture with enough of them, read from whichever side shows more."""
    detector = marker_detector(DICTIONARIES[dictionary], border_bits)
    for image in images:
        seen = 255 - image if inverted else image
        ids, corners = find_markers(seen, detector)
        if 0 < len(ids) < _FEWEST_MARKERS:  # read from behind, some are by chance others
            ids, corners = max((ids, corners), find_markers(np.ascontiguousarray(seen[:, ::-1]), detector), key=_count)
        if len(ids) >= _FEWEST_MARKERS:
            yield _Markers(ids, corners)


def _count(found: tuple[Ids, Array]) -> int:
    return len(found[0])


def _best_charuco(seen: Sequence[_Markers], dictionary: str, *, inverted: bool) -> _Layout | None:
    """Return the ChArUco board that markers fit best, None where none fits."""
    if not seen:
        return None
    last = _last_id(seen)
    layouts = []
    for columns in range(3, _WIDEST + 1):
        for legacy in (False, True):
            rows = _rows(columns, last, legacy=legacy)
            places = _charuco_places(columns, rows, legacy=legacy)
            layouts.append((columns, rows, legacy, *_fit(seen, places, last)))
    columns, rows, legacy, misfit, side = min(layouts, key=lambda layout: layout[3])
    others = [layout[3] for layout in layouts if layout[0] != columns]
    if not _is_clear(misfit, others) or not 0.1 < side < 0.98:
        return None
    return _Layout(Charuco(columns, rows, 1.0, round(side, 3), dictionary, legacy, inverted), misfit)


def _rows(columns: int, last: int, *, legacy: bool) -> int:
    """Return the fewest rows that hold the last marker; the old pattern differs only where they are even."""
    rows = 3
    while columns * rows // 2 <= last or (legacy and rows % 2):
        rows += 1
    return rows


def _charuco_places(columns: int, rows: int, *, legacy: bool) -> Array:
    """Return (n, 2): where markers' centres are, by id, in squares. Source: OpenCV's CharucoBoard; markers are on white
    squares, row by row, and the first square is black but in the old pattern of even rows.
    """
    y, x = np.divmod(np.arange(columns * rows), columns)
    white = (x + y) % 2 == (0 if legacy and rows % 2 == 0 else 1)
    return np.stack([x[white] + 0.5, y[white] + 0.5], axis=-1)


def _aprilgrid(images: Sequence[GreyImage], border_bits: int) -> _Layout | None:
    """Return the AprilGrid that tags of so wide a border fit best, by their corners, None where none fits."""
    seen = [
        _Markers(each.ids, each.corners_px[:, APRILTAG_FROM_ARUCO])
        for each in _seen(images, _APRIL, inverted=False, border_bits=border_bits)
    ]
    if not seen:
        return None
    first, last = min(int(each.ids.min()) for each in seen), _last_id(seen)
    layouts = []
    for columns in range(1, _WIDEST + 1):
        start = first - first % columns
        y, x = np.divmod(np.arange(last - start + 1), columns)
        places = np.full((last + 1, 2), np.nan)
        places[start:] = np.stack([x, y], axis=-1)
        layouts.append((columns, start, *_fit(seen, places, last)))
    columns, start, misfit, side = min(layouts, key=lambda layout: layout[2])
    if not _is_clear(misfit, [layout[2] for layout in layouts if layout[0] != columns]) or not 0.1 < side < 0.98:
        return None
    rows = (last - start) // columns + 1
    return _Layout(AprilGrid(columns, rows, 1.0, round(1.0 / side - 1.0, 3), border_bits, start), misfit)


def _is_clear(misfit: float, others: Sequence[float]) -> bool:
    return misfit <= _GOOD_MISFIT or (misfit <= _WORST_MISFIT and min(others) >= _ALONE * misfit)


def _last_id(seen: Sequence[_Markers]) -> int:
    """Return the largest id that is seen more than once, or at all where none is: misread ones come singly."""
    counts = Counter(int(marker) for each in seen for marker in each.ids)
    often = [marker for marker, count in counts.items() if count > 1]
    return max(often if len(seen) > 2 and often else counts)


def _fit(seen: Sequence[_Markers], places: Array, last: int) -> tuple[float, float]:
    """Return by what markers miss the best plane-to-plane map from their ``places`` (n, 2) by id, over their side (rms
    of all pictures), and how long their side is there; infinite where no map exists.
    """
    misses, sides = [], []
    for each in seen:
        mine = each.ids <= last
        square, at = each.corners_px[mine], places[each.ids[mine]]
        H, _ = cv2.findHomography(square.mean(axis=1), at, 0) if len(at) >= _FEWEST_MARKERS else (None, None)
        if H is None or not np.isfinite(H).all():
            return np.inf, 0.0
        mapped = cv2.perspectiveTransform(square.reshape(1, -1, 2), H).reshape(-1, 4, 2)
        along = np.linalg.norm(mapped - np.roll(mapped, 1, axis=1), axis=-1)
        side = float(np.median(along))
        corners = side * 0.5 * np.sign(np.round(mapped - mapped.mean(axis=1, keepdims=True), 9))
        misses.append(float(np.sqrt(np.mean(np.square(mapped - at[:, None] - corners))) / max(side, 1e-9)))
        sides.append(side)
    return float(np.sqrt(np.mean(np.square(misses)))) if misses else np.inf, float(np.median(sides or [0.0]))


def _chessboard(images: Sequence[GreyImage]) -> Chessboard | None:
    """Grow boards from a patch, and let pictures vote; where none grows, look for every usual size, largest first."""
    grown = _grown(images, cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not grown:
        few = _some(images, _AT_FIRST)
        usual = [(columns, rows) for columns in range(4, 13) for rows in range(3, columns + 1)]
        for size in sorted(usual, key=lambda size: -size[0] * size[1]):
            grown[size] += sum(bool(cv2.findChessboardCorners(image, size, flags=_FAST)[0]) for image in few)
        grown = +grown
    votes = {
        size: sum(bool(cv2.findChessboardCorners(image, size, flags=_FAST)[0]) for image in images)
        for size, _ in grown.most_common(_VOTES)
    }
    if not votes or max(votes.values()) < _AGREED * len(images):
        return None
    return Chessboard(*max(votes, key=lambda size: (votes[size], size[0] * size[1])))


def _grown(images: Sequence[GreyImage], flags: int) -> Counter[tuple[int, int]]:
    """Return how many pictures show which size, columns no fewer than rows, when a patch of a board is grown."""
    grown: Counter[tuple[int, int]] = Counter()
    start = (_NARROWEST_CHESSBOARD, _NARROWEST_CHESSBOARD)
    for image in images:
        found, _, meta = cv2.findChessboardCornersSBWithMeta(image, start, flags | cv2.CALIB_CB_LARGER)
        if found and max(meta.shape[:2]) > _NARROWEST_CHESSBOARD:
            grown[max(meta.shape[:2]), min(meta.shape[:2])] += 1
    return grown
