"""The running sums of a search: who sees each target, what cameras add up to there, what that is worth. Compiled.

The uncovered weight comes first, then the *cost* over the covered targets: the weighted sum of their qualities, or for
the worst target a sum of high powers, in which every target near the worst has a say (the plain maximum gives a
direction to one camera alone and stalls).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.problem import FISHER, Ints
from camrig.optimise.kernels.worth import quality_of

POWER = 8
SAME = 1e-9
"""Uncovered weights and shares of the cost that differ by less are the same."""


class Sums(NamedTuple):
    """The state of a search; its arrays are changed in place."""

    total: Array
    """(m, C) sums of the channels over the cameras that see a target."""
    watching: Ints
    """(m,) how many those are."""
    cost: Array
    """(m,) what each covered target adds to the cost; 0 for the others."""
    weights: Array
    """(m,) what counts while a target is uncovered."""
    emphasis: Array
    """(m,) what counts once it is covered: the weights again, unless a search is to be led somewhere else."""
    quality: int
    reference_m: float
    """0: the cost is the weighted mean's. Above: the worst target's, qualities in shares of it."""


@compiled
def cost_of(sums: Sums, j: int, total: Array) -> float:
    """Return the cost of target ``j``, covered, at given channels (C,)."""
    value = quality_of(total, sums.quality)
    if sums.reference_m > 0.0:
        return float(sums.emphasis[j] * (value / sums.reference_m) ** POWER)
    return float(sums.emphasis[j] * value)


@compiled
def change(sums: Sums, targets: Ints, worths: Array, first: int, end: int) -> tuple[float, float]:
    """Return by how much the uncovered weight and the cost change if a camera came with the row from first to end."""
    uncovered, cost = 0.0, 0.0
    if sums.quality != FISHER:
        for t in range(first, end):
            j = targets[t]
            after = sums.total[j, 0] + worths[t, 0]
            if sums.watching[j] > 0:
                cost -= sums.cost[j]
            else:
                uncovered -= sums.weights[j]
            if sums.reference_m > 0.0:
                cost += sums.emphasis[j] * (1.0 / (after * sums.reference_m)) ** POWER
            else:
                cost += sums.emphasis[j] / after
        return uncovered, cost
    channels = sums.total.shape[1]
    after_all = np.empty(channels)
    for t in range(first, end):
        j = targets[t]
        for c in range(channels):
            after_all[c] = sums.total[j, c] + worths[t, c]
        if sums.watching[j] > 0:
            cost -= sums.cost[j]
        else:
            uncovered -= sums.weights[j]
        cost += cost_of(sums, j, after_all)
    return uncovered, cost


@compiled
def apply(sums: Sums, targets: Ints, worths: Array, first: int, end: int, sign: int) -> None:
    """Let a camera come (1) or go (-1) with the row from first to end."""
    for t in range(first, end):
        j = targets[t]
        sums.watching[j] += sign
        for c in range(sums.total.shape[1]):
            sums.total[j, c] = sums.total[j, c] + sign * worths[t, c] if sums.watching[j] > 0 else 0.0
        sums.cost[j] = cost_of(sums, j, sums.total[j]) if sums.watching[j] > 0 else 0.0


@compiled
def preferred(uncovered: float, cost: float, best_uncovered: float, best_cost: float) -> bool:
    """Tell whether a change is better than the best so far: more weight covered, or as much at less cost."""
    if abs(uncovered - best_uncovered) > SAME:
        return uncovered < best_uncovered
    return cost < best_cost


@compiled
def fused(sums: Sums) -> Array:
    """Return the fused quality (m,) in metres; infinite where nobody sees."""
    out = np.full(len(sums.watching), np.inf)
    for j in range(len(out)):
        if sums.watching[j] > 0:
            out[j] = quality_of(sums.total[j], sums.quality)
    return out
