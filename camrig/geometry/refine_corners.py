"""Corners of square tags, refined through the lens: edges are straight only where the lens's bend is taken out.

A detector fits straight lines to edges that the lens has bent, and its corners are off by two thirds of the bend. Here
each edge is followed along its curve on the raw picture (geometry.edge_profiles); where the profiles put it, a straight
line is fitted in the ideal plane, and corners are where lines meet. The first round starts from the detector's
corners, each other one from those of the round before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.edge_profiles import SHARP_PX, Flags, cross, upper_median
from camrig.geometry.jit import compiled
from camrig.geometry.lens import Lens
from camrig.geometry.lens_row import CX, CY, FX, FY, lens_row, sensor_at, slopes_at

ROUNDS = (12, 32, 32, 32)
SETTLED_PX = 0.1
"""Profiles along each edge, round by round; from the second on it ends where no corner moved further than that."""
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


@dataclass(frozen=True, slots=True, eq=False)
class RefinedCorners:
    """Corners (k, 4, 2) in pixels, and which of them (k, 4) were refined; the others are as they were given."""

    corners_px: Array
    refined: Flags


def refine_corners(image: GreyImage, lens: Lens, corners_px: Array, cells: Array) -> RefinedCorners:
    """Refine the corners (k, 4, 2) of tags in a raw grey picture; a tag is ``cells`` (k,) cells wide between them.

    Black squares on white or white on black; OpenCV's pixel convention, any order round the square. A corner stays as
    it was given where one of its edges is hidden, too blurred, past the lens's ``r_max`` or in cells too small, and
    where it would move further than a detector errs. The first call of a process loads machine code, or compiles it.
    """
    given_px = np.array(corners_px, dtype=np.float64)
    at_px, refined = given_px.copy(), np.zeros(given_px.shape[:2], dtype=bool)
    picture = np.ascontiguousarray(image).view()
    picture.flags.writeable = False  # one kind of array, or each would be compiled for
    row, ideal = lens_row(lens), lens.unproject(given_px)
    for k in np.flatnonzero(np.isfinite(ideal).all(axis=(1, 2))):
        _refine(picture, row, given_px[k], ideal[k], float(cells[k]), at_px[k], refined[k])
    return RefinedCorners(at_px, refined)


@compiled
def _refine(
    image: GreyImage, lens: Array, given_px: Array, ideal: Array, cells: float, at_px: Array, refined: Flags
) -> None:
    """Refine one tag's (4, 2) corners if they are a square's; ``at_px`` comes in as they were given."""
    if not _convex(ideal, 1.0 / max(lens[FX], lens[FY])):
        return
    cell_px, trim = np.empty(4), np.empty(4)
    _cells(given_px, cells, cell_px, trim)
    limit_px = MOST_MOVED_PX + MOST_MOVED_WIDTHS * math.sqrt(_area(given_px))
    corners, met = ideal.copy(), np.empty((4, 2))
    sigma_px, reach_px = np.zeros(4), np.empty(4)
    share, near, settled = np.zeros(4), np.ones(4, np.bool_), False
    for count, profiles in enumerate(ROUNDS):
        for edge in range(4):
            blur_px = sigma_px[edge] if count > 0 else SHARP_PX
            reach_px[edge] = min(max(cell_px[edge] - SPARE_SIGMAS * blur_px, LEAST_REACH_PX), REACH_PX)
        _meet(image, lens, corners, trim, profiles, reach_px, sigma_px, share, met)
        settled = True
        for corner in range(4):
            u, v = sensor_at(lens, met[corner, 0], met[corner, 1])
            x, y = lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
            near[corner] = math.hypot(x - given_px[corner, 0], y - given_px[corner, 1]) <= limit_px
            if near[corner]:
                settled &= math.hypot(x - at_px[corner, 0], y - at_px[corner, 1]) < SETTLED_PX
            for axis in range(2):
                corners[corner, axis] = met[corner, axis] if near[corner] else ideal[corner, axis]
            at_px[corner, 0] = x if near[corner] else given_px[corner, 0]
            at_px[corner, 1] = y if near[corner] else given_px[corner, 1]
        if settled and count > 0:
            break
    sharp = True
    for edge in range(4):
        sharp &= sigma_px[edge] <= MOST_BLURRED_PX and cell_px[edge] - SPARE_SIGMAS * sigma_px[edge] >= LEAST_REACH_PX
    for corner in range(4):
        refined[corner] = sharp and near[corner] and min(share[corner], share[corner - 1]) >= LEAST_GOOD
        if not refined[corner]:
            at_px[corner, 0], at_px[corner, 1] = given_px[corner, 0], given_px[corner, 1]


@compiled
def _meet(
    image: GreyImage,
    lens: Array,
    corners: Array,
    trim: Array,
    profiles: int,
    reach_px: Array,
    sigma_px: Array,
    share: Array,
    met: Array,
) -> None:
    """Fill in ``met`` (4, 2), the ideal corners where the edges meet that the picture shows near those between
    ``corners``; edge j goes from corner j to the next. Fills in ``sigma_px`` where it is 0, and ``share``, the part of
    each edge's profiles that agree with its line.
    """
    along, per_px, normal = np.empty((4, profiles)), np.empty((4, profiles)), np.empty((4, 2))
    at_px, outward = np.empty((4, profiles, 2)), np.empty((4, profiles, 2))
    _trace(lens, corners, trim, along, normal, at_px, outward, per_px)
    shift_px, seen = np.empty((4, profiles)), np.empty((4, profiles), np.bool_)
    cross(image, at_px, outward, reach_px, sigma_px, shift_px, seen)
    start, way = np.empty((4, 2)), np.empty((4, 2))
    for edge in range(4):
        first, last, share[edge] = _line(along[edge], shift_px[edge], per_px[edge], seen[edge])
        for axis in range(2):
            start[edge, axis] = corners[edge, axis] + first * normal[edge, axis]
            side = corners[(edge + 1) % 4, axis] - corners[edge, axis]
            way[edge, axis] = side + (last - first) * normal[edge, axis]
    for corner in range(4):
        before_x, before_y = way[corner - 1, 0], way[corner - 1, 1]
        turn = before_x * way[corner, 1] - before_y * way[corner, 0]
        dx, dy = start[corner - 1, 0] - start[corner, 0], start[corner - 1, 1] - start[corner, 1]
        reach = (before_x * dy - before_y * dx) / turn
        for axis in range(2):
            parallel = abs(turn) < 1e-15
            met[corner, axis] = corners[corner, axis] if parallel else start[corner, axis] + reach * way[corner, axis]


@compiled
def _trace(
    lens: Array,
    corners: Array,
    trim: Array,
    along: Array,
    normal: Array,
    at_px: Array,
    outward: Array,
    per_px: Array,
) -> None:
    """Follow the edges as the lens bends them, ``trim`` (4,) of each left out at both ends.

    Fills ``normal`` (4, 2), pointing out of the tag in the ideal plane; and for n points along each edge ``along``
    (4, n), from -1 to 1 from corner to corner, ``at_px`` (4, n, 2), ``outward``, unit vectors across the edge in
    pixels, and ``per_px`` (4, n), ideal distance across the edge for each of those pixels.
    """
    turn = math.copysign(1.0, _turn(corners, 0))
    profiles = along.shape[1]
    for edge in range(4):
        x0, y0 = corners[edge, 0], corners[edge, 1]
        dx, dy = corners[(edge + 1) % 4, 0] - x0, corners[(edge + 1) % 4, 1] - y0
        size = math.hypot(dx, dy) * turn
        nx, ny = dy / size, -dx / size
        normal[edge, 0], normal[edge, 1] = nx, ny
        for i in range(profiles):
            along[edge, i] = (1.0 - 2.0 * trim[edge]) * (2.0 * i / (profiles - 1) - 1.0)
            a, b = x0 + (0.5 + 0.5 * along[edge, i]) * dx, y0 + (0.5 + 0.5 * along[edge, i]) * dy
            u, v = sensor_at(lens, a, b)
            at_px[edge, i, 0], at_px[edge, i, 1] = lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
            ua, ub, va, vb = slopes_at(lens, a, b)
            # Across an edge in pixels is where the ideal distance from it grows fastest: J^-T normal.
            det = lens[FX] * lens[FY] * (ua * vb - ub * va)
            x, y = lens[FY] * (vb * nx - va * ny) / det, lens[FX] * (ua * ny - ub * nx) / det
            per_px[edge, i] = math.hypot(x, y)
            outward[edge, i, 0], outward[edge, i, 1] = x / per_px[edge, i], y / per_px[edge, i]


@compiled
def _line(along: Array, shift_px: Array, per_px: Array, seen: Flags) -> tuple[float, float, float]:
    """Fit a straight line to an edge's (n,) profiles in the ideal plane, robustly (Tukey's biweight).

    Return how far it lies outwards at the first and at the second corner, and the part of the profiles that agree.
    """
    n = len(along)
    weight, off_px = np.empty(n), np.empty(n)
    level, slope, limit_px, agree = 0.0, 0.0, np.inf, 0
    for i in range(n):
        weight[i] = 1.0 / per_px[i] ** 2 if seen[i] else 0.0
    for _ in range(2):
        total, x, y, spread, bend = 1e-300, 0.0, 0.0, 1e-300, 0.0
        for i in range(n):
            total += weight[i]
            x += weight[i] * along[i]
            y += weight[i] * shift_px[i] * per_px[i]
        x, y = x / total, y / total
        for i in range(n):
            spread += weight[i] * (along[i] - x) ** 2
            bend += weight[i] * (along[i] - x) * (shift_px[i] * per_px[i] - y)
        slope = bend / spread
        level = y - slope * x
        for i in range(n):
            off_px[i] = abs(shift_px[i] - (level + slope * along[i]) / per_px[i]) if seen[i] else 0.0
        limit_px = max(DOUBTED_PX, 3.0 * 1.4826 * upper_median(off_px))
        agree = 0
        for i in range(n):
            weight[i] = (1.0 - min(off_px[i] / limit_px, 1.0) ** 2) ** 2 / per_px[i] ** 2 if seen[i] else 0.0
            agree += seen[i] and off_px[i] < limit_px
    return level - slope, level + slope, agree / n


@compiled
def _cells(corners_px: Array, cells: float, cell_px: Array, trim: Array) -> None:
    """Fill in (4,) the width, across each edge, of the row of cells along it, and the share to trim at its ends."""
    length = np.empty(4)
    for edge in range(4):
        length[edge] = max(_length(corners_px, edge), 1e-9)
    for edge in range(4):
        turns = abs(_turn(corners_px, edge - 1)) + abs(_turn(corners_px, edge))
        # In perspective the far side's cells are the smaller ones.
        nearness = min(2.0 * length[edge] / (length[edge] + length[(edge + 2) % 4]), 1.0)
        cell_px[edge] = turns / (2.0 * length[edge]) * nearness / cells
        trim[edge] = min(max(TRIM_PX / length[edge], TRIM_SHARE), MOST_TRIMMED)


@compiled
def _convex(ideal: Array, least: float) -> bool:
    """Tell whether a (4, 2) quad turns one way at every corner, with sides longer than ``least``."""
    turns = 0
    for edge in range(4):
        turn = _turn(ideal, edge)
        if not (_length(ideal, edge) > least and abs(turn) > least * least):
            return False
        turns += 1 if turn > 0.0 else -1
    return abs(turns) == 4


@compiled
def _length(corners: Array, edge: int) -> float:
    """Return the length of an edge."""
    after = (edge + 1) % 4
    return math.hypot(corners[after, 0] - corners[edge, 0], corners[after, 1] - corners[edge, 1])


@compiled
def _turn(corners: Array, edge: int) -> float:
    """Return the cross product of an edge and the next one."""
    after, last = (edge + 1) % 4, (edge + 2) % 4
    dx, dy = corners[after, 0] - corners[edge, 0], corners[after, 1] - corners[edge, 1]
    next_x, next_y = corners[last, 0] - corners[after, 0], corners[last, 1] - corners[after, 1]
    return dx * next_y - dy * next_x  # type: ignore[no-any-return]


@compiled
def _area(corners: Array) -> float:
    across_x, across_y = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
    twice = across_x * (corners[3, 1] - corners[1, 1]) - across_y * (corners[3, 0] - corners[1, 0])
    return 0.5 * abs(float(twice))
