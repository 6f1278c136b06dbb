"""Particle swarm, after Konda and Conci (2013). Pure.

Our reimplementation. Assumed: global best with Clerc and Kennedy's constriction, 40 particles, 250 rounds, a uniform
start at rest, velocities up to a fifth of a variable's range. A pan that may turn fully round goes round, and is pulled
the short way; any other variable stops at its limit. The fitness is the hard objective, as a tuple; a particle whose
drones are in a keep-out box or too near each other is worse than any that is permitted.
"""

from __future__ import annotations

import math

import numpy as np

from camrig.optimise.comparators.common import Asked, Found, free_variables, middle
from camrig.optimise.configuration import empty_rows, empty_sums
from camrig.optimise.kernels.problem import PAN
from camrig.optimise.kernels.swarm import Range, Swarm, fly, leading

_PARTICLES, _ROUNDS = 40, 250


def find(asked: Asked) -> Found:
    """Return the best place that any particle has been at."""
    problem, rng = asked.task.problem, asked.rng
    free = free_variables(problem)
    camera, variable = (part.astype(np.int64) for part in np.nonzero(free))
    low, high = problem.low[free], problem.high[free]
    span = Range(camera, variable, low, high, (variable == PAN) & (high - low >= 2.0 * math.pi - 1e-9))
    places = rng.uniform(low, high, size=(_PARTICLES, len(low)))
    nowhere = np.full((_PARTICLES, 2), np.inf)
    swarm = Swarm(places, np.zeros_like(places), places.copy(), nowhere)
    rows, sums, vectors = empty_rows(asked.task), empty_sums(asked.task, 0.0), middle(problem)
    # A swarm at rest, all of whose best places are where it is, is not moved by its first round: that one judges it.
    for k in range(1 + _ROUNDS):
        if k > 0 and asked.expired():
            break
        draws = rng.uniform(size=(2, *places.shape)) if k > 0 else np.zeros((2, *places.shape))
        fly(problem, rows, sums, vectors, swarm, span, draws, asked.task.worst)
    vectors[free] = swarm.best[leading(swarm)]
    return Found(vectors)
