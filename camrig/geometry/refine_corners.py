"""Corners of square tags, refined through the lens: edges are straight only where the lens's bend is taken out.

A detector fits straight lines to edges that the lens has bent, and its corners are off by two thirds of the bend. Here
each edge is followed along its curve on the raw picture (geometry.edge_profiles); where the profiles put it, a straight
line is fitted in the ideal plane, and corners are where lines meet. The first round starts from the detector's
corners, each other one from those of the round before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.edge_profiles import SHARP_PX, Crossings, Flags, cross, middle_of
from camrig.geometry.lens import Lens

ROUNDS = (12, 32, 32, 32)
SETTLED_PX = 0.1
"""Profiles along each edge, round by round; from the second on it ends where no corner moved further than that."""
SAMPLES = 11
"""Samples along each profile."""
REACH_PX = 3.0
LEAST_REACH_PX = 0.5
SPARE_SIGMAS = 1.8
"""Profiles reach ``REACH_PX`` to both sides, or as far as the cells beside the edge allow: the blurred grey of the next
cell comes so many sigmas nearer than its side. With less than ``LEAST_REACH_PX`` a tag's cells are too small.
"""
TRIM_PX = 1.5
TRIM_SHARE = 0.05
"""What is left out at both ends of an edge, where the next edge bends it: the larger of the two."""
MOST_TRIMMED = 0.4
MOST_BLURRED_PX = 1.5
"""One edge blurred more than this, or too much for its cells, spoils the tag: it is out of focus, or moved."""
LEAST_GOOD = 0.6
"""The part of an edge's profiles that must agree with its line."""
DOUBTED_PX = 0.1
"""A profile further off its edge's line than this and three sigma of the others counts nothing."""
MOST_MOVED_PX = 0.15
MOST_MOVED_WIDTHS = 0.02
"""A corner that moved further than the sum of both has found other edges than its own."""

_NEXT, _BEFORE, _ACROSS = [1, 2, 3, 0], [3, 0, 1, 2], [2, 3, 0, 1]


@dataclass(frozen=True, slots=True, eq=False)
class RefinedCorners:
    """Corners (k, 4, 2) in pixels, and which of them (k, 4) were refined; the others are as they were given."""

    corners_px: Array
    refined: Flags


@dataclass(frozen=True, slots=True, eq=False)
class _Traces:
    """Points along the edges of k tags as the lens bends them; edge j goes from corner j to the next.

    ``normal`` (k, 4, 2) points out of the tag in the ideal plane; ``along`` (k, 4, n) runs from -1 to 1 from corner to
    corner; ``at_px`` (k, 4, n, 2); ``outward`` unit vectors across the edge in pixels; ``ideal_per_px`` (k, 4, n).
    """

    normal: Array
    along: Array
    at_px: Array
    outward: Array
    ideal_per_px: Array


def refine_corners(image: GreyImage, lens: Lens, corners_px: Array, cells: Array) -> RefinedCorners:
    """Refine the corners (k, 4, 2) of tags in a raw grey picture; a tag is ``cells`` (k,) cells wide between them.

    Black squares on white or white on black; OpenCV's pixel convention, any order round the square. A corner stays as
    it was given where one of its edges is hidden, too blurred, past the lens's ``r_max`` or in cells too small, and
    where it would move further than a detector errs.
    """
    given_px = np.asarray(corners_px, dtype=np.float64)
    ideal = lens.unproject(given_px)
    usable = np.isfinite(ideal).all(axis=(1, 2)) & _convex(ideal, 1.0 / max(lens.focal_px))
    at_px, refined = given_px.copy(), np.zeros(given_px.shape[:2], dtype=bool)
    if usable.any():
        at_px[usable], refined[usable] = _refined(image, lens, given_px[usable], ideal[usable], cells[usable])
    return RefinedCorners(at_px, refined)


def _refined(image: GreyImage, lens: Lens, given_px: Array, ideal: Array, cells: Array) -> tuple[Array, Flags]:
    cell_px, length_px = _cells_px(given_px, cells)
    trim = np.clip(TRIM_PX / length_px, TRIM_SHARE, MOST_TRIMMED)
    limit_px = MOST_MOVED_PX + MOST_MOVED_WIDTHS * np.sqrt(_area(given_px))[:, None]
    corners, at_px, blur_px = ideal.copy(), given_px.copy(), np.full(trim.shape, SHARP_PX)
    share, near = np.zeros(trim.shape), np.ones(trim.shape, dtype=bool)
    rows = np.arange(len(given_px))  # of the tags that are not settled yet
    for count, profiles in enumerate(ROUNDS, 1):
        traces = _traces(lens, corners[rows], trim[rows], profiles)
        reach_px = np.clip(cell_px[rows] - SPARE_SIGMAS * blur_px[rows], LEAST_REACH_PX, REACH_PX)
        found = cross(image, traces.at_px, traces.outward, reach_px, SAMPLES, None if count == 1 else blur_px[rows])
        shift, share[rows] = _lines(traces, found)
        moved = _meet(corners[rows], traces.normal, shift)
        moved_px = _pixels(lens, moved)
        close = _length(moved_px - given_px[rows]) <= limit_px[rows]
        settled = ((_length(moved_px - at_px[rows]) < SETTLED_PX) | ~close).all(axis=1)
        blur_px[rows], near[rows] = found.sigma_px, close
        corners[rows] = np.where(close[..., None], moved, ideal[rows])
        at_px[rows] = np.where(close[..., None], moved_px, given_px[rows])
        rows = rows[~settled] if count > 1 else rows
        if not len(rows):
            break
    sharp = (blur_px <= MOST_BLURRED_PX) & (cell_px - SPARE_SIGMAS * blur_px >= LEAST_REACH_PX)
    good = (share >= LEAST_GOOD) & sharp.all(axis=1, keepdims=True)
    believed = good & good[:, _BEFORE] & near
    return np.where(believed[..., None], at_px, given_px), believed


