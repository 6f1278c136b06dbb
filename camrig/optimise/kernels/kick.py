"""Out of a local optimum: put one camera elsewhere, let the others go first, keep what comes out better. Compiled."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.compass import Rows, compass, placed_well
from camrig.optimise.kernels.descent import Table
from camrig.optimise.kernels.problem import Flags, Ints, Problem
from camrig.optimise.kernels.state import SAME, Sums, apply, preferred

_UNBOUNDED = 1 << 60


@compiled
def kick(
    problem: Problem,
    table: Table,
    nobody: Table,
    rows: Rows,
    sums: Sums,
    vectors: Array,
    movable: Flags,
    scales: Array,
    least_gain: float,
    candidates: Ints,
    cameras: Ints,
) -> None:
    """Put cameras (N,), one after the other, at candidates (N,) of the table, and descend from there.

    ``nobody`` is a table in which no camera has a candidate.
    What is not better than before is taken back. Changes vectors, rows and sums in place, never for the worse.
    """
    for at in range(len(cameras)):
        i, k = cameras[at], candidates[at]
        if not placed_well(problem, vectors, i, table.vectors[k]):
            continue
        kept = vectors.copy(), rows.sizes.copy(), rows.targets.copy(), rows.worths.copy()
        kept_sums = sums.total.copy(), sums.watching.copy(), sums.cost.copy()
        uncovered, cost = _score(sums)
        start, first, end = rows.reach_ends[i], table.ends[k], table.ends[k + 1]
        apply(sums, rows.targets, rows.worths, start, start + rows.sizes[i], -1)
        vectors[i] = table.vectors[k]
        rows.sizes[i] = end - first
        rows.targets[start : start + end - first] = table.targets[first:end]
        rows.worths[start : start + end - first] = table.worths[first:end]
        apply(sums, rows.targets, rows.worths, start, start + rows.sizes[i], 1)
        dirty = movable.copy()
        dirty[i] = False
        compass(problem, table, rows, sums, vectors, dirty, scales, least_gain, 0, _UNBOUNDED)
        # Now the one that was kicked: about where it is, or it would only go back.
        dirty[:] = False
        dirty[i] = movable[i]
        compass(problem, nobody, rows, sums, vectors, dirty, scales, least_gain, i, _UNBOUNDED)
        new_uncovered, new_cost = _score(sums)
        if not preferred(new_uncovered, new_cost + SAME * abs(new_cost), uncovered, cost):
            vectors[:], rows.sizes[:], rows.targets[:], rows.worths[:] = kept
            sums.total[:], sums.watching[:], sums.cost[:] = kept_sums


@compiled
def _score(sums: Sums) -> tuple[float, float]:
    uncovered = 0.0
    for j in range(len(sums.weights)):
        if sums.watching[j] == 0:
            uncovered += sums.weights[j]
    return uncovered, float(np.sum(sums.cost))
