"""What is black on a calibration board, as rectangles in its own frame; sheets and pictures are made of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from camrig.calibrate.boards import DICTIONARIES, AprilGrid, Board, Charuco, Chessboard
from camrig.geometry.arrays import Array, GreyImage

Rectangle = tuple[float, float, float, float]
"""``x0, y0, x1, y1`` in metres, x0 < x1 and y0 < y1."""


def black(board: Board) -> Array:
    """Return the (n, 4) black rectangles of a board. Only grids like Kalibr's have small squares at the corners of
    their tags: most detectors lose tags that touch anything.
    """
    if isinstance(board, Chessboard):
        s = board.square_m
        squares = [(x, y) for y in range(-1, board.rows) for x in range(-1, board.columns) if (x + y) % 2 == 0]
        return np.array([(x * s, y * s, (x + 1) * s, (y + 1) * s) for x, y in squares])
    if isinstance(board, Charuco):
        return _inside_out(board) if board.inverted else np.array(list(_charuco(board)))
    return np.array([*_tags(board), *(_corner_squares(board) if board.like_kalibrs else ())])


def extent(board: Board) -> Rectangle:
    """Return the smallest rectangle that holds all of a board."""
    if isinstance(board, Charuco):
        return 0.0, 0.0, board.columns * board.square_m, board.rows * board.square_m
    rectangles = black(board)
    x0, y0 = rectangles[:, :2].min(axis=0)
    x1, y1 = rectangles[:, 2:].max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def picture(board: Board, px_per_m: float, margin_m: float) -> tuple[GreyImage, Array]:
    """Draw a board upright with a white margin; return the (height, width) picture, and the (2, 3) affine map from the
    board's x, y in metres to pixels, OpenCV's convention.
    """
    x0, y0, x1, y1 = extent(board)
    width, height = (round((length + 2.0 * margin_m) * px_per_m) for length in (x1 - x0, y1 - y0))
    up = isinstance(board, AprilGrid)
    to_px = np.array(
        [
            [px_per_m, 0.0, (margin_m - x0) * px_per_m],
            [0.0, -px_per_m if up else px_per_m, (margin_m + y1 if up else margin_m - y0) * px_per_m],
        ]
    )
    ink = np.zeros((height, width))
    for left, top, right, bottom in black(board):
        edges = np.array([[left, top, 1.0], [right, bottom, 1.0]]) @ to_px.T
        (x, y), (along_x, along_y) = edges.min(axis=0), edges.max(axis=0)
        (first_x, part_x), (first_y, part_y) = _coverage(x, along_x, width), _coverage(y, along_y, height)
        ink[first_y : first_y + len(part_y), first_x : first_x + len(part_x)] += np.outer(part_y, part_x)
    to_px[:, 2] -= 0.5  # from edges of pixels to their centres
    return np.round(255.0 * (1.0 - np.clip(ink, 0.0, 1.0))).astype(np.uint8), to_px


def _coverage(start_px: float, end_px: float, length: int) -> tuple[int, Array]:
    """Return the first pixel that an interval touches, and what part of each from there on it covers."""
    first, last = max(math.floor(start_px), 0), min(math.ceil(end_px), length)
    pixels = np.arange(first, last)
    return first, np.minimum(pixels + 1.0, end_px) - np.maximum(pixels, start_px)


def _charuco(board: Charuco) -> Iterator[Rectangle]:
    s, edge = board.square_m, 0.5 * (board.square_m - board.marker_m)
    offset = 1 if board.legacy and board.rows % 2 == 0 else 0
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[board.dictionary])
    marker = 0
    for y in range(board.rows):
        for x in range(board.columns):
            if (x + y) % 2 == offset:
                yield x * s, y * s, (x + 1) * s, (y + 1) * s
                continue
            cells = _cells(dictionary, marker, 1)
            yield from _placed(cells, x * s + edge, y * s + edge, board.marker_m / len(cells))
            marker += 1


def _inside_out(board: Charuco) -> Array:
    """Return what is white on a ChArUco board as rectangles, row of cells by row, within its extent."""
    rectangles = np.array(list(_charuco(board)))
    xs, ys = (_edges(rectangles[:, [axis, axis + 2]], length) for axis, length in enumerate(_size(board)))
    free = np.ones((len(ys) - 1, len(xs) - 1), bool)
    for x0, y0, x1, y1 in rectangles:
        (left, right), (top, bottom) = np.searchsorted(xs, (x0, x1), "left"), np.searchsorted(ys, (y0, y1), "left")
        free[top:bottom, left:right] = False
    rows, columns = np.nonzero(free)
    return np.stack([xs[columns], ys[rows], xs[columns + 1], ys[rows + 1]], axis=-1)


def _edges(values: Array, length_m: float) -> Array:
    """Return the different edges from 0 to the length, those within a nanometre as one (the least)."""
    ordered = np.sort(np.concatenate([[0.0, length_m], values.ravel()]))
    return np.asarray(ordered[np.concatenate([[True], np.diff(ordered) > 1e-9])])


def _size(board: Charuco) -> tuple[float, float]:
    return board.columns * board.square_m, board.rows * board.square_m


def _tags(board: AprilGrid) -> Iterator[Rectangle]:
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES["apriltag_36h11"])
    pitch = board.tag_m + board.gap_m
    for number in range(board.columns * board.rows):
        y, x = divmod(number, board.columns)
        # OpenCV draws AprilTags turned by 180 degrees, rows from the top: y up undoes the one, columns the other.
        cells = _cells(dictionary, board.first_id + number, board.border_bits)[:, ::-1]
        yield from _placed(cells, x * pitch, y * pitch, board.tag_m / len(cells))


def _corner_squares(board: AprilGrid) -> Iterator[Rectangle]:
    pitch, gap = board.tag_m + board.gap_m, board.gap_m
    for y in range(board.rows + 1):
        for x in range(board.columns + 1):
            yield x * pitch - gap, y * pitch - gap, x * pitch, y * pitch


def _cells(dictionary: cv2.aruco.Dictionary, number: int, border_bits: int) -> GreyImage:
    """Return a marker's cells, border and all, 0 for black."""
    size = dictionary.markerSize + 2 * border_bits
    return np.asarray(dictionary.generateImageMarker(number, size, borderBits=border_bits), np.uint8)


def _placed(cells: GreyImage, x_m: float, y_m: float, cell_m: float) -> Iterator[Rectangle]:
    """Yield a rectangle for each run of black cells of a row."""
    for row, values in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[255], values, [255]]).astype(int)))
        for left, right in edges.reshape(-1, 2):
            yield x_m + left * cell_m, y_m + row * cell_m, x_m + right * cell_m, y_m + (row + 1) * cell_m
