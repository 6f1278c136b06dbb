"""Where every camera looks, what that is worth, and whether the drones may be there. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camrig.geometry.airspace import inside_any
from camrig.geometry.arrays import Array
from camrig.optimise.objective import Score, score
from camrig.optimise.scene import DronePlace
from camrig.optimise.sight import Problem, gains


@dataclass(frozen=True, slots=True, eq=False)
class Configuration:
    """One vector a camera, the gains (n, m) there, and their score under the hard visibility."""

    vectors: tuple[Array, ...]
    gains: Array
    score: Score


def configuration(problem: Problem, vectors: tuple[Array, ...]) -> Configuration:
    """Evaluate vectors with the hard visibility."""
    rows = [gains(problem, camera, x[None])[0] for camera, x in zip(problem.cameras, vectors, strict=True)]
    return from_gains(problem, vectors, np.array(rows).reshape(len(rows), len(problem.targets.weights)))


def from_gains(problem: Problem, vectors: tuple[Array, ...], table: Array) -> Configuration:
    """Build the configuration whose (n, m) gains are known already."""
    return Configuration(vectors, table, score(table.sum(axis=0), problem.targets.weights))


def separations(problem: Problem) -> Array:
    """Return the (n, n) metres that each pair of drones keeps horizontally; 0 for any other pair."""
    least = np.array(
        [
            max(camera.place.min_separation_m, problem.settings.min_separation_m)
            if isinstance(camera.place, DronePlace)
            else 0.0
            for camera in problem.cameras
        ]
    )
    drones = np.array([isinstance(camera.place, DronePlace) for camera in problem.cameras], dtype=bool)
    both = drones[:, None] & drones[None, :] & ~np.eye(len(drones), dtype=bool)
    return np.where(both, np.maximum(least[:, None], least[None, :]), 0.0)


def permitted(problem: Problem, separation_m: Array, vectors: tuple[Array, ...]) -> bool:
    """Tell whether all drones are outside the keep-out boxes and apart from each other, horizontally."""
    for camera, x in zip(problem.cameras, vectors, strict=True):
        if isinstance(camera.place, DronePlace) and inside_any(x, problem.keep_out_m):
            return False
    pairs = np.argwhere(np.triu(separation_m) > 0.0)
    return all(np.linalg.norm(vectors[i][:2] - vectors[j][:2]) >= separation_m[i, j] - 1e-9 for i, j in pairs)
