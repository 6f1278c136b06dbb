"""Pictures of a board as material for a lens: how sharp, which repeat others, what they cover and what they lack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from camrig.calibrate.boards import AprilGrid, Board, BoardView, Charuco, Ids
from camrig.geometry.arrays import Array, GreyImage

CELLS = (8, 6)
"""Columns and rows of the coverage gauge."""

FEWEST_POINTS = 6
_SAME_SHARE = 0.004
"""A picture whose points all moved by less than this share of the picture's width repeats another."""

_EDGES = 40
_SAMPLES = 33
_SHARPEST_PX = 1.0
_TILTED_RAD = np.radians(15.0)
_FAR_APART = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A picture's board, and how many pixels its edges take from black to white."""

    name: str
    view: BoardView
    edge_px: float


@dataclass(frozen=True, slots=True)
class Gauges:
    """What pictures cover: the share of the picture's cells with points; from how far to how far the board's size is
    seen, largest over smallest; the largest tilt, and to how many of four sides the board was tilted.
    """

    coverage: float
    size_ratio: float
    tilt_rad: float
    sides: int


def edge_width_px(image: GreyImage, view: BoardView, board: Board) -> float:
    """Return over how many pixels the board's edges rise, of the softer quarter of them; NaN where none was seen."""
    at = {int(number): corner for number, corner in zip(view.ids, view.corners_px, strict=True)}
    pairs = [(at[a], at[b]) for a, b in _edges(board) if a in at and b in at]
    if not pairs:
        return float("nan")
    ends = np.array(pairs[:: -(-len(pairs) // _EDGES)])
    along = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, None]
    reach = np.minimum(0.4 * length, 8.0)
    steps = np.linspace(-1.0, 1.0, _SAMPLES)
    where = ends.mean(axis=1)[:, None] + across[:, None] * (reach[:, None] * steps)[..., None]
    x, y = (np.ascontiguousarray(where[..., axis], np.float32) for axis in (0, 1))
    sampled = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    steepest = np.abs(np.diff(sampled, axis=1)).max(axis=1) / (reach * (steps[1] - steps[0]))
    width = np.ptp(sampled, axis=1) / np.maximum(steepest, 1e-6)
    return float(max(np.percentile(width, 75.0), _SHARPEST_PX))


def _edges(board: Board) -> list[tuple[int, int]]:
    """Return pairs of ids between which black meets white."""
    if isinstance(board, AprilGrid):
        tags = range(board.columns * board.rows)
        return [(4 * tag + corner, 4 * tag + (corner + 1) % 4) for tag in tags for corner in range(4)]
    columns = board.columns - 1 if isinstance(board, Charuco) else board.columns
    rows = board.rows - 1 if isinstance(board, Charuco) else board.rows
    level = [(y * columns + x, y * columns + x + 1) for y in range(rows) for x in range(columns - 1)]
    upright = [(y * columns + x, (y + 1) * columns + x) for y in range(rows - 1) for x in range(columns)]
    return level + upright


def shift_px(a: BoardView, b: BoardView) -> float:
    """Return the rms distance of the points that two pictures share; infinite where they share none."""
    common, in_a, in_b = np.intersect1d(a.ids, b.ids, return_indices=True)
    if not len(common):
        return float("inf")
    return float(np.sqrt(np.mean(np.square(a.corners_px[in_a] - b.corners_px[in_b]).sum(axis=-1))))


def repeats(shots: Sequence[Shot], width_px: int) -> dict[str, str]:
    """Return the pictures that show the board where another before them does, and which one."""
    found: dict[str, str] = {}
    kept: list[Shot] = []
    for shot in shots:
        same = next((each for each in kept if shift_px(each.view, shot.view) < _SAME_SHARE * width_px), None)
        if same is None:
            kept.append(shot)
        else:
            found[shot.name] = same.name
    return found


def spread_out(shots: Sequence[Shot], most: int) -> list[Shot]:
    """Return at most so many pictures, those farthest from each other, in their order."""
    if len(shots) <= most:
        return list(shots)
    far = np.full(len(shots), np.inf)
    chosen = [int(np.argmax([len(shot.view.ids) for shot in shots]))]
    while len(chosen) < most:
        shifts = [min(shift_px(shots[chosen[-1]].view, shot.view), 1e6) for shot in shots]
        far = np.minimum(far, shifts)
        chosen.append(int(np.argmax(far)))
    return [shots[index] for index in sorted(set(chosen))]


def gauges(views: Sequence[BoardView], board: Board, size_px: tuple[int, int], leans: Array | None = None) -> Gauges:
    """Judge what pictures cover; tilts by how the plane foreshortens, or by (n, 2) x and y of the board's normals where
    a lens has told them.
    """
    if not views:
        return Gauges(0.0, 1.0, 0.0, 0)
    cells: set[tuple[int, int]] = set()
    for view in views:
        cells |= set(map(tuple, _cell(view.corners_px, size_px).tolist()))
    planes = [_plane(view, board, size_px) for view in views]
    sizes = [size for size, _ in planes]
    tilts = np.array([lean for _, lean in planes]) if leans is None else leans
    reach = np.sin(_TILTED_RAD)
    sides = sum(bool(np.any(sign * tilts[:, axis] > reach)) for axis in (0, 1) for sign in (-1, 1))
    return Gauges(
        len(cells) / (CELLS[0] * CELLS[1]),
        float(max(sizes) / max(min(sizes), 1e-9)),
        float(np.arcsin(min(float(np.hypot(tilts[:, 0], tilts[:, 1]).max()), 1.0))),
        sides,
    )


def _cell(corners_px: Array, size_px: tuple[int, int]) -> Ids:
    share = corners_px / np.asarray(size_px)
    return np.asarray(np.clip(np.floor(share * CELLS), 0, np.asarray(CELLS) - 1), np.int64)


def _plane(view: BoardView, board: Board, size_px: tuple[int, int]) -> tuple[float, tuple[float, float]]:
    """Return how many pixels the board's unit takes, and the x and y of its normal, as a lens of a focal length of the
    picture's width would see it.
    """
    width, height = size_px
    ideal = (view.corners_px - 0.5 * np.array([width, height])) / width
    flat = np.ascontiguousarray(board.points_m[view.ids])
    found, turn, place = cv2.solvePnP(
        flat, np.ascontiguousarray(ideal), np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    if not found:
        return 1.0, (0.0, 0.0)
    R = cv2.Rodrigues(turn)[0]
    normal = R[:, 2] * -np.sign(R[2, 2])
    return float(width / max(abs(float(np.ravel(place)[2])), 1e-9)), (float(normal[0]), float(normal[1]))


def next_pose(views: Sequence[BoardView], board: Board, size_px: tuple[int, int]) -> str:
    """Say how to hold the board for the next picture: where nothing was seen, to which side never tilted, how far."""
    counts = np.zeros((CELLS[1], CELLS[0]))
    for view in views:
        cells = np.unique(_cell(view.corners_px, size_px), axis=0)
        counts[cells[:, 1], cells[:, 0]] += 1
    where = _place(counts)
    if not views:
        return "hold the board in the middle, facing the camera"
    seen = [_plane(view, board, size_px) for view in views]
    leans = np.array([lean for _, lean in seen])
    reach = float(np.sin(_TILTED_RAD))
    missing = [
        name
        for name, axis, sign in (("left", 0, -1), ("right", 0, 1), ("up", 1, -1), ("down", 1, 1))
        if not np.any(sign * leans[:, axis] > reach)
    ]
    tilt = f"turned {missing[0]}" if missing else "tilted as you like"
    sizes = [size for size, _ in seen]
    far = ", nearer or farther than before" if max(sizes) < _FAR_APART * min(sizes) and len(views) > 3 else ""
    return f"hold the board {where}, {tilt}{far}"


def _place(counts: Array) -> str:
    """Name the part of the picture with the fewest pictures of the board."""
    thirds = [(0, 2), (2, 4), (4, 6)], [(0, 3), (3, 5), (5, 8)]
    names = ("at the top", "in the middle", "at the bottom"), ("left", "", "right")
    sums = [
        (counts[top:bottom, left:right].mean(), abs(row - 1) + abs(column - 1), row, column)
        for row, (top, bottom) in enumerate(thirds[0])
        for column, (left, right) in enumerate(thirds[1])
    ]
    _, _, row, column = min(sums, key=lambda each: (each[0], -each[1]))
    return f"{names[0][row]} {names[1][column]}".strip()
