"""From the best candidates to the optimum beside them: compass search, then SQP with the visibility frozen. Pure.

Whatever a step proposes counts only if the true, hard objective is better for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.configuration import (
    Configuration,
    Task,
    configuration,
    empty_rows,
    empty_sums,
    permitted,
)
from camrig.optimise.frozen import frozen
from camrig.optimise.kernels.compass import Rows, fill
from camrig.optimise.kernels.compass import compass as compass_kernel
from camrig.optimise.kernels.descent import Table
from camrig.optimise.kernels.kick import kick
from camrig.optimise.kernels.newton import newton
from camrig.optimise.kernels.problem import VARIABLES, Flags, Ints
from camrig.optimise.kernels.state import Sums
from camrig.optimise.objective import better
from camrig.optimise.search import Expired


class Steps(NamedTuple):
    """How far a compass looks, in radians or metres; and the share of the cost for which others look again."""

    scales: Array
    worthwhile: float


COARSE = Steps(np.array([0.16, 0.04]), 1e-3)
"""Between many starts: what is finer is left to SQP."""
_QUICK_HEADS = Steps(np.array([0.25, 0.12, 0.06, 0.015]), 5e-4)
_QUICK_DRONES = Steps(np.array([0.3, 0.1]), 3e-3)
"""From the running configuration, under which the targets have moved, and which is the only start. What drones gain by
finer steps SQP gives them for less; heads lose and win targets by a step, which SQP does not see.
"""
FINE = Steps(np.array([0.16, 0.064, 0.0256, 0.01, 0.004, 0.0016]), 2e-5)
_EXACT, _ROUGH = (60, 1e-9), (10, 1e-5)
"""SQP's most iterations, and the accuracy of the objective in mm."""
_AT_ONCE = 10
"""Iterations of SQP between two looks at the clock."""
_MOST_ROUNDS = 4
"""Of the last polish; of 72 random scenes all but one took one."""
_KICKS_AT_ONCE = 8
"""Kicks between two looks at the clock."""
_BUDGET = 400_000
"""Sights that the compass may look at before it looks at the clock."""


@dataclass(slots=True)
class _Search:
    """The state of a compass search: a problem, who may move, and everything that moving changes."""

    task: Task
    table: Table
    vectors: Array
    rows: Rows
    sums: Sums
    movable: Flags

    @classmethod
    def at(cls, task: Task, start: Configuration, table: Table | None) -> _Search:
        """Begin at a configuration."""
        rows, sums = empty_rows(task), empty_sums(task, max(start.score.quality_m, 1e-12))
        vectors = start.vectors.copy()
        fill(task.problem, rows, sums, vectors)
        movable: Flags = np.asarray((task.problem.low < task.problem.high).any(axis=1))
        return cls(task, table or _no_table(task), vectors, rows, sums, movable)

    def run(self, expired: Expired, dirty: Flags, steps: Steps) -> None:
        """Move until nobody can do better."""
        least_gain, at = steps.worthwhile * float(self.sums.cost.sum()), 0
        while at >= 0 and not expired():
            at = compass_kernel(
                self.task.problem,
                self.table,
                self.rows,
                self.sums,
                self.vectors,
                dirty,
                steps.scales,
                least_gain,
                at,
                _BUDGET,
            )

    def kick(self, cameras: Ints, candidates: Ints) -> None:
        """Put cameras (N,), one after the other, at candidates (N,) of the table; keep what is better."""
        least_gain = COARSE.worthwhile * float(self.sums.cost.sum())
        kick(
            self.task.problem,
            self.table,
            _no_table(self.task),
            self.rows,
            self.sums,
            self.vectors,
            self.movable,
            COARSE.scales,
            least_gain,
            candidates,
            cameras,
        )


def compass(
    task: Task, start: Configuration, expired: Expired, table: Table | None = None, steps: Steps = COARSE
) -> Configuration:
    """Move one camera at a time to the best point of a star of many scales about it, or to the best of its candidates
    in ``table``, until none moves.
    """
    search = _Search.at(task, start, table)
    search.run(expired, search.movable.copy(), steps)
    # Running sums differ from fresh ones in the last bit: judge all plans alike.
    moved = configuration(task, search.vectors)
    return moved if task.worst or better(moved.score, start.score) else start


def quick_steps(task: Task) -> Steps:
    """Return how far to look from a running configuration: drones alone, or a rig with heads."""
    movable, drones = (task.problem.low < task.problem.high).any(axis=1), task.problem.separation_m >= 0.0
    return _QUICK_DRONES if drones[movable].all() else _QUICK_HEADS


def kicked(
    task: Task, table: Table, start: Configuration, rounds: int, rng: np.random.Generator, expired: Expired
) -> Configuration:
    """Put cameras, one a round, at random candidates of theirs, let the others go first, and keep what is better."""
    choices = np.flatnonzero(table.block[:, 1] - table.block[:, 0] > 1)
    if not rounds or not len(choices):
        return start
    search = _Search.at(task, start, table)
    for first in range(0, rounds, _KICKS_AT_ONCE):
        if expired():
            break
        cameras = rng.choice(choices, min(_KICKS_AT_ONCE, rounds - first))
        search.kick(cameras, rng.integers(table.block[cameras, 0], table.block[cameras, 1]))
    moved = configuration(task, search.vectors)
    return moved if task.worst or better(moved.score, start.score) else start


def sqp(task: Task, start: Configuration, expired: Expired, *, rough: bool = False) -> Configuration:
    """Move all cameras together, keeping what each sees; the result counts if it is truly better.

    A rig with too many variables for it is left as it is. ``rough``: only as far as tells which start is best.
    """
    if task.large or not len(start.targets) or not (task.problem.low < task.problem.high).any():
        return start
    smooth = frozen(task, start)
    vectors = start.vectors.copy()
    iterations, accuracy_mm = _ROUGH if rough else _EXACT
    while iterations > 0 and not expired():
        taken = newton(task.problem, smooth, vectors, min(iterations, _AT_ONCE), accuracy_mm)
        iterations = iterations - taken if taken == _AT_ONCE else 0
    for share in (1.0, 0.999, 0.9, 0.5):
        between = start.vectors + share * (vectors - start.vectors)
        if permitted(task.problem, between):
            moved = configuration(task, between)
            if better(moved.score, start.score):
                return moved
    return start


def finish(task: Task, start: Configuration, table: Table, expired: Expired) -> Configuration:
    """Alternate the two, with finer steps, until the compass finds nothing more."""
    best = start
    for _ in range(_MOST_ROUNDS):
        best = sqp(task, best, expired)
        moved = compass(task, best, expired, table, FINE)
        gained = better(moved.score, best.score, 1e-6)
        if better(moved.score, best.score):
            best = moved
        if expired() or not gained:
            break
    return best


def _no_table(task: Task) -> Table:
    """Return a table in which nobody has a candidate."""
    none, count = np.zeros(0, dtype=np.int64), len(task.problem.cameras)
    return Table(
        block=np.zeros((count, 2), dtype=np.int64),
        vectors=np.zeros((0, VARIABLES)),
        ends=np.zeros(1, dtype=np.int64),
        targets=none,
        worths=np.zeros((0, task.problem.channels)),
        watch_ends=np.zeros(len(task.problem.targets) + 1, dtype=np.int64),
        watchers=none,
        near_ends=np.zeros(count + 1, dtype=np.int64),
        near=none,
        apart_m=np.zeros(0),
    )
