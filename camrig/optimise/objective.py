"""What is minimised: first the weight of what nobody sees, then the quality of the rest, its mean or its worst.

Compared as tuples, never as one weighted sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.kernels.state import SAME


class Score(NamedTuple):
    """Lexicographic: the weight left uncovered, then the mean or the worst quality of the covered, in metres."""

    uncovered: float
    quality_m: float


def score(quality_m: Array, weights: Array, *, worst: bool) -> Score:
    """Return the score of fused qualities (m,), infinite where nobody sees; 0 where nothing is covered."""
    covered = np.isfinite(quality_m)
    if not covered.any():
        return Score(float(weights.sum()), 0.0)
    found = quality_m[covered]
    value = found.max() if worst else (found @ weights[covered]) / weights[covered].sum()
    return Score(float(weights[~covered].sum()), float(value))


def better(new: Score, old: Score, gain: float = 0.0) -> bool:
    """Tell whether ``new`` covers more, or covers as much and is better by more than ``gain``, a share."""
    if abs(new.uncovered - old.uncovered) > SAME:
        return new.uncovered < old.uncovered
    return new.quality_m < old.quality_m * (1.0 - gain)
