"""The trials of ``table1`` -> figures by mode, size, condition, configuration and estimator. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.experiments import configurations
from camrig.experiments.configurations import Configuration
from camrig.experiments.estimators import ESTIMATORS, Estimator
from camrig.experiments.scenes import Mode
from camrig.experiments.statistics import Ranged, mean_of_groups, percentile_of_groups, ratio_of_means
from camrig.experiments.table1 import PAPER_BEST_MM, Condition, Trial
from camrig.geometry.arrays import Array

DETECTED: tuple[Estimator, ...] = ("mean", "quality")
REFINED: tuple[Estimator, ...] = ("mean refined", "quality refined")
"""The paper's estimators with the detector's corners, and given camrig's."""


def own_estimator(condition: Condition) -> Estimator:
    """Return camrig's estimator: where cameras are exact it is told so, as the paper's estimators take for granted."""
    return "joint exact" if condition == "exact" else "joint"


@dataclass(frozen=True, slots=True)
class Errors:
    """One estimator over n bodies, in millimetres: 3-D and on the floor, means and 95th percentiles."""

    n: int
    mean_mm: Ranged
    p95_mm: Ranged
    floor_mean_mm: Ranged
    floor_p95_mm: Ranged
    nees: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """One configuration in one cell under one condition."""

    mode: Mode
    cameras: int
    targets: int
    condition: Condition
    configuration: Configuration
    scenes: int
    coverage: float
    """Share of the bodies of which at least one tag was detected."""
    detection_rate: float
    """Share of the tags wholly in a picture that were detected in it."""
    quality_mm: Ranged | None
    """The paper's fused Q, mean over the detected bodies."""
    errors: Mapping[Estimator, Errors]


@dataclass(frozen=True, slots=True)
class Versus:
    """camrig's errors over another's, on the bodies that both found in the same rooms."""

    configuration: Configuration
    estimator: Estimator
    mean_mm: float
    ratio: Ranged


@dataclass(frozen=True, slots=True)
class Duel:
    """camrig against the paper in one cell under one condition; the paper has the best of its solvers and weights."""

    mode: Mode
    cameras: int
    targets: int
    condition: Condition
    estimator: Estimator
    mean_mm: Ranged
    coverage: float
    best_coverage: float
    detected: Versus | None
    refined: Versus | None
    printed_mm: float | None


@dataclass(frozen=True, slots=True)
class Models:
    """camrig planned by ``fisher`` over camrig planned by ``pixel``, in one cell under one condition."""

    mode: Mode
    cameras: int
    targets: int
    condition: Condition
    ratio: Ranged


Cell = tuple[Mode, int, int, Condition]
Method = tuple[Configuration, Estimator]


def by_cell(trials: Iterable[Trial]) -> Iterator[tuple[Cell, list[Trial]]]:
    """Yield the trials of every mode, size and condition, conditions outermost."""

    def which(trial: Trial) -> Cell:
        return trial.mode, trial.cameras, trial.targets, trial.condition

    known = list(trials)
    cells = dict.fromkeys(which(trial) for trial in known)
    conditions = dict.fromkeys(cell[3] for cell in cells)
    for condition, cell in itertools.product(conditions, cells):
        if cell[3] == condition:
            yield cell, [trial for trial in known if which(trial) == cell]


def rows(trials: Sequence[Trial]) -> list[Row]:
    """Return the figures of every configuration in every cell."""
    return [row for cell, members in by_cell(trials) for row in _rows(cell, members)]


def _rows(cell: Cell, members: Sequence[Trial]) -> list[Row]:
    mode, cameras, targets, condition = cell
    found = []
    for configuration in dict.fromkeys(trial.configuration for trial in members):
        own = [trial for trial in members if trial.configuration == configuration]
        qualities = [1e3 * np.array(list(trial.quality_m.values())) for trial in own]
        found.append(
            Row(
                mode,
                cameras,
                targets,
                condition,
                configuration,
                scenes=len(own),
                coverage=sum(len(trial.quality_m) for trial in own) / (targets * len(own)),
                detection_rate=sum(trial.detected for trial in own) / max(1, sum(trial.in_picture for trial in own)),
                quality_mm=mean_of_groups(qualities),
                errors={name: each for name in ESTIMATORS if (each := _errors(own, name)) is not None},
            )
        )
    return found


