"""The smooth problem beside a configuration: what each camera sees now it must go on seeing. Pure."""

from __future__ import annotations

import itertools

import numpy as np

from camrig.optimise.configuration import Configuration, Task
from camrig.optimise.kernels.frozen import Frozen
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import Flags
from camrig.optimise.kernels.sight import cone_cosine, sees
from camrig.optimise.kernels.smooth import active_edges

_EDGE_SHARE = 0.15
"""Edges of view farther away than this share of the view cannot become active within one polish."""


def frozen(task: Task, start: Configuration) -> Frozen:
    """Freeze who sees whom at a configuration, over all free variables together."""
    problem = task.problem
    free = problem.low < problem.high
    column = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1).astype(np.int64)
    seen = start.seen()
    counted = np.where(seen.any(axis=0), problem.weights, 0.0)
    drones = np.flatnonzero(problem.separation_m >= 0.0)
    pairs = np.array(list(itertools.combinations(drones, 2)), dtype=np.int64).reshape(-1, 2)
    apart_m = problem.separation_m[pairs].max(axis=1, initial=0.0)
    return Frozen(
        seen=seen,
        column=column,
        edges=active_edges(problem, start.vectors, seen, _anchors(task, start), _EDGE_SHARE),
        pairs=pairs[apart_m > 0.0],
        apart_m=apart_m[apart_m > 0.0],
        share=counted / max(float(counted.sum()), 1e-300),
        worst=task.worst,
    )


def _anchors(task: Task, start: Configuration) -> Flags:
    """Return the anchors (n, A) that a camera must go on seeing: those in view of who must see one."""
    problem = task.problem
    out = np.zeros((len(start.vectors), len(problem.anchors)), dtype=np.bool_)
    for i in np.flatnonzero(problem.needs_anchor):
        lens = lens_of(problem.cameras[i], problem.lenses, start.vectors[i])
        R, origin = pose_of(problem.cameras[i], start.vectors[i])
        cosine = cone_cosine(problem.settings, lens)
        out[i] = [sees(problem.settings, problem.boxes, lens, cosine, R, origin, anchor) for anchor in problem.anchors]
    return out
