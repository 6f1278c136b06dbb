"""Calibration boards: what they are, where their points lie, and how they are written in one word.

Every board has its own frame, in metres, z = 0 on its face. Of chessboards and ChArUco boards x goes along the columns
and y down the rows (OpenCV's); of AprilGrids x goes right and y up from the corner of the first tag (Kalibr's).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from camrig.errors import InputError
from camrig.geometry.arrays import Array

Ids = npt.NDArray[np.int64]

DICTIONARIES = {
    name.removeprefix("DICT_").lower(): int(getattr(cv2.aruco, name))
    for name in ("DICT_4X4_1000", "DICT_APRILTAG_36h11", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000")
}
"""Markers of ChArUco boards: each contains OpenCV's smaller dictionaries of the same bits."""

MOST = 60
"""Columns or rows of a board."""


@dataclass(frozen=True)
class Chessboard:
    """``columns`` x ``rows`` counts inner corners."""

    columns: int
    rows: int
    square_m: float = 1.0

    @cached_property
    def points_m(self) -> Array:
        """Return (n, 3), by id."""
        return _grid(self.columns, self.rows, self.square_m)


@dataclass(frozen=True)
class Charuco:
    """``columns`` x ``rows`` counts squares; ``legacy``: drawn by OpenCV before 4.6; ``inverted``: white for black."""

    columns: int
    rows: int
    square_m: float = 1.0
    marker_m: float = 0.75
    dictionary: str = "4x4_1000"
    legacy: bool = False
    inverted: bool = False

    @cached_property
    def points_m(self) -> Array:
        """Return (n, 3), by id."""
        return np.array([self.square_m, self.square_m, 0.0]) + _grid(self.columns - 1, self.rows - 1, self.square_m)

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's board, with a dictionary of its own markers alone: no other can be mistaken for one."""
        every = cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        own = cv2.aruco.Dictionary(every.bytesList[: self.columns * self.rows // 2 + 1], every.markerSize, 0)
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, own)
        board.setLegacyPattern(self.legacy)
        return board


@dataclass(frozen=True)
class AprilGrid:
    """Tags tag36h11 in rows from the bottom left, ``gap_m`` apart, four points each in AprilTag's order p0..p3.

    Grids as Kalibr prints them have a border of two bits and small squares that touch the corners of the tags; others
    a border of one and nothing between, so that every detector reads them.
    """

    columns: int
    rows: int
    tag_m: float = 1.0
    gap_m: float = 0.3
    border_bits: int = 1
    first_id: int = 0

    @property
    def like_kalibrs(self) -> bool:
        """Tell whether it is of Kalibr's kind."""
        return self.border_bits == 2

    @cached_property
    def points_m(self) -> Array:
        """Return (n, 3), by id: four times the tag's number from the first, plus the corner's."""
        corners = self.tag_m * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
        origins = _grid(self.columns, self.rows, self.tag_m + self.gap_m)
        return np.asarray((origins[:, None] + corners).reshape(-1, 3))


Board = Chessboard | Charuco | AprilGrid


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """What a picture shows of a board: (n,) ids of points, and where they are, (n, 2) pixels in OpenCV's convention."""

    ids: Ids
    corners_px: Array


def square_of(board: Board) -> float:
    """Return the length that sets a board's scale: of a square, or of an AprilGrid's tag, in metres."""
    return board.tag_m if isinstance(board, AprilGrid) else board.square_m


def scaled(board: Board, square_m: float) -> Board:
    """Return the board with squares (an AprilGrid: tags) of another size, all else in proportion."""
    factor = square_m / square_of(board)
    if isinstance(board, Chessboard):
        return replace(board, square_m=square_m)
    if isinstance(board, Charuco):
        return replace(board, square_m=square_m, marker_m=board.marker_m * factor)
    return replace(board, tag_m=square_m, gap_m=board.gap_m * factor)


def board_word(board: Board) -> str:
    """Write a board as ``parse_board`` reads it."""
    grid = f"{board.columns}x{board.rows}"
    if isinstance(board, Chessboard):
        return f"chessboard:{grid}:{_mm(board.square_m)}"
    if isinstance(board, Charuco):
        how = ":legacy" * board.legacy + ":inverted" * board.inverted
        return f"charuco:{grid}:{_mm(board.square_m)}:{_mm(board.marker_m)}:{board.dictionary}{how}"
    how = ":kalibr" * board.like_kalibrs + (f":first{board.first_id}" if board.first_id else "")
    return f"aprilgrid:{grid}:{_mm(board.tag_m)}:{_mm(board.gap_m)}{how}"


def parse_board(word: str) -> Board:
    """Read a board: ``chessboard:7x5:30`` (inner corners, mm), ``charuco:8x6:30:22:4x4_1000`` (squares, markers),
    ``aprilgrid:6x6:55:16.5`` (tags, gaps); ``:legacy``, ``:inverted``, ``:kalibr`` and ``:first100`` may follow.
    ``tags:`` is an AprilGrid, too.

    Raises InputError with what is wrong and what is allowed.
    """
    kind, *parts = word.strip().lower().split(":")
    try:
        columns, rows = (int(number) for number in parts[0].split("x"))
        sizes_m = [float(part) / 1000.0 for part in parts[1:] if _is_number(part)]
        marks = {part for part in parts[1:] if not _is_number(part)}
        board = _board(kind, columns, rows, sizes_m, marks)
    except (ValueError, IndexError) as error:
        raise InputError(
            f"board '{word}': write chessboard:COLUMNSxROWS:SQUARE_MM (inner corners), "
            "charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY (squares), aprilgrid:COLUMNSxROWS:TAG_MM:GAP_MM "
            "or tags:COLUMNSxROWS:TAG_MM:GAP_MM:firstID"
        ) from error
    _check(board, word)
    return board


def _board(kind: str, columns: int, rows: int, sizes_m: list[float], marks: set[str]) -> Board:
    """Build a board; raises ValueError where the parts do not make one."""
    if kind == "chessboard" and not marks:
        (square_m,) = sizes_m
        return Chessboard(columns, rows, square_m)
    if kind == "charuco":
        square_m, marker_m = sizes_m
        (dictionary,) = (marks - {"legacy", "inverted"}) or {"4x4_1000"}
        return Charuco(columns, rows, square_m, marker_m, _whole(dictionary), "legacy" in marks, "inverted" in marks)
    if kind in {"aprilgrid", "tags"}:
        tag_m, gap_m = sizes_m
        (first,) = {int(mark.removeprefix("first")) for mark in marks - {"kalibr"}} or {0}
        return AprilGrid(columns, rows, tag_m, gap_m, 2 if "kalibr" in marks else 1, first)
    raise ValueError(kind)


def _check(board: Board, word: str) -> None:
    """Raise InputError where a board cannot be what is written."""
    least = 3 if isinstance(board, Charuco) else 2 if isinstance(board, Chessboard) else 1
    if not (least <= board.columns <= MOST and least <= board.rows <= MOST):
        raise InputError(f"board '{word}': columns and rows are {least} to {MOST}")
    if not 0.0 < square_of(board) <= 5.0:
        raise InputError(f"board '{word}': sizes are millimetres above 0 and up to 5000")
    if isinstance(board, Charuco) and not 0.0 < board.marker_m < board.square_m:
        raise InputError(f"board '{word}': markers are smaller than squares")
    if isinstance(board, Charuco) and board.columns * board.rows > 2000:
        raise InputError(f"board '{word}': a dictionary has 1000 markers, which is 2000 squares at most")
    if isinstance(board, AprilGrid) and not 0.0 < board.gap_m <= 10.0 * board.tag_m:
        raise InputError(f"board '{word}': gaps are more than nothing and up to ten tags wide")
    if isinstance(board, AprilGrid) and not 0 <= board.first_id <= 587 - board.columns * board.rows:
        raise InputError(f"board '{word}': tag36h11 has 587 tags, 0 to 586")


def _whole(dictionary: str) -> str:
    """Return the dictionary that contains a named one; raises ValueError for one that is not known."""
    name = dictionary.removeprefix("dict_")
    for known in DICTIONARIES:
        if name == known or name.split("_")[0] == known.split("_")[0] != "apriltag":
            return known
    raise ValueError(dictionary)


def _is_number(part: str) -> bool:
    return part.replace(".", "", 1).isdecimal()


def _mm(length_m: float) -> str:
    return f"{1000.0 * length_m:.6g}"


def _grid(columns: int, rows: int, step_m: float) -> Array:
    """Return (columns * rows, 3) points, row by row."""
    y, x = np.divmod(np.arange(columns * rows), columns)
    return np.stack([x * step_m, y * step_m, np.zeros(columns * rows)], axis=-1)
