"""From candidates to good configurations: tables of what they see, many starts, descent. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.candidates import candidates
from camrig.optimise.configuration import Task, empty_sums, inverted
from camrig.optimise.kernels.descent import Table, begin, descend
from camrig.optimise.kernels.problem import Ints, Problem, Y
from camrig.optimise.kernels.table import anchored, largest_of_each, rows_of
from camrig.optimise.scene import DronePlace, SceneCamera, kind

Expired = Callable[[], bool]
Block = tuple[Array, tuple[Ints, Ints, Array]]
"""Candidates (K, 6) and their sparse rows: ends, targets, worths."""

_EFFORT = (64, 2000)
"""Fewest and most candidates of one camera."""
_LOOKS, _LOOKS_LARGE = 1_500_000, 100_000
"""Sights that all candidates of a scene may cost together, as far as the fewest allow."""
_ALIKE = 4
_TRACE: tuple[list[int], ...] = ([0], [0, 3, 5], [0])
"""The channels whose sum says how much a camera adds, by quality model."""
_MARKS = np.random.default_rng(0).integers(1, 2**63, size=4096, dtype=np.uint64)
"""A view is known by the sum of its targets' marks."""
_BUDGET = 20_000_000
"""Entries of rows that descent may look at before it looks at the clock."""


