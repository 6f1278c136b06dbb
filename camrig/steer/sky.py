"""Who is in the air, what each drone may still fly over, and what is in the way of a flight.

Drones keep apart horizontally, at all heights: one never flies in the downwash of another.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camrig.geometry.airspace import blocked, eased, least_distance
from camrig.geometry.arrays import Array
from camrig.rig import Rig

_SLACK_M = 0.01
"""What hovering drifts: drones at their places, kept apart exactly, are not too near."""
_NEARER_M = 1e-6


@dataclass(frozen=True, slots=True)
class Sky:
    """Where drones are, and the path of each: (3, 2, 3) straight segments that it may fly before it is told anew."""

    rig: Rig
    places_m: Mapping[str, Array]
    bound_m: Mapping[str, Array]
    """The set-points that drones are still on their way to."""
    paths_m: dict[str, Array]

    def path(self, name: str, point_m: Array) -> Array:
        """Return the segments of a flight to a point.

        A drone on its way to another set-point does not turn on the spot: it may fly on there before it turns.
        """
        place_m, bound_m = self.places_m[name], self.bound_m[name]
        return np.array([[place_m, point_m], [place_m, bound_m], [bound_m, point_m]])

    def obstacle(self, name: str, point_m: Array) -> str:
        """Return what is in the way of a flight to a point, or an empty text."""
        path = self.path(name, point_m)
        if bool(blocked(path[:, 0], path[:, 1], eased(self.rig.space.keep_out_m, self.places_m[name])).any()):
            return "a keep-out box is in the way"
        others = [other for other in self.paths_m if other != name]
        near = self.too_near(name, path, {other: self.paths_m[other] for other in others}).any(axis=0)
        return f"drone {others[int(np.argmax(near))]} is in the way" if near.any() else ""

    def too_near(self, name: str, segments_m: Array, paths_m: Mapping[str, Array]) -> npt.NDArray[np.bool_]:
        """Tell which of (c, 2, 3) segments flown by a drone come too near to which of the others' paths: (c, others).

        Two drones that are too near already may part, but not come nearer.
        """
        if not paths_m:
            return np.zeros((len(segments_m), 0), dtype=bool)
        flown, met = segments_m[:, None, None, :, :2], np.array(list(paths_m.values()))[None, :, :, :, :2]
        gaps_m = least_distance(flown[..., 0, :], flown[..., 1, :], met[..., 0, :], met[..., 1, :]).min(axis=-1)
        away_m = np.array([self.places_m[other] for other in paths_m]) - self.places_m[name]
        present_m = np.hypot(away_m[:, 0], away_m[:, 1])
        return np.asarray(gaps_m < np.minimum(self._least_m(name, paths_m) - _SLACK_M, present_m - _NEARER_M))

    def _least_m(self, name: str, others: Iterable[str]) -> Array:
        own_m = self.rig.drones[name].min_separation_m
        return np.array([max(own_m, self.rig.drones[other].min_separation_m) for other in others])
