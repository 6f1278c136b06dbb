"""The scores of ``table2`` -> figures by method; JSON and Markdown. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from camrig.experiments.machine import in_words
from camrig.experiments.statistics import Ranged, mean_of_groups, ratio_of_means
from camrig.experiments.table2 import ESTIMATORS, Estimator, Method, Score

PAPER: Mapping[Method, tuple[float, float]] = {
    "manual": (1.610, 56.0),
    "arslan": (1.482, 37.2),
    "paper-sqp": (1.165, 35.3),
}
"""The average Q and error (mm) that the paper prints for manual aim, Arslan's method and its own."""

OWN: Method = "camrig"
BY_HAND: Method = "manual"


@dataclass(frozen=True, slots=True)
class Row:
    """One method over all scenes. ``error_mm`` is its own: published by camrig, the better of the paper's means by
    others; ``over_manual`` and ``camrig_over`` compare these on the targets that both saw.
    """

    method: Method
    scenes: int
    coverage: float
    quality_mm: Ranged | None
    errors_mm: Mapping[Estimator, Ranged]
    estimator: Estimator
    over_manual: Ranged | None
    camrig_over: Ranged | None


@dataclass(frozen=True, slots=True)
class Report:
    """All that a run is told by."""

    rig: str
    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]
    scores: Sequence[Score]


def rows(scores: Sequence[Score]) -> list[Row]:
    """Return the figures of every method."""
    methods = dict.fromkeys(score.method for score in scores)
    of = {method: [score for score in scores if score.method == method] for method in methods}
    errors = {method: _errors_mm(own) for method, own in of.items()}
    best = {method: _own_estimator(method, errors[method]) for method in methods if errors[method]}
    found = []
    for method, own in of.items():
        if method not in best:
            continue
        found.append(
            Row(
                method,
                scenes=len(own),
                coverage=sum(len(score.quality_m) for score in own) / sum(score.targets for score in own),
                quality_mm=mean_of_groups([1e3 * np.array(list(score.quality_m.values())) for score in own]),
                errors_mm=errors[method],
                estimator=best[method],
                over_manual=_ratio(of, best, method, BY_HAND),
                camrig_over=_ratio(of, best, OWN, method),
            )
        )
    return found


def _errors_mm(scores: Sequence[Score]) -> dict[Estimator, Ranged]:
    found = {
        name: mean_of_groups([1e3 * np.array(list(score.error_m[name].values())) for score in scores])
        for name in ESTIMATORS
    }
    return {name: each for name, each in found.items() if each is not None}


def _own_estimator(method: Method, errors: Mapping[Estimator, Ranged]) -> Estimator:
    """Return camrig's published positions for camrig, the better of the paper's means for the others."""
    if method == OWN:
        return "published"
    return "mean" if errors["mean"].value <= errors["quality"].value else "quality"


def _ratio(
    of: Mapping[Method, Sequence[Score]], best: Mapping[Method, Estimator], one: Method, other: Method
) -> Ranged | None:
    if one not in best or other not in best:
        return None
    theirs = {score.scene: score.error_m[best[other]] for score in of[other]}
    pairs = []
    for score in of[one]:
        mine, reference = score.error_m[best[one]], theirs.get(score.scene, {})
        both = [target for target in mine if target in reference]
        pairs.append((np.array([mine[name] for name in both]), np.array([reference[name] for name in both])))
    return ratio_of_means(pairs)


def as_json(report: Report) -> dict[str, object]:
    """Return the whole report, down to every target."""
    return {
        "experiment": "table2",
        "command": report.command,
        "rig": report.rig,
        "versions": dict(report.versions),
        "rows": [asdict(row) for row in rows(report.scores)],
        "scores": [asdict(score) for score in report.scores],
        "machine": dict(report.machine),
    }


_HEAD = (
    "| method | scenes | seen | Q, mm/px | mean, mm | 1/Q, mm | published, mm | its own / manual's "
    "| camrig's / its own | paper: Q, mm |\n" + "|--" * 10 + "|"
)
_MEANING = (
    "Mean 3-D errors with their 95 % intervals, scenes drawn again. mean, 1/Q: the paper's means of single cameras' "
    "poses, heads where they say they are. published: camrig's estimate; it remembers what earlier aims of a scene "
    "showed, and camrig aims first. Its own: published for camrig, the better of the means for every other method."
)


def as_markdown(report: Report) -> str:
    """Return the table with its caption and the command that makes it again."""
    lines = [
        f"**{report.rig}**, through the running daemon: real drivers, targets that stand still.",
        in_words(report.machine, report.versions),
        "",
        f"```sh\n{report.command}\n```",
        "",
        _HEAD,
    ]
    for row in rows(report.scores):
        printed = PAPER.get(row.method)
        fields = [
            row.method,
            str(row.scenes),
            f"{row.coverage:.1%}",
            _ranged(row.quality_mm),
            *(_ranged(row.errors_mm.get(name)) for name in ESTIMATORS),
            _ranged(row.over_manual),
            _ranged(row.camrig_over),
            "" if printed is None else f"{printed[0]:.3f}, {printed[1]:.1f}",
        ]
        lines.append(f"| {' | '.join(fields)} |")
    return "\n".join([*lines, "", _MEANING]) + "\n"


def _ranged(found: Ranged | None) -> str:
    return "" if found is None else f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"
