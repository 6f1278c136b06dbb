"""What a comparator is asked and what it gives back; the random rig that several of them start from. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.configuration import Task
from camrig.optimise.kernels.aims import head_vectors
from camrig.optimise.kernels.pose import pose_of
from camrig.optimise.kernels.problem import TILT, ZOOM, Flags, Problem, Z
from camrig.optimise.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A scene, what of it is minimised, the random numbers to use, and when on the clock ``now`` to be done."""

    scene: Scene
    task: Task
    rng: np.random.Generator
    now: Callable[[], float]
    until_s: float

    def expired(self) -> bool:
        """Tell whether the time is up."""
        return self.now() >= self.until_s


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Vectors (n, 6), and the seconds of preparation that are no part of solving."""

    vectors: Array
    build_s: float = 0.0


def free_variables(problem: Problem) -> Flags:
    """Return which variables (n, 6) the limits leave free: a solver's unknowns, in this order."""
    return np.asarray(problem.low < problem.high)


def middle(problem: Problem) -> Array:
    """Return the vectors (n, 6) in the middle of all limits, with every zoom at the first row of its table."""
    vectors = (problem.low + problem.high) / 2.0
    vectors[:, ZOOM] = 0.0
    return np.asarray(vectors)


def looking_at(problem: Problem, i: int, vector: Array, point: Array) -> Array:
    """Return the vector (6,) with which head ``i``, standing where it stands, looks as nearly as it can at a point."""
    direction = point - pose_of(problem.cameras[i], vector)[1]
    return np.asarray(head_vectors(problem, i, vector[: Z + 1], direction[None], vector[ZOOM])[0])


def random_rig(problem: Problem, rng: np.random.Generator) -> Array:
    """Draw vectors (n, 6): uniform within the limits, but heads look at a place drawn from the targets' extent.

    Uniform angles would leave most heads looking at a wall, from where the solvers that follow slopes see no target.
    """
    vectors = rng.uniform(problem.low, problem.high)
    places = rng.uniform(problem.points.min(axis=0), problem.points.max(axis=0), size=(len(vectors), 3))
    for i in np.flatnonzero(problem.low[:, TILT] < problem.high[:, TILT]):
        vectors[i] = looking_at(problem, int(i), vectors[i], places[i])
    return np.asarray(vectors)
