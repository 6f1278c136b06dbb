"""The aims that put two targets on two sides of the picture: where the optimum of few targets lies. Compiled."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.problem import HIGH, LOW, PAN, TILT, Ints, Problem
from camrig.optimise.kernels.smooth import CENTRE, clearance

SIDES = 4
_INSIDE = 1e-9
"""How far inside the sides the targets come to lie, as a share of the view: on them, rounding decides."""
_STEP = 1e-6
_MOST_STEPS = 12
"""Newton's method doubles its digits; a start that has not arrived by then is on its way to nowhere."""
_LONGEST_RAD = 0.3
"""Of a step: about a third of a view, beyond which a linear picture of the lens is none."""


@compiled
def vertices(problem: Problem, i: int, starts: Array, pairs: Ints) -> Array:
    """Return vectors (K, 6) of camera ``i`` from which both targets of a pair (P, 2) are on a side of the picture each.

    By Newton's method in pan and tilt from starts (P, 6), for any two sides.
    """
    out = np.empty((len(pairs) * SIDES * SIDES, starts.shape[1]))
    count = 0
    first, second = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    for p in range(len(pairs)):
        for side in range(SIDES * SIDES):
            first[0], first[1], first[2], first[3] = i, pairs[p, 0], CENTRE, side // SIDES
            second[0], second[1], second[2], second[3] = i, pairs[p, 1], CENTRE, side % SIDES
            out[count] = starts[p]
            if _solve(problem, first, second, out[count]):
                count += 1
    return out[:count].copy()


@compiled
def _solve(problem: Problem, first: Ints, second: Ints, u: Array) -> bool:
    camera = problem.cameras[first[0]]
    for _ in range(_MOST_STEPS):
        a, b = clearance(problem, first, u) - _INSIDE, clearance(problem, second, u) - _INSIDE
        if not (np.isfinite(a) and np.isfinite(b)):
            return False
        if abs(a) + abs(b) < 0.1 * _INSIDE:
            low, high = camera[LOW + PAN : LOW + TILT + 1], camera[HIGH + PAN : HIGH + TILT + 1]
            return bool((u[PAN : TILT + 1] >= low).all() and (u[PAN : TILT + 1] <= high).all())
        u[PAN] += _STEP
        a_pan, b_pan = (
            (clearance(problem, first, u) - _INSIDE - a) / _STEP,
            (clearance(problem, second, u) - _INSIDE - b) / _STEP,
        )
        u[PAN] -= _STEP
        u[TILT] += _STEP
        a_tilt, b_tilt = (
            (clearance(problem, first, u) - _INSIDE - a) / _STEP,
            (clearance(problem, second, u) - _INSIDE - b) / _STEP,
        )
        u[TILT] -= _STEP
        det = a_pan * b_tilt - a_tilt * b_pan
        if det == 0.0:
            return False
        step_pan, step_tilt = (a * b_tilt - a_tilt * b) / det, (a_pan * b - a * b_pan) / det
        longest = max(abs(step_pan), abs(step_tilt))
        share = min(1.0, _LONGEST_RAD / longest) if longest > 0.0 else 1.0
        u[PAN] -= share * step_pan
        u[TILT] -= share * step_tilt
    return False
