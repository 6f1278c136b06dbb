"""Block-coordinate descent: one camera at a time moves to its best candidate, many starts side by side. Pure.

The table of gains W[camera][candidate][target] is computed once. A start is one candidate index per camera; all
starts are moved together, so that numpy sees large arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.objective import best_index, scores
from camrig.optimise.sight import Indices
from camrig.sensing.visibility import Flags

_MOST_SWEEPS = 40
_IMPROVEMENT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The candidates of every camera: vectors (K_i, d_i), gains (K_i, m), and for drones positions (K_i, 3).

    ``separation_m`` (n, n) is 0 where a pair of cameras may be as near as it likes. It is kept horizontally: a drone
    under another would stand in its view and its downwash.
    """

    vectors: tuple[Array, ...]
    gains: tuple[Array, ...]
    weights: Array
    separation_m: Array


def greedy_start(table: Table, order: Indices) -> Indices:
    """Give the cameras, in this order, the candidate that helps most beside those before them."""
    chosen = np.full((1, len(table.gains)), -1, dtype=np.intp)
    for camera in order:
        chosen[0, camera] = _best_for(table, chosen, int(camera))[0]
    return np.asarray(chosen[0])


def random_start(table: Table, rng: np.random.Generator) -> Indices:
    """Draw the cameras' candidates in random order, each kept apart from those before it."""
    chosen = np.full((1, len(table.gains)), -1, dtype=np.intp)
    for camera in rng.permutation(len(table.gains)):
        allowed = np.flatnonzero(_apart(table, chosen, int(camera))[0])
        choices = allowed if allowed.size else np.arange(len(table.gains[camera]))
        chosen[0, camera] = rng.choice(choices)
    return np.asarray(chosen[0])


def descend(table: Table, starts: Indices, expired: Callable[[], bool]) -> Indices:
    """Improve (B, n) starts camera by camera until none moves; returns (B, n). Never worsens a start."""
    chosen = starts.copy()
    moving = np.arange(len(chosen))
    for _ in range(_MOST_SWEEPS):
        before = chosen[moving].copy()
        for camera in range(len(table.gains)):
            if len(table.gains[camera]) > 1:
                chosen[moving, camera] = _best_for(table, chosen[moving], camera)
            if expired():
                return chosen
        moving = moving[(chosen[moving] != before).any(axis=1)]
        if not moving.size:
            break
    return chosen


def totals(table: Table, chosen: Indices) -> Array:
    """Return the (B, m) sums of gains of (B, n) choices; -1 is a camera that does not count yet."""
    total = np.zeros((len(chosen), len(table.weights)))
    for camera, gain in enumerate(table.gains):
        picked = chosen[:, camera]
        total += np.where(picked[:, None] >= 0, gain[picked], 0.0)
    return total


def _best_for(table: Table, chosen: Indices, camera: int) -> Indices:
    """Return (B,) the best candidate of one camera beside the others of each start; the present one at a tie."""
    present = chosen[:, camera].copy()
    others = chosen.copy()
    others[:, camera] = -1
    base = totals(table, others)
    uncovered, mean = scores(base[:, None, :] + table.gains[camera][None], table.weights)
    allowed = _apart(table, others, camera)
    best = best_index(uncovered, mean, allowed)
    rows = np.arange(len(chosen))
    settled = present >= 0
    kept = np.where(settled, present, 0)
    same = np.abs(uncovered[rows, kept] - uncovered[rows, best]) < _IMPROVEMENT
    no_gain = same & (mean[rows, best] >= mean[rows, kept] * (1.0 - _IMPROVEMENT))
    stay = settled & ((no_gain & allowed[rows, kept]) | ~allowed.any(axis=1))
    return np.where(stay, kept, best)


def _apart(table: Table, chosen: Indices, camera: int) -> Flags:
    """Tell (B, K) which candidates of one camera keep apart from the chosen ones of the others."""
    vectors = table.vectors[camera]
    allowed = np.ones((len(chosen), len(vectors)), dtype=bool)
    for other in np.flatnonzero(table.separation_m[camera]):
        picked = chosen[:, other]
        gap = vectors[None, :, :2] - table.vectors[other][picked][:, None, :2]
        least = table.separation_m[camera, other]
        allowed &= ((gap * gap).sum(axis=-1) >= least * least) | (picked[:, None] < 0)
    return allowed