def table_of(task: Task, cameras: tuple[SceneCamera, ...], present: Array | None = None) -> Table:
    """Return the candidates of all cameras with what they see; a present vector (n, 6) is each camera's first.

    Candidates that see nothing are left out, and those from which a camera that must see an anchor sees none.
    """
    problem = task.problem
    looks = _LOOKS_LARGE if task.large else _LOOKS
    effort = int(np.clip(looks // max(len(task.reachable), 1), *_EFFORT))
    blocks: dict[object, Block] = {}
    placed: list[Block] = []
    shared: dict[object, int] = {}
    index = []
    for i, camera in enumerate(cameras):
        reachable = task.reachable[task.reach_ends[i] : task.reach_ends[i + 1]]
        key = kind(camera), camera.place.yaw_rad if isinstance(camera.place, DronePlace) else 0.0
        if key not in blocks:
            blocks[key] = _useful(task, i, candidates(problem, i, reachable, effort), reachable)
        if present is None:
            if key not in shared:
                shared[key] = len(placed)
                placed.append(blocks[key])
            index.append(shared[key])
        else:
            index.append(len(placed))
            placed.append(_with_present(problem, i, present[i], reachable, blocks[key]))
    return _joined(task, np.array(index), placed)


def _useful(task: Task, i: int, vectors: Array, reachable: Ints) -> Block:
    """Return the vectors worth choosing between: of those that see the same targets, the few that see them best."""
    problem = task.problem
    if problem.needs_anchor[i]:
        safe = vectors[[anchored(problem, i, u) for u in vectors]]
        vectors = safe if len(safe) else vectors
    ends, targets, worths = rows_of(problem, i, vectors, reachable)
    sighted = np.flatnonzero(np.diff(ends) > 0)
    worth = worths[:, _TRACE[problem.quality]].sum(axis=1)
    kept = (
        sighted[_best_of_each_view(ends[sighted], targets, worth, worst=task.worst)]
        if len(sighted)
        else np.zeros(1, dtype=np.int64)
    )
    if problem.separation_m[i] > 0.0:
        added: Array = np.bincount(np.repeat(np.arange(len(vectors)), np.diff(ends)), worth, len(vectors)).astype(float)
        kept = np.union1d(kept, _spread_out(vectors, added, problem.separation_m[i] / 2.0))
    lengths = np.diff(ends)[kept]
    new_ends = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    entries = np.arange(new_ends[-1]) + np.repeat(ends[kept] - new_ends[:-1], lengths)
    return vectors[kept], (new_ends, targets[entries], worths[entries])


def _spread_out(vectors: Array, added: Array, apart_m: float) -> Ints:
    """Return which places to keep for drones that another one may keep away from the best: the best one of every cell
    of the floor, if only to be out of the way there, and the outermost ones.
    """
    cells = np.floor(vectors[:, : Y + 1] / apart_m)
    order = np.lexsort((-added, cells[:, 1], cells[:, 0]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    corners = vectors[:, : Y + 1] @ np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]])
    return np.union1d(order[first], corners.argmax(axis=0))


def _best_of_each_view(starts: Ints, targets: Ints, worths: Array, *, worst: bool) -> Ints:
    """Return which rows to keep: the ``_ALIKE`` best of those that see the very same targets."""
    best = largest_of_each(targets, worths)
    views = np.add.reduceat(_MARKS[targets % len(_MARKS)] * (1 + targets // len(_MARKS)).astype(np.uint64), starts)
    together = np.minimum if worst else np.add
    share = together.reduceat(worths / best[targets], starts)
    order = np.lexsort((-share, views))
    first = np.concatenate([[True], views[order][1:] != views[order][:-1]])
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    return np.sort(order[rank < _ALIKE])


def _with_present(problem: Problem, i: int, u: Array, reachable: Ints, block: Block) -> Block:
    vectors, (ends, targets, worths) = block
    own_ends, own_targets, own_worths = rows_of(problem, i, u[None], reachable)
    joined = np.concatenate([own_ends, own_ends[-1] + ends[1:]])
    rows = joined, np.concatenate([own_targets, targets]), np.concatenate([own_worths, worths])
    return np.vstack([u[None], vectors]), rows


def _joined(task: Task, index: Ints, placed: list[Block]) -> Table:
    sizes = np.array([len(vectors) for vectors, _ in placed])
    firsts = np.concatenate([[0], np.cumsum(sizes)])
    entries = np.concatenate([[0], np.cumsum([rows[0][-1] for _, rows in placed])])
    ends = [np.zeros(1, dtype=np.int64)] + [rows[0][1:] + entries[k] for k, (_, rows) in enumerate(placed)]
    watched = [np.unique(rows[1]) for _, rows in placed]
    watch_ends, watchers = inverted([watched[k] for k in index], len(task.problem.points))
    near_ends, near, apart_m = _neighbours(task.problem)
    return Table(
        block=np.column_stack([firsts[index], firsts[index] + sizes[index]]).astype(np.int64),
        vectors=np.concatenate([vectors for vectors, _ in placed]),
        ends=np.concatenate(ends),
        targets=np.concatenate([rows[1] for _, rows in placed]),
        worths=np.concatenate([rows[2] for _, rows in placed]),
        watch_ends=watch_ends,
        watchers=watchers,
        near_ends=near_ends,
        near=near,
        apart_m=apart_m,
    )


def _neighbours(problem: Problem) -> tuple[Ints, Ints, Array]:
    """Return for each drone those whose boxes come nearer than the two must keep apart, and by how much they must."""
    drones = np.flatnonzero(problem.separation_m >= 0.0)
    near, apart = [np.zeros(0, dtype=np.int64)] * len(problem.low), [np.zeros(0)] * len(problem.low)
    for i in drones:
        least_m = np.maximum(problem.separation_m[i], problem.separation_m[drones])
        gap = np.maximum(problem.low[i] - problem.high[drones], problem.low[drones] - problem.high[i])[:, : Y + 1]
        close = (np.linalg.norm(np.maximum(gap, 0.0), axis=1) < least_m) & (drones != i)
        near[i], apart[i] = drones[close].astype(np.int64), least_m[close]
    ends = np.concatenate([[0], np.cumsum([len(found) for found in near])]).astype(np.int64)
    return ends, np.concatenate([np.zeros(0, dtype=np.int64), *near]), np.concatenate([np.zeros(0), *apart])


class Start(NamedTuple):
    """Where a descent begins: candidates (n,), -1 where ``kernels.descent.begin`` is to choose in this ``order`` by
    ``picks`` (n,), and what covered targets count beside their weights, ``emphasis`` (m,).
    """

    chosen: Ints
    order: Ints
    picks: Array
    emphasis: Array


def search(task: Task, table: Table, start: Start, reference_m: float, expired: Expired) -> Ints:
    """Return the candidates (n,) that descent reaches from a start."""
    sums = empty_sums(task, reference_m, start.emphasis)
    dirty = np.ones(len(start.chosen), dtype=np.bool_)
    chosen = start.chosen.copy()
    begin(table, sums, chosen, start.order, start.picks, dirty)
    at = 0
    while at >= 0 and not expired():
        at = descend(table, sums, chosen, dirty, at, _BUDGET)
    return chosen
