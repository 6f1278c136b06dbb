"""Where every camera looks, what that is worth, and whether the cameras may be there. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import FX, FY
from camrig.optimise.kernels.compass import Rows, fill, placed_well
from camrig.optimise.kernels.problem import (
    ARM_T,
    CAMERA_T,
    CORNERS,
    LENS_FIRST,
    MIN_TAG_PX,
    RANGE,
    TAGGED,
    ZOOM,
    Flags,
    Ints,
    Problem,
    Z,
)
from camrig.optimise.kernels.state import Sums, fused
from camrig.optimise.kernels.table import anchored
from camrig.optimise.objective import Score, score

_MOST_VARIABLES = 50


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A problem, what of it is minimised, and which targets each camera can reach at all.

    Those of camera i are ``reachable`` from ``reach_ends[i]`` to ``reach_ends[i + 1]``.
    """

    problem: Problem
    worst: bool
    reach_ends: Ints
    reachable: Ints
    watch_ends: Ints
    """(m + 1,) where the list of cameras that can reach a target ends in ``watchers``."""
    watchers: Ints
    weights: Array
    """(m,) of the targets, in one piece."""

    @property
    def large(self) -> bool:
        """Whether there are more variables than SQP can take, whose work grows with their cube."""
        return int((self.problem.low < self.problem.high).sum()) > _MOST_VARIABLES


@dataclass(frozen=True, slots=True, eq=False)
class Configuration:
    """Vectors (n, 6), fused qualities (m,) (infinite: nobody sees it), and their score by the hard visibility.

    Camera i sees ``targets`` from ``ends[i]`` to ``ends[i + 1]``.
    """

    vectors: Array
    quality_m: Array
    ends: Ints
    targets: Ints
    score: Score

    def seen(self) -> Flags:
        """Return who sees whom as (n, m): for what is done to small scenes only."""
        out = np.zeros((len(self.vectors), len(self.quality_m)), dtype=np.bool_)
        out[np.repeat(np.arange(len(self.vectors)), np.diff(self.ends)), self.targets] = True
        return out


def task_of(problem: Problem, *, worst: bool) -> Task:
    """Find what each camera can reach: what is near enough to be detected, in whatever direction. Near-linear."""
    near = [_within_reach(problem, i) for i in range(len(problem.low))]
    if all(math.isinf(reach) for _, reach in near):
        lists = [np.arange(len(problem.points))] * len(near)
    else:
        tree = cKDTree(problem.points)
        lists = [np.array(sorted(tree.query_ball_point(at, reach)), dtype=np.int64) for at, reach in near]
    ends = np.concatenate([[0], np.cumsum([len(found) for found in lists])]).astype(np.int64)
    watch_ends, watchers = inverted(lists, len(problem.targets))
    reachable = np.concatenate([np.zeros(0, dtype=np.int64), *lists]).astype(np.int64)
    return Task(problem, worst, ends, reachable, watch_ends, watchers, problem.weights.copy())


def _within_reach(problem: Problem, i: int) -> tuple[Array, float]:
    """Return the middle of where a camera may be, and how far from there it may see anything."""
    low, high = problem.low[i, : Z + 1], problem.high[i, : Z + 1]
    reach_m, min_tag_px = float(problem.settings[RANGE]), float(problem.settings[MIN_TAG_PX])
    if min_tag_px > 0.0 and len(problem.targets) and (problem.targets[:, TAGGED] > 0.0).all():
        sides = problem.targets[:, CORNERS : CORNERS + 3] - problem.targets[:, CORNERS + 3 : CORNERS + 6]
        rows = slice(
            int(problem.cameras[i, LENS_FIRST]), int(problem.cameras[i, LENS_FIRST] + problem.high[i, ZOOM]) + 1
        )
        focal_px = problem.lenses[rows, FX : FY + 1].max()
        reach_m = min(reach_m, _STRETCH * float(focal_px * np.linalg.norm(sides, axis=1).max() / min_tag_px))
    levers = problem.cameras[i, [ARM_T, ARM_T + 1, ARM_T + 2, CAMERA_T, CAMERA_T + 1, CAMERA_T + 2]]
    return (low + high) / 2.0, reach_m + float(np.abs(levers).sum() + np.linalg.norm(high - low) / 2.0)


_STRETCH = 4.0
"""No lens makes a tag off its axis larger in the picture than one on the axis by more than this."""


def configuration(task: Task, vectors: Array) -> Configuration:
    """Evaluate vectors (n, 6) with the hard visibility."""
    rows, sums = empty_rows(task), empty_sums(task, 0.0)
    fill(task.problem, rows, sums, vectors)
    return from_rows(task, vectors, rows, sums)


def from_rows(task: Task, vectors: Array, rows: Rows, sums: Sums) -> Configuration:
    """Return the configuration whose rows and sums are known."""
    quality_m = fused(sums)
    ends = np.concatenate([[0], np.cumsum(rows.sizes)]).astype(np.int64)
    # Camera i's row begins where its reachable targets begin; what is behind its size is left from before.
    owner_start = np.repeat(rows.reach_ends[:-1] - ends[:-1], rows.sizes)
    targets = rows.targets[np.arange(ends[-1]) + owner_start]
    return Configuration(vectors, quality_m, ends, targets, score(quality_m, task.problem.weights, worst=task.worst))


def empty_sums(task: Task, reference_m: float, emphasis: Array | None = None) -> Sums:
    """Return the sums of a rig without cameras; ``reference_m`` scales the worst target's cost.

    ``emphasis`` (m,) multiplies what targets cost once they are covered.
    """
    count = len(task.problem.targets)
    plain = np.ones(count) if task.worst else task.weights
    return Sums(
        total=np.zeros((count, task.problem.channels)),
        watching=np.zeros(count, dtype=np.int64),
        cost=np.zeros(count),
        weights=task.weights,
        emphasis=plain if emphasis is None else plain * emphasis,
        quality=task.problem.quality,
        reference_m=reference_m if task.worst else 0.0,
    )


def empty_rows(task: Task) -> Rows:
    """Return the rows of a rig whose cameras see nothing yet."""
    return Rows(
        reach_ends=task.reach_ends,
        reachable=task.reachable,
        sizes=np.zeros(len(task.problem.cameras), dtype=np.int64),
        targets=np.zeros(len(task.reachable), dtype=np.int64),
        worths=np.zeros((len(task.reachable), task.problem.channels)),
        watch_ends=task.watch_ends,
        watchers=task.watchers,
    )


def inverted(lists: list[Ints], count: int) -> tuple[Ints, Ints]:
    """Return for each of ``count`` things the lists that hold it: ends (count + 1,) and numbers of lists."""
    things = np.concatenate([np.zeros(0, dtype=np.int64), *lists]).astype(np.int64)
    owners = np.repeat(np.arange(len(lists)), [len(found) for found in lists])
    order = np.argsort(things, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(things, minlength=count))]).astype(np.int64)
    return ends, owners[order].astype(np.int64)


def permitted(problem: Problem, vectors: Array) -> bool:
    """Tell whether all drones are outside the keep-out boxes and apart, and whoever must see an anchor sees one."""
    return all(
        placed_well(problem, vectors, i, vectors[i])
        and (not problem.needs_anchor[i] or anchored(problem, i, vectors[i]))
        for i in range(len(vectors))
    )