def _errors(trials: Sequence[Trial], estimator: Estimator) -> Errors | None:
    vectors = [1e3 * _vectors(trial, estimator) for trial in trials]
    space, floor = ([np.linalg.norm(each[:, :axes], axis=1) for each in vectors] for axes in (3, 2))
    mean, floor_mean = (mean_of_groups(each) for each in (space, floor))
    p95, floor_p95 = (percentile_of_groups(each, 95.0) for each in (space, floor))
    if mean is None or p95 is None or floor_mean is None or floor_p95 is None:
        return None
    nees = [value for trial in trials for value in trial.nees[estimator].values()]
    count = sum(len(each) for each in space)
    return Errors(count, mean, p95, floor_mean, floor_p95, nees=float(np.mean(nees)) if nees else None)


def _vectors(trial: Trial, estimator: Estimator) -> Array:
    return np.array(list(trial.errors_m[estimator].values())).reshape(-1, 3)


def duels(trials: Sequence[Trial], own: Configuration) -> list[Duel]:
    """Return camrig against the paper in every cell in which camrig's configuration was run."""
    found = []
    for cell, members in by_cell(trials):
        mode, cameras, targets, condition = cell
        estimator, figures = own_estimator(condition), _rows(cell, members)
        mine = next((row for row in figures if row.configuration == own), None)
        if mine is None or estimator not in mine.errors:
            continue
        found.append(
            Duel(
                mode,
                cameras,
                targets,
                condition,
                estimator,
                mean_mm=mine.errors[estimator].mean_mm,
                coverage=mine.coverage,
                best_coverage=max(row.coverage for row in figures),
                detected=_versus(members, figures, (own, estimator), DETECTED),
                refined=_versus(members, figures, (own, estimator), REFINED),
                printed_mm=PAPER_BEST_MM.get((mode, cameras, targets)),
            )
        )
    return found


def models(trials: Sequence[Trial]) -> list[Models]:
    """Return how camrig's two quality models compare, in every cell in which both were run."""
    found = []
    for (mode, cameras, targets, condition), members in by_cell(trials):
        estimator = own_estimator(condition)
        each = ratio(members, ("camrig-fisher", estimator), ("camrig-pixel", estimator))
        if each is not None:
            found.append(Models(mode, cameras, targets, condition, each))
    return found


def ratio(trials: Sequence[Trial], one: Method, other: Method) -> Ranged | None:
    """Return the 3-D errors of one method over another's, on the bodies that both found in the same rooms."""
    by_seed: dict[int, dict[Configuration, Trial]] = {}
    for trial in trials:
        by_seed.setdefault(trial.seed, {})[trial.configuration] = trial
    pairs = []
    for configured in by_seed.values():
        if one[0] in configured and other[0] in configured:
            mine, theirs = configured[one[0]].errors_m[one[1]], configured[other[0]].errors_m[other[1]]
            both = [name for name in mine if name in theirs]
            pairs.append((_norms([mine[name] for name in both]), _norms([theirs[name] for name in both])))
    return ratio_of_means(pairs)


def _norms(vectors: Sequence[Sequence[float]]) -> Array:
    return np.asarray(np.linalg.norm(np.array(vectors).reshape(-1, 3), axis=1))


def _versus(trials: Sequence[Trial], figures: Sequence[Row], own: Method, theirs: Sequence[Estimator]) -> Versus | None:
    """Return camrig against whichever of the paper's solvers and given estimators has the least mean error."""
    candidates = [
        (row.errors[name].mean_mm.value, row.configuration, name)
        for row in figures
        if row.configuration in configurations.PAPERS
        for name in theirs
        if name in row.errors
    ]
    if not candidates:
        return None
    mean_mm, configuration, name = min(candidates)
    compared = ratio(trials, own, (configuration, name))
    return None if compared is None else Versus(configuration, name, mean_mm, compared)
