"""Have cameras see a target more, where places from which they do are too narrow to be met by chance. Pure."""

from __future__ import annotations

import numpy as np

from camrig.optimise.configuration import Configuration, Task, configuration, permitted
from camrig.optimise.kernels.problem import Ints
from camrig.optimise.kernels.widen import widest
from camrig.optimise.objective import better
from camrig.optimise.polish import compass
from camrig.optimise.search import Expired

_HOPELESS = 0.02
"""The share that seeing a target more may cost before the others have moved: beyond it, it is not followed up."""
_WIDENED = 2
"""How many of the targets nearest to its view each camera is tried with."""


def widened(task: Task, start: Configuration, expired: Expired) -> Configuration:
    """Let each camera see one of the targets that are nearly in its view as well, where that is better."""
    best = start
    for i in range(len(start.vectors)):
        for j in _nearly_seen(task, best, i):
            if expired():
                return best
            vectors = best.vectors.copy()
            targets = np.append(best.targets[best.ends[i] : best.ends[i + 1]], j).astype(np.int64)
            if widest(task.problem, i, targets, vectors[i]) < 0.0 or not permitted(task.problem, vectors):
                continue
            tried = configuration(task, vectors)
            if better(best.score, tried.score, _HOPELESS):
                continue
            moved = compass(task, tried, expired)
            if better(moved.score, best.score):
                best = moved
    return best


def _nearly_seen(task: Task, start: Configuration, i: int) -> Ints:
    """Return the reachable targets that camera ``i`` does not see, those nearest to the middle of what it sees."""
    seen = start.targets[start.ends[i] : start.ends[i + 1]]
    reachable = task.reachable[task.reach_ends[i] : task.reach_ends[i + 1]]
    unseen = np.setdiff1d(reachable, seen)
    if not len(seen) or not (task.problem.low[i] < task.problem.high[i]).any():
        return unseen[:0]
    points = task.problem.points
    order = np.argsort(np.linalg.norm(points[unseen] - points[seen].mean(axis=0), axis=1))
    return unseen[order[:_WIDENED]]
