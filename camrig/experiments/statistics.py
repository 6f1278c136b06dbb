"""What is said of many figures: medians, means and ratios of pairs with their intervals, percentiles, worst. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array

_RESAMPLES = 2000
_FEWER = 400
_SEED = 2026
_INTERVAL_PERCENT = (2.5, 97.5)


@dataclass(frozen=True, slots=True)
class Ranged:
    """A figure and its bootstrap 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Spread:
    """Of ``n`` figures: the median with its interval, the 90th percentile, the worst."""

    n: int
    median: Ranged
    p90: float
    worst: float


def spread(values: Sequence[float]) -> Spread | None:
    """Return the spread of figures of which the greatest is the worst; None of none at all."""
    if not values:
        return None
    figures = np.asarray(values, dtype=float)
    return Spread(len(figures), median(figures), float(np.percentile(figures, 90.0)), float(figures.max()))


def median(values: Sequence[float] | Array) -> Ranged:
    """Return the median and the percentile-bootstrap interval of it, always drawn from the same seed."""
    figures = np.asarray(values, dtype=float)
    return _ranged(float(np.median(figures)), np.median(figures[_draws(len(figures))], axis=1))


def paired_ratio(values: Sequence[float], references: Sequence[float]) -> Ranged:
    """Return the median of value / reference, pair by pair."""
    return median([value / reference for value, reference in zip(values, references, strict=True)])


def mean_of_groups(groups: Sequence[Array]) -> Ranged | None:
    """Return the mean of all values, and the interval that drawing whole groups again gives; None of nothing.

    Values of one group (the bodies of one scene) may share their errors: to draw them singly would make them too sure.
    """
    return ratio_of_means([(group, np.ones(len(group))) for group in groups])


def figure_of_groups(groups: Sequence[Array], figure: Callable[[Array], float]) -> Ranged:
    """Return any figure of all rows of the groups, of which at least one has some, with its interval as
    ``mean_of_groups``, from fewer draws: it is called for each.
    """
    known = [group for group in groups if len(group)]
    draws = _draws(len(known))[:_FEWER]
    return _ranged(figure(np.concatenate(known)), [figure(np.concatenate([known[k] for k in draw])) for draw in draws])


def percentile_of_groups(groups: Sequence[Array], percent: float) -> Ranged | None:
    """Return the least value that ``percent`` of all values do not exceed, with its interval as ``mean_of_groups``."""
    known = [group for group in groups if len(group)]
    if not known:
        return None
    values = np.concatenate(known)
    order = np.argsort(values)
    owner = np.repeat(np.arange(len(known)), [len(group) for group in known])[order]
    draws = _draws(len(known))
    times = (draws[:, :, None] == np.arange(len(known))).sum(axis=1)
    drawn = _percentile(values[order], times[:, owner], percent)
    value = _percentile(values[order], np.ones((1, len(values)), dtype=np.int64), percent)
    return _ranged(float(value[0]), drawn)


def _percentile(ascending: Array, times: npt.NDArray[np.int64], percent: float) -> Array:
    """Return the percentile (r,) of values (n,) that count so many ``times`` (r, n)."""
    reached = np.cumsum(times, axis=1)
    wanted = reached[:, -1:] * (percent / 100.0)
    return np.asarray(ascending[(reached >= wanted).argmax(axis=1)])


def ratio_of_means(pairs: Sequence[tuple[Array, Array]]) -> Ranged | None:
    """Return the mean of all values over that of their references, with the interval that drawing whole groups again
    gives; each group is values and references of equal length. None where there is no pair, or references are all 0.
    """
    sums = np.array([(values.sum(), references.sum()) for values, references in pairs if len(values)])
    if not len(sums) or not sums[:, 1].any():
        return None
    value, reference = sums.sum(axis=0)
    drawn = sums[_draws(len(sums))].sum(axis=1)
    return _ranged(float(value / reference), drawn[:, 0] / drawn[:, 1])


def _draws(count: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng(_SEED).integers(count, size=(_RESAMPLES, count))


def _ranged(value: float, drawn: Sequence[float] | Array) -> Ranged:
    low, high = np.percentile(drawn, _INTERVAL_PERCENT)
    return Ranged(value, float(low), float(high))
