"""A swarm of rigs: one round of particle swarm optimisation, and the hard objective of many rigs at once. Compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.compass import Rows, fill, placed_well
from camrig.optimise.kernels.problem import Flags, Ints, Problem
from camrig.optimise.kernels.state import Sums, fused, preferred

INERTIA, PULL = 0.7298, 1.49618
"""Clerc and Kennedy's constriction."""

FASTEST_SHARE = 0.2
"""A round moves a variable by at most this share of its range."""


class Swarm(NamedTuple):
    """P particles over d joint variables, changed in place: where they are, how they move, and each one's best place.

    A score is the uncovered weight and the mean or worst quality, as in ``objective.Score``.
    """

    places: Array
    """(P, d)"""
    velocities: Array
    best: Array
    best_scores: Array
    """(P, 2)"""


class Range(NamedTuple):
    """Of each joint variable: camera and variable of its vector, limits, and whether it goes round and round."""

    camera: Ints
    variable: Ints
    low: Array
    high: Array
    round_and_round: Flags


@compiled
def fly(
    problem: Problem, rows: Rows, sums: Sums, vectors: Array, swarm: Swarm, span: Range, draws: Array, worst: bool
) -> None:
    """Move all particles once, by uniform draws (2, P, d), and remember where each was best.

    Rows, sums and vectors (n, 6) are room to work in; what is not free in the vectors stays.
    """
    leader = swarm.best[leading(swarm)].copy()
    for p in range(len(swarm.places)):
        for k in range(len(leader)):
            x = swarm.places[p, k]
            velocity = INERTIA * swarm.velocities[p, k]
            velocity += PULL * draws[0, p, k] * _way(x, swarm.best[p, k], span.round_and_round[k])
            velocity += PULL * draws[1, p, k] * _way(x, leader[k], span.round_and_round[k])
            fastest = FASTEST_SHARE * (span.high[k] - span.low[k])
            velocity = min(max(velocity, -fastest), fastest)
            x += velocity
            if span.round_and_round[k]:
                x = span.low[k] + (x - span.low[k]) % (2.0 * math.pi)
            if x < span.low[k] or x > span.high[k]:
                x, velocity = min(max(x, span.low[k]), span.high[k]), 0.0
            swarm.places[p, k], swarm.velocities[p, k] = x, velocity
        uncovered, value = score_of(problem, rows, sums, vectors, swarm.places[p], span, worst)
        if preferred(uncovered, value, swarm.best_scores[p, 0], swarm.best_scores[p, 1]):
            swarm.best[p] = swarm.places[p]
            swarm.best_scores[p, 0], swarm.best_scores[p, 1] = uncovered, value


@compiled
def _way(x: float, to: float, round_and_round: bool) -> float:
    way = to - x
    return (way + math.pi) % (2.0 * math.pi) - math.pi if round_and_round else way


@compiled
def leading(swarm: Swarm) -> int:
    """Return the particle that has been at the best place."""
    leader = 0
    scores = swarm.best_scores
    for p in range(1, len(scores)):
        if preferred(scores[p, 0], scores[p, 1], scores[leader, 0], scores[leader, 1]):
            leader = p
    return leader


@compiled
def score_of(
    problem: Problem, rows: Rows, sums: Sums, vectors: Array, place: Array, span: Range, worst: bool
) -> tuple[float, float]:
    """Return the score of a place (d,); the uncovered weight is infinite where drones may not be there."""
    for k in range(len(place)):
        vectors[span.camera[k], span.variable[k]] = place[k]
    sums.total[:, :] = 0.0
    sums.watching[:] = 0
    sums.cost[:] = 0.0
    fill(problem, rows, sums, vectors)
    quality_m = fused(sums)
    uncovered, covered, total, highest = 0.0, 0.0, 0.0, 0.0
    for j in range(len(quality_m)):
        if sums.watching[j] == 0:
            uncovered += sums.weights[j]
        else:
            covered += sums.weights[j]
            total += sums.weights[j] * quality_m[j]
            highest = max(highest, quality_m[j])
    for i in range(len(vectors)):
        if not placed_well(problem, vectors, i, vectors[i]):
            uncovered = np.inf
    if worst or covered == 0.0:
        return uncovered, highest
    return uncovered, total / covered
