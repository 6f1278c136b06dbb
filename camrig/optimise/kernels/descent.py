"""Block-coordinate descent over candidates: one camera at a time moves to its best one. Compiled.

A camera is looked at again only after something it can see has changed (dirty flags), so the cost is that of the rows
that are looked at, however large the rig.
"""

from __future__ import annotations

from typing import NamedTuple

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.problem import Flags, Ints
from camrig.optimise.kernels.state import SAME, Sums, apply, change, preferred


class Table(NamedTuple):
    """The candidates of all cameras as sparse rows; identical drones share theirs."""

    block: Ints
    """(n, 2) a camera's first candidate and the one after its last."""
    vectors: Array
    """(K, 6)"""
    ends: Ints
    """(K + 1,) where rows end in ``targets`` (N,) and ``worths`` (N, C)."""
    targets: Ints
    worths: Array
    watch_ends: Ints
    """(m + 1,) where the list of cameras that can see a target ends in ``watchers``."""
    watchers: Ints
    near_ends: Ints
    """(n + 1,) where the list of drones from which a drone must keep apart ends in ``near``."""
    near: Ints
    apart_m: Array
    """(len(near),) by how much, horizontally."""


@compiled
def best_candidate(table: Table, sums: Sums, chosen: Ints, i: int) -> int:
    """Return the best candidate of camera ``i``, whose own row is not in the sums; the present one at a tie.

    -1 where no candidate is permitted and there is no present one.
    """
    best, best_uncovered, best_cost = -1, 0.0, 0.0
    present = chosen[i]
    # A gain below rounding is no gain: the cost of what one camera sees sets the scale.
    if present >= 0 and permitted(table, chosen, i, present):
        best = present
        best_uncovered, best_cost = _row_change(table, sums, present)
    for k in range(table.block[i, 0], table.block[i, 1]):
        if k == best or not permitted(table, chosen, i, k):
            continue
        uncovered, cost = _row_change(table, sums, k)
        if best < 0 or preferred(uncovered, cost + SAME * abs(cost), best_uncovered, best_cost):
            best, best_uncovered, best_cost = k, uncovered, cost
    return best if best >= 0 else present


@compiled
def _row_change(table: Table, sums: Sums, k: int) -> tuple[float, float]:
    return change(sums, table.targets, table.worths, table.ends[k], table.ends[k + 1])


@compiled
def permitted(table: Table, chosen: Ints, i: int, k: int) -> bool:
    """Tell whether candidate ``k`` keeps drone ``i`` apart from the chosen places of the others."""
    for at in range(table.near_ends[i], table.near_ends[i + 1]):
        other = chosen[table.near[at]]
        if other < 0:
            continue
        dx = table.vectors[k, 0] - table.vectors[other, 0]
        dy = table.vectors[k, 1] - table.vectors[other, 1]
        if dx * dx + dy * dy < table.apart_m[at] ** 2:
            return False
    return True


@compiled
def put(table: Table, sums: Sums, chosen: Ints, i: int, k: int, dirty: Flags) -> None:
    """Put camera ``i`` at candidate ``k`` and mark who may now do better."""
    chosen[i] = k
    apply(sums, table.targets, table.worths, table.ends[k], table.ends[k + 1], 1)
    _mark(table, k, i, dirty)


@compiled
def take(table: Table, sums: Sums, chosen: Ints, i: int) -> None:
    """Take camera ``i`` out of the sums; ``chosen`` still says where it was."""
    k = chosen[i]
    apply(sums, table.targets, table.worths, table.ends[k], table.ends[k + 1], -1)


@compiled
def _mark(table: Table, k: int, i: int, dirty: Flags) -> None:
    for row in range(table.ends[k], table.ends[k + 1]):
        j = table.targets[row]
        for at in range(table.watch_ends[j], table.watch_ends[j + 1]):
            dirty[table.watchers[at]] = True
    for at in range(table.near_ends[i], table.near_ends[i + 1]):
        dirty[table.near[at]] = True


@compiled
def begin(table: Table, sums: Sums, chosen: Ints, order: Ints, picks: Array, dirty: Flags) -> None:
    """Fill empty sums with the chosen candidates, and place the cameras that have none yet, in this order: at the best
    one where their pick (n,) is negative, else at the permitted one next to that share of the list.
    """
    for i in order:
        if chosen[i] >= 0:
            put(table, sums, chosen, i, chosen[i], dirty)
    for i in order:
        if chosen[i] >= 0:
            continue
        first, count = table.block[i, 0], table.block[i, 1] - table.block[i, 0]
        k = -1
        if picks[i] < 0.0:
            k = best_candidate(table, sums, chosen, i)
        else:
            for step in range(count):
                candidate = first + (int(picks[i] * count) + step) % count
                if permitted(table, chosen, i, candidate):
                    k = candidate
                    break
        put(table, sums, chosen, i, k if k >= 0 else first, dirty)
        dirty[i] = True


@compiled
def descend(table: Table, sums: Sums, chosen: Ints, dirty: Flags, at: int, budget: int) -> int:
    """Move dirty cameras, beginning with ``at``, until none is left or ``budget`` entries of rows were looked at.

    Returns the camera to go on with, or -1 when no camera can do better. Never makes the state worse.
    """
    count = len(chosen)
    clean = 0
    while clean < count:
        if budget <= 0:
            return at
        if dirty[at]:
            dirty[at] = False
            clean = 0
            before = chosen[at]
            take(table, sums, chosen, at)
            best = best_candidate(table, sums, chosen, at)
            if best != before:
                _mark(table, before, at, dirty)
                put(table, sums, chosen, at, best, dirty)
                dirty[at] = False
            else:
                apply(sums, table.targets, table.worths, table.ends[before], table.ends[before + 1], 1)
            budget -= table.ends[table.block[at, 1]] - table.ends[table.block[at, 0]]
        else:
            clean += 1
        at = (at + 1) % count
    return -1
