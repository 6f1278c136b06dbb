"""Whether moving is worth it: running aims stay unless a plan is clearly better; no camera moves for nothing. Pure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.configuration import Configuration, Task, configuration, permitted
from camrig.optimise.objective import better

_REVERTED_SHARE = 0.5
"""The share of ``gain`` that may be given back to let cameras stay where they are."""


def settle(
    task: Task, running: Configuration, found: Configuration, gain: float, motion_cost: Callable[[int, Array], float]
) -> Configuration:
    """Return the running configuration, or the found one with every camera put back whose move hardly matters.

    A found configuration is taken when it covers more weight, or is better by more than ``gain`` and what its motion
    costs: ``motion_cost(i, vector)`` is the share of the objective that camera i's way there must bring. Putting
    cameras back never uncovers a target, gives back at most half of ``gain`` and what the spared motion costs, and
    leaves a gain of more than ``gain``.
    """
    moved = [i for i in range(len(found.vectors)) if not np.array_equal(found.vectors[i], running.vectors[i])]
    costs = {i: motion_cost(i, found.vectors[i]) for i in moved}
    if not better(found.score, running.score, gain + sum(costs.values())):
        return running
    kept, spared = found, 0.0
    while moved:
        possible = []
        for i in moved:
            option = _put_back(task, running, kept, i)
            worst = found.score._replace(
                quality_m=found.score.quality_m * (1.0 + _REVERTED_SHARE * gain + spared + costs[i])
            )
            if (
                not better(worst, option.score)
                and better(option.score, running.score, gain)
                and permitted(task.problem, option.vectors)
            ):
                possible.append((option.score.uncovered, option.score.quality_m, i))
        if not possible:
            return kept
        *_, i = min(possible)
        kept, spared = _put_back(task, running, kept, i), spared + costs[i]
        moved.remove(i)
    return kept


def _put_back(task: Task, running: Configuration, kept: Configuration, i: int) -> Configuration:
    vectors = kept.vectors.copy()
    vectors[i] = running.vectors[i]
    return configuration(task, vectors)
