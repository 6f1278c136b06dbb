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


def least_distance(start_a: Array, end_a: Array, start_b: Array, end_b: Array) -> float:
    """Return the least distance between two straight segments, whenever each is flown; (2,) or (3,) points."""
    u, v, w = end_a - start_a, end_b - start_b, start_a - start_b
    candidates = [_to_segment(p, start_b, end_b) for p in (start_a, end_a)]
    candidates += [_to_segment(p, start_a, end_a) for p in (start_b, end_b)]
    uu, uv, vv = float(u @ u), float(u @ v), float(v @ v)
    det = uu * vv - uv * uv
    if det > 1e-12 * max(uu * vv, 1e-300):
        s = (uv * float(v @ w) - vv * float(u @ w)) / det
        t = (uu * float(v @ w) - uv * float(u @ w)) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            candidates.append(float(np.linalg.norm(w + s * u - t * v)))
    return min(candidates)


def _to_segment(point: Array, start: Array, end: Array) -> float:
    along = end - start
    length2 = float(along @ along)
    share = float(np.clip((point - start) @ along / length2, 0.0, 1.0)) if length2 > 0.0 else 0.0
    return float(np.linalg.norm(point - start - share * along))
