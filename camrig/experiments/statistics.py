"""What is said of many figures: median with its interval, 90th percentile, worst, ratios of pairs. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array

_RESAMPLES = 2000
_SEED = 2026
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True)
class Median:
    """A median and its bootstrap 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Spread:
    """Of ``n`` figures: the median with its interval, the 90th percentile, the worst."""

    n: int
    median: Median
    p90: float
    worst: float


def spread(values: Sequence[float]) -> Spread | None:
    """Return the spread of figures of which the greatest is the worst; None of none at all."""
    if not values:
        return None
    figures = np.asarray(values, dtype=float)
    return Spread(len(figures), median(figures), float(np.percentile(figures, 90.0)), float(figures.max()))


def median(values: Sequence[float] | Array) -> Median:
    """Return the median and the percentile-bootstrap interval of it, always drawn from the same seed."""
    figures = np.asarray(values, dtype=float)
    draws = np.random.default_rng(_SEED).integers(len(figures), size=(_RESAMPLES, len(figures)))
    low, high = np.percentile(np.median(figures[draws], axis=1), _INTERVAL_PERCENT)
    return Median(float(np.median(figures)), float(low), float(high))


def paired_ratio(values: Sequence[float], references: Sequence[float]) -> Median:
    """Return the median of value / reference, pair by pair."""
    return median([value / reference for value, reference in zip(values, references, strict=True)])
