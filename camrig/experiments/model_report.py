"""The sightings of ``model`` -> how well each model ranks and scales with the errors; JSON and Markdown. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import rankdata

from camrig.experiments.machine import in_words
from camrig.experiments.model import CORNERS, MODES, QUALITIES, Corners, Setup, Sighted
from camrig.experiments.scenes import Mode
from camrig.experiments.statistics import Ranged, figure_of_groups, mean_of_groups
from camrig.geometry.arrays import Array
from camrig.optimise.scene import Quality


@dataclass(frozen=True, slots=True)
class Prediction:
    """One model on n sightings: rank correlation with the error, log-log slope, and the median of error / promise."""

    mode: Mode
    corners: Corners
    quality: Quality
    n: int
    spearman: Ranged
    slope: Ranged
    error_over_promise: Ranged


@dataclass(frozen=True, slots=True)
class Bounds:
    """How often the paper's bounds hold: a target's error below its Q, a length's error below twice the larger Q."""

    mode: Mode
    corners: Corners
    n: int
    error_below_q: Ranged
    lengths: int
    length_below_2q: Ranged


@dataclass(frozen=True, slots=True)
class Report:
    """All that a run is told by."""

    setup: Setup
    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]
    sightings: Sequence[Sighted]


def predictions(sightings: Sequence[Sighted]) -> list[Prediction]:
    """Return how well every model predicts, by mode and corners; pictures are drawn again for the intervals."""
    found = []
    for mode, corners, quality in itertools.product(MODES, CORNERS, QUALITIES):
        groups = [
            np.array([(each.promised_m[corners][quality], _norm(each.error_m[corners])) for each in picture])
            for picture in _pictures(sightings, mode)
        ]
        if sum(map(len, groups)) < 3:
            continue
        spearman, slope, over = (figure_of_groups(groups, of) for of in (_spearman, _slope, _over))
        count = sum(map(len, groups))
        found.append(Prediction(mode, corners, quality, count, spearman, slope, over))
    return found


def bounds(sightings: Sequence[Sighted]) -> list[Bounds]:
    """Return how often the paper's bounds hold."""
    found = []
    for mode, corners in itertools.product(MODES, CORNERS):
        pictures = _pictures(sightings, mode)
        below = [np.array([_is_below(each, corners) for each in picture], float) for picture in pictures]
        pairs = [list(itertools.combinations(picture, 2)) for picture in pictures]
        lengths = [np.array([_length_is_below(*pair, corners) for pair in each], float) for each in pairs]
        held, held_lengths = mean_of_groups(below), mean_of_groups(lengths)
        if held is not None and held_lengths is not None:
            found.append(Bounds(mode, corners, sum(map(len, below)), held, sum(map(len, lengths)), held_lengths))
    return found


def _pictures(sightings: Sequence[Sighted], mode: Mode) -> list[list[Sighted]]:
    own = [each for each in sightings if each.mode == mode]
    return [[each for each in own if each.seed == seed] for seed in dict.fromkeys(each.seed for each in own)]


def _spearman(pairs: Array) -> float:
    ranks: Array = rankdata(pairs, axis=0)
    return float(np.corrcoef(ranks[:, 0], ranks[:, 1])[0, 1])


def _slope(pairs: Array) -> float:
    """Return the slope of log error over log promise."""
    promise, error = np.log(pairs).T
    return float(np.cov(promise, error)[0, 1] / np.var(promise, ddof=1))


def _over(pairs: Array) -> float:
    return float(np.median(pairs[:, 1] / pairs[:, 0]))


def _is_below(each: Sighted, corners: Corners) -> bool:
    return _norm(each.error_m[corners]) < each.promised_m[corners]["pixel"]


def _length_is_below(one: Sighted, other: Sighted, corners: Corners) -> bool:
    true = np.subtract(one.position_m, other.position_m)
    measured = true + np.subtract(one.error_m[corners], other.error_m[corners])
    largest_m = max(each.promised_m[corners]["pixel"] for each in (one, other))
    return abs(_norm(measured) - _norm(true)) < 2.0 * largest_m


def _norm(vector: Sequence[float] | Array) -> float:
    return float(np.linalg.norm(vector))


def as_json(report: Report) -> dict[str, object]:
    """Return the whole report, down to every sighting. Only ``machine`` differs between two equal runs."""
    return {
        "experiment": "model",
        "command": report.command,
        "setup": asdict(report.setup),
        "versions": dict(report.versions),
        "predictions": [asdict(each) for each in predictions(report.sightings)],
        "bounds": [asdict(each) for each in bounds(report.sightings)],
        "sightings": [asdict(each) for each in report.sightings],
        "machine": dict(report.machine),
    }


def as_markdown(report: Report) -> str:
    """Return the tables with their caption and the command that makes them again."""
    lines = [_caption(report), "", _PREDICTIONS]
    lines += [
        f"| {each.mode} | {each.corners} | {each.quality} | {each.n} | {_ranged(each.spearman)} "
        f"| {_ranged(each.slope)} | {_ranged(each.error_over_promise)} |"
        for each in predictions(report.sightings)
    ]
    lines += ["", _MEANING, "", _BOUNDS]
    lines += [
        f"| {each.mode} | {each.corners} | {each.n} | {_percent(each.error_below_q)} "
        f"| {each.lengths} | {_percent(each.length_below_2q)} |"
        for each in bounds(report.sightings)
    ]
    return "\n".join([*lines, "", _BOUNDS_MEAN]) + "\n"


_PREDICTIONS = (
    "| cameras | corners | model | n | Spearman [95 %] | log-log slope [95 %] | error / promise, median [95 %] |\n"
    + "|--" * 7
    + "|"
)
_MEANING = (
    "A model that predicts metres has slope 1. `fisher` promises an RMS error: the median of errors is then 0.67 of it "
    "where one direction outweighs the others, as depth does, 0.9 where none does; the others promise metres a pixel. "
    "Pictures are drawn again for the intervals."
)
_BOUNDS = "| cameras | corners | n | error < Q, % [95 %] | lengths | error < 2 Q, % [95 %] |\n" + "|--" * 6 + "|"
_BOUNDS_MEAN = "The paper's bounds: a target's error is below its Q, a length's error below twice the larger Q."


def _caption(report: Report) -> str:
    pictures, seed = report.setup.pictures, report.setup.seed
    return (
        f"**{pictures} pictures of heads and {pictures} of drones** (seeds {seed} to {seed + pictures - 1}): random "
        "places and aims over a floor of 5 m x 3 m full of tags of 0.16 m, the lab lens, point spread 0.7 px, noise 4 "
        "grey levels; poses of single pictures (IPPE), camera and lens exact.\n"
        f"{in_words(report.machine, report.versions)}\n\n```sh\n{report.command}\n```"
    )


def _ranged(found: Ranged) -> str:
    return f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _percent(found: Ranged) -> str:
    return f"{100.0 * found.value:.1f} [{100.0 * found.low:.1f}, {100.0 * found.high:.1f}]"