def _traces(lens: Lens, corners: Array, trim: Array, profiles: int) -> _Traces:
    """Follow the edges between (k, 4, 2) ideal corners, ``trim`` (k, 4) of them left out at both ends."""
    sides = corners[:, _NEXT] - corners
    turns = np.sign(_cross(sides[:, 0], sides[:, 1]))[:, None]
    size = _length(sides) * turns
    nx, ny = sides[..., 1] / size, -sides[..., 0] / size
    along = (1.0 - 2.0 * trim[..., None]) * np.linspace(-1.0, 1.0, profiles)
    points = corners[:, :, None] + (0.5 + 0.5 * along[..., None]) * sides[:, :, None]
    J = lens.jacobian(points) * np.asarray(lens.focal_px)[:, None]
    # Across an edge in pixels is where the ideal distance from it grows fastest: J^-T normal.
    across = np.empty(points.shape)
    across[..., 0] = J[..., 1, 1] * nx[..., None] - J[..., 1, 0] * ny[..., None]
    across[..., 1] = J[..., 0, 0] * ny[..., None] - J[..., 0, 1] * nx[..., None]
    across /= (J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0])[..., None]
    ideal_per_px = _length(across)
    normal = np.stack([nx, ny], axis=-1)
    return _Traces(normal, along, _pixels(lens, points), across / ideal_per_px[..., None], ideal_per_px)


def _lines(traces: _Traces, found: Crossings) -> tuple[Array, Array]:
    """Fit a straight line to each edge in the ideal plane, robustly (Tukey's biweight).

    Return (k, 4, 2) how far it lies outwards at the first and the second corner, and (k, 4) the part of the profiles
    that agree with it.
    """
    shift, seen = found.shift_px * traces.ideal_per_px, found.seen
    base = seen / np.square(traces.ideal_per_px)
    weight, off_px, limit_px = base, np.zeros(shift.shape), np.full((*shift.shape[:2], 1), np.inf)
    fit = np.zeros((2, *shift.shape[:2], 1))
    for _ in range(2):
        fit = _weighted_line(traces.along, shift, weight)
        off_px = np.abs(shift - fit[0] - fit[1] * traces.along) / traces.ideal_per_px
        usual_px = middle_of(np.where(seen, off_px, 0.0))[..., None]
        limit_px = np.maximum(DOUBTED_PX, 3.0 * 1.4826 * usual_px)
        weight = base * np.square(1.0 - np.square(np.minimum(off_px / limit_px, 1.0)))
    share = (seen & (off_px < limit_px)).mean(axis=-1)
    return np.concatenate([fit[0] - fit[1], fit[0] + fit[1]], axis=-1), share


def _weighted_line(x: Array, y: Array, weight: Array) -> Array:
    """Return (2, ..., 1) the intercepts and slopes of weighted lines through (..., n) points."""
    total = np.maximum(weight.sum(axis=-1, keepdims=True), 1e-300)
    x_mean, y_mean = ((weight * part).sum(axis=-1, keepdims=True) / total for part in (x, y))
    spread = (weight * np.square(x - x_mean)).sum(axis=-1, keepdims=True)
    slope = (weight * (x - x_mean) * (y - y_mean)).sum(axis=-1, keepdims=True) / np.maximum(spread, 1e-300)
    return np.stack([y_mean - slope * x_mean, slope])


def _meet(corners: Array, normal: Array, shift: Array) -> Array:
    """Shift each edge at its ends (k, 4, 2) along its normal; return the corners (k, 4, 2) where edges meet then."""
    start, sides = corners + shift[..., :1] * normal, corners[:, _NEXT] - corners
    along = sides + (shift[..., 1:] - shift[..., :1]) * normal
    start_before, along_before = start[:, _BEFORE], along[:, _BEFORE]
    turn = _cross(along_before, along)
    parallel = np.abs(turn) < 1e-15
    reach = _cross(along_before, start_before - start) / np.where(parallel, 1.0, turn)
    return np.where(parallel[..., None], corners, start + reach[..., None] * along)


def _cells_px(corners_px: Array, cells: Array) -> tuple[Array, Array]:
    """Return (k, 4) the width, across each edge, of the row of cells along it, and the length of each edge."""
    sides = corners_px[:, _NEXT] - corners_px
    length = np.maximum(_length(sides), 1e-9)
    turn = np.abs(_cross(sides[:, _BEFORE], sides))  # at the edge's first corner
    height = (turn + turn[:, _NEXT]) / (2.0 * length)
    # In perspective the far side's cells are the smaller ones.
    nearness = np.minimum(2.0 * length / (length + length[:, _ACROSS]), 1.0)
    return height * nearness / cells[:, None], length


def _convex(ideal: Array, least: float) -> Flags:
    """Tell which of (k, 4, 2) quads turn one way at every corner, with sides longer than ``least``."""
    sides = ideal[:, _NEXT] - ideal
    turns = _cross(sides[:, _BEFORE], sides)
    long = (_length(sides) > least).all(axis=1)
    one_way = (turns > least * least).all(axis=1) | (turns < -least * least).all(axis=1)
    return np.asarray(long & one_way)


def _area(corners: Array) -> Array:
    return 0.5 * np.abs(_cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _length(vectors: Array) -> Array:
    return np.asarray(np.hypot(vectors[..., 0], vectors[..., 1]))


def _pixels(lens: Lens, ideal: Array) -> Array:
    return np.asarray(lens.distort(ideal) * np.asarray(lens.focal_px) + np.asarray(lens.centre_px))
