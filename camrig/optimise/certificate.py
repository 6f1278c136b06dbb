"""Proof that no configuration covers all targets: a set-cover problem over poses, solved exactly. Pure.

Every pose that a camera can take is near one of a grid, so near that what it sees, that one sees with its view widened
by the angle between them. If no choice of one widened view a camera covers all targets, no configuration does. Where
the widened views do cover them nothing is proven: «not found», never «infeasible».
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import R_MAX
from camrig.optimise.configuration import Task
from camrig.optimise.kernels.problem import (
    ARM_T,
    CAMERA_T,
    LEAST_FACING,
    MARGIN,
    MIN_TAG_PX,
    NEEDS_ANCHOR,
    PAN,
    RANGE,
    VARIABLES,
    ZOOM,
    Flags,
    Problem,
    Z,
)
from camrig.optimise.kernels.table import rows_of
from camrig.optimise.search import Expired

_TURN_STEP_RAD = math.radians(2.0)
_MOST_POSES = 60_000
"""Of one camera: a grid that is wider than this leaves nothing to prove within a second."""
_FIRST_ORDER = 1.25
"""The widening of an image is first order in the angle; this much more makes up for the rest."""
_WIDEST_RAD = math.radians(89.0)
_MOST_LOOKS = 4_000_000
"""Of all cameras' poses at the targets that they can reach: some seconds."""
_MOST_SETS = 1_000
"""More than these are not searched for the largest among them."""
_INFEASIBLE = 2
"""What scipy's milp answers for an infeasible problem."""
_TIME_LIMIT_S = 2.0


def certified_infeasible(task: Task, expired: Expired) -> bool:
    """Tell whether it is proven in time that some target must stay uncovered."""
    problem = task.problem
    grids, looks = [], 0
    for i in range(len(problem.cameras)):
        grid = _grid(problem, i)
        if grid is None:
            return False
        grids.append(grid)
        looks += len(grid[0]) * int(task.reach_ends[i + 1] - task.reach_ends[i])
        if looks > _MOST_LOOKS:
            return False
    views = []
    for i, grid in enumerate(grids):
        if expired():
            return False
        found = _views(task, i, *grid)
        if found is None:
            return False
        views.append(found)
    if not np.concatenate(views).any(axis=0).all():
        return True  # one target is beyond every camera
    return not expired() and not _coverable(views)


def _views(task: Task, i: int, poses: Array, steps: Array) -> Flags | None:
    """Return the distinct largest sets of targets (K, m) that camera ``i`` may see at once; None: not to be told."""
    problem = task.problem
    reachable = task.reachable[task.reach_ends[i] : task.reach_ends[i + 1]]
    widened = _widened(problem, i, poses, steps)
    if widened is None:
        return None
    ends, targets, _ = rows_of(widened, i, poses, reachable)
    sets = np.zeros((len(poses), len(problem.targets)), dtype=np.bool_)
    sets[np.repeat(np.arange(len(sets)), np.diff(ends)), targets] = True
    return _largest(np.unique(sets, axis=0))


def _grid(problem: Problem, i: int) -> tuple[Array, Array] | None:
    """Return poses (K, 6) all over what is free, and the step (6,) between them; None: too many."""
    low, high = problem.low[i], problem.high[i]
    steps, axes = np.zeros(VARIABLES), []
    for variable in range(VARIABLES):
        span = high[variable] - low[variable]
        wanted = _TURN_STEP_RAD if PAN <= variable < ZOOM else 0.1
        count = math.ceil(span / wanted) + 1 if span > 0.0 else 1
        steps[variable] = span / max(count - 1, 1)
        axes.append(np.linspace(low[variable], high[variable], count))
    if math.prod(len(axis) for axis in axes) > _MOST_POSES or high[ZOOM] > 0.0:
        return None
    return np.array(list(itertools.product(*axes))), steps


def _widened(problem: Problem, i: int, poses: Array, steps: Array) -> Problem | None:
    """Return the problem in which a pose of the grid sees all that any pose nearer to it than to others sees."""
    turn_rad = float(np.linalg.norm(steps[PAN:ZOOM])) / 2.0
    lever_m = float(np.abs(problem.cameras[i, [*range(ARM_T, ARM_T + 3), *range(CAMERA_T, CAMERA_T + 3)]]).sum())
    shift_m = float(np.linalg.norm(steps[: Z + 1])) / 2.0 + turn_rad * lever_m
    low, high = poses[:, : Z + 1].min(axis=0), poses[:, : Z + 1].max(axis=0)
    nearest_m = float(np.linalg.norm(problem.points - np.clip(problem.points, low, high), axis=1).min()) - lever_m
    if nearest_m <= 2.0 * shift_m:
        return None
    angle_rad = _FIRST_ORDER * (turn_rad + math.asin(shift_m / nearest_m))
    settings, cameras, lenses = problem.settings.copy(), problem.cameras.copy(), problem.lenses.copy()
    settings[MARGIN] -= angle_rad
    settings[MIN_TAG_PX] *= max(0.0, 1.0 - 4.0 * angle_rad - 2.0 * shift_m / nearest_m)
    settings[LEAST_FACING] = math.cos(min(math.pi, math.acos(settings[LEAST_FACING]) + angle_rad))
    settings[RANGE] += shift_m
    lenses[:, R_MAX] = np.tan(np.minimum(np.arctan(lenses[:, R_MAX]) + angle_rad, _WIDEST_RAD))
    cameras[:, NEEDS_ANCHOR] = 0.0
    # What hides a target from a pose may not hide it from its neighbour.
    return problem._replace(settings=settings, cameras=cameras, lenses=lenses, boxes=problem.boxes[:0])


def _largest(sets: Flags) -> Flags:
    """Return the sets that are part of no other."""
    if len(sets) > _MOST_SETS:
        return sets
    order = np.argsort(-sets.sum(axis=1))
    kept: list[int] = []
    for k in order:
        if not any((sets[k] <= sets[other]).all() for other in kept):
            kept.append(int(k))
    return np.asarray(sets[kept])


def _coverable(views: list[Flags]) -> bool:
    """Tell whether one view a camera can cover all targets; also True where that is not decided in time."""
    owner = np.repeat(np.arange(len(views)), [len(view) for view in views])
    covers = csr_array(np.concatenate(views).T.astype(float))
    one_each = csr_array((np.arange(len(views))[:, None] == owner[None]).astype(float))
    answer = milp(
        np.zeros(len(owner)),
        integrality=np.ones(len(owner), dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        constraints=[LinearConstraint(covers, 1.0, np.inf), LinearConstraint(one_each, 0.0, 1.0)],
        options={"time_limit": _TIME_LIMIT_S},
    )
    return int(answer.status) != _INFEASIBLE
