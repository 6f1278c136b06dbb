"""From the best candidates to the optimum beside them: compass search, then SLSQP with the visibility frozen. Pure.

Whatever a step proposes counts only if the true, hard objective is better for it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from camrig.geometry.airspace import inside_any
from camrig.geometry.arrays import Array
from camrig.optimise.configuration import Configuration, configuration, permitted
from camrig.optimise.frozen import FrozenProblem
from camrig.optimise.objective import Score, best_index, better, scores
from camrig.optimise.places import within
from camrig.optimise.scene import DronePlace, SceneCamera
from camrig.optimise.sight import Problem, gains

Expired = Callable[[], bool]

_SCALES = 0.16 * 0.2 ** np.arange(4)
"""Steps in radians or metres; what is finer than the last is left to SLSQP."""
_MOST_SWEEPS = 12
_MOST_ITERATIONS = 60
_WORTHWHILE = 1e-4


def compass(problem: Problem, separation_m: Array, start: Configuration, expired: Expired) -> Configuration:
    """Move one camera at a time to the best point of a star of many scales about it, until none moves."""
    vectors, table, now = list(start.vectors), start.gains.copy(), start.score
    for _ in range(_MOST_SWEEPS):
        before = now
        for i, camera in enumerate(problem.cameras):
            if not vectors[i].size:
                continue
            star = _star(problem, separation_m, vectors, i)
            if not len(star):
                continue
            found = gains(problem, camera, star)
            others = np.delete(table, i, axis=0).sum(axis=0)
            uncovered, mean = scores(others + found, problem.targets.weights)
            best = int(best_index(uncovered, mean))
            proposal = Score(float(uncovered[best]), float(mean[best]))
            if better(proposal, now):
                vectors[i], table[i], now = star[best], found[best], proposal
            if expired():
                return Configuration(tuple(vectors), table, now)
        if not better(now, before, _WORTHWHILE):
            break
    return Configuration(tuple(vectors), table, now)


def slsqp(problem: Problem, separation_m: Array, start: Configuration, expired: Expired) -> Configuration:
    """Move all cameras together, keeping what each sees; the result counts if it is truly better."""
    frozen = FrozenProblem.at(problem, start.vectors, start.gains > 0.0, separation_m)
    if not frozen.size or expired():
        return start
    reached = frozen.solve(_MOST_ITERATIONS)
    for share in (1.0, 0.999, 0.9, 0.5):
        proposal = frozen.vectors(frozen.start + share * (reached - frozen.start))
        if permitted(problem, separation_m, proposal):
            moved = configuration(problem, proposal)
            if better(moved.score, start.score):
                return moved
    return start


def polish(problem: Problem, separation_m: Array, start: Configuration, expired: Expired) -> Configuration:
    """Alternate the two until neither helps."""
    best = start
    for _ in range(3):
        before = best
        best = slsqp(problem, separation_m, compass(problem, separation_m, best, expired), expired)
        if expired() or not better(best.score, before.score, 1e-6):
            break
    # Sums over many poses at once differ from those over one in the last bit: judge all plans alike.
    return configuration(problem, best.vectors)


def _star(problem: Problem, separation_m: Array, vectors: list[Array], i: int) -> Array:
    """Return the permitted points about camera i's vector."""
    camera: SceneCamera = problem.cameras[i]
    steps = np.array([s for s in itertools.product((-1.0, 0.0, 1.0), repeat=vectors[i].size) if any(s)])
    star = within(camera.place, vectors[i] + (_SCALES[:, None, None] * steps).reshape(-1, vectors[i].size))
    if not isinstance(camera.place, DronePlace):
        return star
    free = ~inside_any(star, problem.keep_out_m)
    for j in np.flatnonzero(separation_m[i]):
        free &= np.linalg.norm(star[:, :2] - vectors[j][:2], axis=1) >= separation_m[i, j]
    return np.asarray(star[free])
