"""Which lines of sight a box in the room blocks. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


def blocked(origins_m: Array, points_m: Array, boxes_m: Sequence[Corners]) -> npt.NDArray[np.bool_]:
    """Tell for broadcastable (..., 3) ends which segments pass through the inside of a box (slab method).

    A segment that only touches a face or ends on one is free, so that a tag lying on a box is seen from above.
    """
    origins, points = np.broadcast_arrays(origins_m, points_m)
    hit = np.zeros(origins.shape[:-1], dtype=bool)
    step = points - origins
    still = np.abs(step) < 1e-12
    safe = np.where(still, 1.0, step)
    for low, high in boxes_m:
        to_low, to_high = (np.asarray(low) - origins) / safe, (np.asarray(high) - origins) / safe
        outside = still & ((origins <= np.asarray(low)) | (origins >= np.asarray(high)))
        enter = np.where(still, -np.inf, np.minimum(to_low, to_high)).max(axis=-1)
        leave = np.where(still, np.inf, np.maximum(to_low, to_high)).min(axis=-1)
        inside = np.minimum(leave, 1.0) - np.maximum(enter, 0.0) > 1e-9
        hit |= inside & ~outside.any(axis=-1)
    return hit
