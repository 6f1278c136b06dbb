"""Whether moving is worth it: running aims stay unless a plan is clearly better; no camera moves for nothing. Pure."""

from __future__ import annotations

import numpy as np

from camrig.optimise.configuration import Configuration, from_gains, permitted, separations
from camrig.optimise.objective import better
from camrig.optimise.sight import Problem

_REVERTED_SHARE = 0.5
"""The share of ``gain`` that may be given back to let cameras stay where they are."""


def settle(problem: Problem, running: Configuration, found: Configuration, gain: float) -> Configuration:
    """Return the running configuration, or the found one with every camera put back whose move hardly matters.

    A found configuration is taken when it covers more weight, or is better by more than ``gain``. Putting cameras
    back never uncovers a target and in all costs at most half of ``gain``.
    """
    if not better(found.score, running.score, gain):
        return running
    worst = found.score._replace(mean_m=found.score.mean_m * (1.0 + _REVERTED_SHARE * gain))
    separation_m = separations(problem)
    kept = found
    moved = [i for i in range(len(found.vectors)) if not np.array_equal(found.vectors[i], running.vectors[i])]
    while moved:
        reverted = [_put_back(problem, running, kept, i) for i in moved]
        possible = [
            (option.score, i)
            for option, i in zip(reverted, moved, strict=True)
            if not better(worst, option.score)
            and better(option.score, running.score)
            and permitted(problem, separation_m, option.vectors)
        ]
        if not possible:
            return kept
        _, i = min(possible)
        kept = _put_back(problem, running, kept, i)
        moved.remove(i)
    return kept


def _put_back(problem: Problem, running: Configuration, kept: Configuration, i: int) -> Configuration:
    vectors = list(kept.vectors)
    vectors[i] = running.vectors[i]
    table = kept.gains.copy()
    table[i] = running.gains[i]
    return from_gains(problem, tuple(vectors), table)
