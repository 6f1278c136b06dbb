"""What is minimised: first the weight of what nobody sees, then the weighted mean of the fused quality of the rest.

Compared as tuples, never as one weighted sum. ``total`` is the sum of gains sum_i V/Q of each target, (..., m) in 1/m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.sensing.visibility import Flags

_WEIGHT_TOLERANCE = 1e-9


class Score(NamedTuple):
    """Lexicographic: the weight left uncovered, then the mean fused quality of the covered in metres."""

    uncovered: float
    mean_m: float


def score(total: Array, weights: Array) -> Score:
    """Return the score of one configuration, total (m,); the mean is 0 where nothing is covered."""
    uncovered, mean = scores(total, weights)
    return Score(float(uncovered), float(mean))


def scores(total: Array, weights: Array) -> tuple[Array, Array]:
    """Return the uncovered weight and the mean quality (...,) of totals (..., m)."""
    covered = total > 0.0
    quality = np.zeros_like(total)
    np.divide(1.0, total, out=quality, where=covered)
    covered_weight = covered @ weights
    mean = (quality @ weights) / np.maximum(covered_weight, 1e-300)
    return np.asarray(weights.sum() - covered_weight), np.asarray(mean)


def better(new: Score, old: Score, gain: float = 0.0) -> bool:
    """Tell whether ``new`` covers more, or covers as much and is better by more than ``gain``, a share."""
    if abs(new.uncovered - old.uncovered) > _WEIGHT_TOLERANCE:
        return new.uncovered < old.uncovered
    return new.mean_m < old.mean_m * (1.0 - gain)


def best_index(uncovered: Array, mean: Array, allowed: Flags | None = None) -> Array:
    """Return the lexicographic arg-min along the last axis, among what is ``allowed`` where that is given."""
    if allowed is not None:
        uncovered = np.where(allowed, uncovered, np.inf)
    least = uncovered.min(axis=-1, keepdims=True)
    return np.asarray(np.where(uncovered <= least + _WEIGHT_TOLERANCE, mean, np.inf).argmin(axis=-1))
