"""How far the sightings of static targets scatter: the repeatability of a rig that needs no ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camrig.geometry.arrays import Array
from camrig.interfaces import Published
from camrig.rig import Rig


@dataclass(frozen=True, slots=True)
class Spread:
    """Of ``n`` sightings: rms 3-D distance from their mean, and median distance from their median."""

    n: int
    mean_m: tuple[float, float, float]
    rms_m: float
    median_m: float


@dataclass
class SpreadSink:
    """Collects the single-camera sightings of every target that the rig calls static."""

    _seen: dict[str, list[Array]] = field(default_factory=dict)

    def open(self, rig: Rig) -> None:
        self._seen = {name: [] for name, body in rig.targets.items() if body.motion == "static"}

    def write(self, published: Published) -> None:
        for sighting in published.sightings:
            if sighting.target_id in self._seen:
                self._seen[sighting.target_id].append(sighting.T_world_body[:3, 3])

    def close(self) -> None:
        """Keep what was collected for ``spreads``."""

    def spreads(self) -> Mapping[str, Spread]:
        """Return the spread of each static target that was seen."""
        return {name: spread(np.array(points)) for name, points in self._seen.items() if points}


def spread(points_m: Array) -> Spread:
    """Return the spread of (n, 3) positions."""
    mean = points_m.mean(axis=0)
    from_mean = np.linalg.norm(points_m - mean, axis=1)
    from_median = np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1)
    x, y, z = (float(value) for value in mean)
    return Spread(len(points_m), (x, y, z), float(np.sqrt(np.mean(from_mean**2))), float(np.median(from_median)))
