"""Where drones may be: boxes, keep-out boxes, and how near two straight flights come. Pure; world metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner of an axis-aligned box."""

MIN_HEIGHT_M = 1.0
"""No drone flies lower, whatever its box says (the paper's z >= 1 m)."""

_EPSILON = 1e-9


def flight_box(box_m: Corners) -> tuple[Array, Array]:
    """Return the (3,) lowest and highest corner of where a drone may hover: its box above ``MIN_HEIGHT_M``."""
    low, high = np.array(box_m[0], dtype=float), np.array(box_m[1], dtype=float)
    low[2] = max(low[2], MIN_HEIGHT_M)
    return low, high


def blocked(origins_m: Array, points_m: Array, boxes_m: Sequence[Corners]) -> npt.NDArray[np.bool_]:
    """Tell for broadcastable (..., 3) ends which straight segments pass through the inside of a box (slab method).

    A segment that only touches a face, or ends on one, is free: a tag lying on a box is seen from above.
    """
    origins, points = np.broadcast_arrays(origins_m, points_m)
    hit = np.zeros(origins.shape[:-1], dtype=bool)
    step = points - origins
    still = np.abs(step) < _EPSILON
    safe = np.where(still, 1.0, step)
    for low, high in boxes_m:
        to_low, to_high = (np.asarray(low) - origins) / safe, (np.asarray(high) - origins) / safe
        beside = still & ((origins <= np.asarray(low)) | (origins >= np.asarray(high)))
        enter = np.where(still, -np.inf, np.minimum(to_low, to_high)).max(axis=-1)
        leave = np.where(still, np.inf, np.maximum(to_low, to_high)).min(axis=-1)
        through = np.minimum(leave, 1.0) - np.maximum(enter, 0.0) > _EPSILON
        hit |= through & ~beside.any(axis=-1)
    return hit


def inside_any(points_m: Array, boxes_m: Sequence[Corners]) -> npt.NDArray[np.bool_]:
    """Tell which (..., 3) points lie strictly inside one of the boxes."""
    inside = np.zeros(points_m.shape[:-1], dtype=bool)
    for low, high in boxes_m:
        inside |= ((points_m > np.asarray(low)) & (points_m < np.asarray(high))).all(axis=-1)
    return inside


def widened(boxes_m: Sequence[Corners], margin_m: float) -> list[Corners]:
    """Return the boxes, every face moved outwards by ``margin_m`` (inwards where it is negative)."""
    r = margin_m
    return [((a - r, b - r, c - r), (d + r, e + r, f + r)) for (a, b, c), (d, e, f) in boxes_m]


def eased(boxes_m: Sequence[Corners], point_m: Array) -> list[Corners]:
    """Return the boxes, those that a (3,) point is inside of made so much smaller that it lies on their surface.

    What is found inside of a box may leave it by the way it came in, and not go deeper.
    """
    found: list[Corners] = []
    for low, high in boxes_m:
        inwards_m = float(np.min([point_m - low, np.asarray(high) - point_m])) + _EPSILON
        if inwards_m <= _EPSILON:
            found.append((low, high))
        elif 2.0 * inwards_m < float(np.min(np.subtract(high, low))):
            found += widened([(low, high)], -inwards_m)
    return found


def least_distance(start_a: Array, end_a: Array, start_b: Array, end_b: Array) -> Array:
    """Return the least distances between straight segments, whenever each is flown; broadcastable (..., 2 or 3)."""
    nearest = np.minimum(_to_segment(start_a, start_b, end_b), _to_segment(end_a, start_b, end_b))
    nearest = np.minimum(nearest, _to_segment(start_b, start_a, end_a))
    nearest = np.minimum(nearest, _to_segment(end_b, start_a, end_a))
    # Between the ends, where both are flown past their point that is nearest to the other's line.
    u, v, w = end_a - start_a, end_b - start_b, start_a - start_b
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    det = uu * vv - uv * uv
    crossing = det > 1e-12 * np.maximum(uu * vv, 1e-300)
    safe = np.where(crossing, det, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    crossing &= (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.where(crossing, np.minimum(nearest, np.sqrt(_dot(gap, gap))), nearest)


def _to_segment(point: Array, start: Array, end: Array) -> Array:
    along = end - start
    share = np.clip(_dot(point - start, along) / np.maximum(_dot(along, along), 1e-300), 0.0, 1.0)
    gap = point - start - share[..., None] * along
    return np.sqrt(_dot(gap, gap))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))


def crosses_box(origin: Array, point: Array, low: Array, high: Array) -> bool:
    """Tell whether a straight segment passes through the inside of a box: ``blocked`` for kernels (geometry.jit)."""
    enter, leave = 0.0, 1.0
    for k in range(3):
        step = point[k] - origin[k]
        if abs(step) < _EPSILON:
            if origin[k] <= low[k] or origin[k] >= high[k]:
                return False
        else:
            to_low, to_high = (low[k] - origin[k]) / step, (high[k] - origin[k]) / step
            enter, leave = max(enter, min(to_low, to_high)), min(leave, max(to_low, to_high))
    return leave - enter > _EPSILON
