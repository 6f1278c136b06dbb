"""How the paper's problem is made smooth for the solvers that follow slopes; what it is the paper does not say. Pure.

Zhang et al. minimise the mean (or the worst) fused quality such that every target is seen, by SQP and by IPOPT; neither
the start nor the smooth form of V is published in what we could read. Assumed: V as in ``kernels.smoothed``, sharpened
in stages, each from where the one before ended; one random start; sum_i V_ij >= 1/2 for every target j, written as
log(2 sum V) >= 0, the same set, which unlike the plain form has a slope far from any view. A target that nobody sees
has a finite quality, lest it outweigh everything before the constraint brings it into view. The worst target's problem
is in epigraph form: one more variable, which no quality may exceed. Separation and keep-out boxes have no part in the
paper's problem and none here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.lens_row import FX, FY
from camrig.optimise.kernels.problem import FISHER, Problem, Z

MM = 1e3
"""Solvers work in millimetres: values about 1."""

MOST_ITERATIONS = 200
"""Of one stage."""

TOLERANCE = 1e-6

INSIDE = 1e-5
"""By how much log(2 sum V) must exceed 0, so that what a solver's tolerance lets slip is still in view."""

_FISHER_M = 0.01
"""About what one camera makes of a tag."""


class Stage(NamedTuple):
    """Sharpness of V, and the quality of an unseen target in multiples of what one camera makes of a target."""

    sharpness: float
    unseen: float


STAGES = (Stage(20.0, 10.0), Stage(50.0, 30.0), Stage(200.0, 1000.0))
"""Begun soft, both solvers end nearer the best known than from 50 at once: over drones by a factor of 2 to 3."""


def typical_m(problem: Problem) -> float:
    """Return about the quality in metres that the farthest camera makes of a target in the middle of its picture."""
    if problem.quality == FISHER:
        return _FISHER_M
    ends = np.array([problem.low[:, : Z + 1], problem.high[:, : Z + 1]])
    ways = np.abs(problem.points[:, None, None] - ends).max(axis=1)
    focal_px = np.sqrt(problem.lenses[:, FX] * problem.lenses[:, FY]).min()
    return float(np.linalg.norm(ways, axis=2).max() / focal_px)
