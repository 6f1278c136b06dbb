"""The smooth problem beside a configuration: what each camera sees now it must go on seeing. Pure."""

from __future__ import annotations

import itertools

import numpy as np

from camrig.optimise.configuration import Configuration, Task
from camrig.optimise.kernels.frozen import Frozen
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import Flags
from camrig.optimise.kernels.smooth import active_edges
from camrig.optimise.kernels.worth import anchors_in_view

_EDGE_SHARE = 0.15
"""Edges of view farther away than this share of the view cannot become active within one polish."""


def frozen(task: Task, start: Configuration) -> Frozen:
    """Freeze who sees whom at a configuration, over all free variables together."""
    problem = task.problem
    free = problem.low < problem.high
    column = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1).astype(np.int64)
    seen, anchors = start.seen(), _anchors(task, start)
    counted = np.where(seen.any(axis=0), problem.weights, 0.0)
    drones = np.flatnonzero(problem.separation_m >= 0.0)
    pairs = np.array(list(itertools.combinations(drones, 2)), dtype=np.int64).reshape(-1, 2)
    apart_m = problem.separation_m[pairs].max(axis=1, initial=0.0)
    return Frozen(
        seen=seen,
        anchors=anchors,
        column=column,
        edges=active_edges(problem, start.vectors, seen, anchors & problem.needs_anchor[:, None], _EDGE_SHARE),
        pairs=pairs[apart_m > 0.0],
        apart_m=apart_m[apart_m > 0.0],
        share=counted / max(float(counted.sum()), 1e-300),
        worst=task.worst,
    )


def _anchors(task: Task, start: Configuration) -> Flags:
    """Return the anchors (n, A) in view of each camera."""
    problem = task.problem
    out = np.zeros((len(start.vectors), len(problem.anchors)), dtype=np.bool_)
    for i, vector in enumerate(start.vectors) if len(problem.anchors) else ():
        lens = lens_of(problem.cameras[i], problem.lenses, vector)
        out[i] = anchors_in_view(problem, lens, *pose_of(problem.cameras[i], vector))
    return out
