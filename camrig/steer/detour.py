"""A way round for a drone that cannot go straight: one corner, in nobody's way. Not a motion planner."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from camrig.geometry.airspace import blocked, eased, flight_box, widened
from camrig.geometry.arrays import Array
from camrig.steer.sky import Sky

_CORNERS = (9, 9, 3)
"""Points tried along each axis of the drone's box."""
_MARGIN_M = 0.05
"""A way round that grazes a keep-out box would be blocked by the drone's drift before it is flown."""


def way_round(sky: Sky, name: str, ends_m: Mapping[str, Array]) -> Array | None:
    """Return the corner of the shortest way round to the drone's end, or None.

    To the corner the way is free now; there the drone is in nobody's way, and from there it is free once the others
    are at their ends. So two drones that want each other's places pass, and so a keep-out box is flown round.
    """
    place_m, end_m, keep_out_m = sky.places_m[name], ends_m[name], widened(sky.rig.space.keep_out_m, _MARGIN_M)
    low, high = flight_box(sky.rig.drones[name].box_m)
    axes = [np.linspace(a, b, count) for a, b, count in zip(low, high, _CORNERS, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    corners = corners[~blocked(place_m, corners, eased(keep_out_m, place_m))]
    corners = corners[~blocked(corners, end_m, eased(keep_out_m, end_m))]
    now = {other: path for other, path in sky.paths_m.items() if other != name}
    corners = corners[~sky.too_near(name, _flights(place_m, corners), now).any(axis=1)]
    later = now | {other: sky.path(other, ends_m[other]) for other in now.keys() & ends_m.keys()}
    corners = corners[~sky.too_near(name, _flights(corners, corners), later).any(axis=1)]
    last = now | {other: np.broadcast_to(ends_m[other], (3, 2, 3)) for other in now.keys() & ends_m.keys()}
    corners = corners[~sky.too_near(name, _flights(corners, end_m), last).any(axis=1)]
    lengths_m = np.linalg.norm(corners - place_m, axis=-1) + np.linalg.norm(end_m - corners, axis=-1)
    return np.asarray(corners[int(np.argmin(lengths_m))]) if len(corners) else None


def _flights(starts_m: Array, ends_m: Array) -> Array:
    """Return (c, 2, 3) straight segments."""
    return np.stack(np.broadcast_arrays(starts_m, ends_m), axis=1)
