"""``table1`` as a JSON object and as Markdown. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from camrig.experiments.configurations import Configuration
from camrig.experiments.estimators import ESTIMATORS, Estimator
from camrig.experiments.machine import in_words
from camrig.experiments.statistics import Ranged
from camrig.experiments.table1 import Setup, Trial
from camrig.experiments.table1_figures import Duel, Models, Row, Versus, duels, models, rows


@dataclass(frozen=True, slots=True)
class Report:
    """All that a run is told by; ``own`` is the configuration that a running rig has by default."""

    setup: Setup
    own: Configuration
    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]
    left_out: Mapping[Configuration, str]
    trials: Sequence[Trial]


def as_json(report: Report) -> dict[str, object]:
    """Return the whole report, down to every body. Only ``times`` and ``machine`` differ between two equal runs."""
    return {
        "experiment": "table1",
        "command": report.command,
        "setup": asdict(report.setup),
        "own": report.own,
        "versions": dict(report.versions),
        "left_out": dict(report.left_out),
        "duels": [asdict(each) for each in duels(report.trials, report.own)],
        "models": [asdict(each) for each in models(report.trials)],
        "rows": [asdict(each) for each in rows(report.trials)],
        "trials": [_without_times(trial) for trial in report.trials],
        "times": {"plan_ms": _plan_ms(report.trials)},
        "machine": dict(report.machine),
    }


def _without_times(trial: Trial) -> dict[str, object]:
    return {key: value for key, value in asdict(trial).items() if key != "plan_s"}


def _plan_ms(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the median time of planning by mode, size and configuration."""
    times: dict[str, list[float]] = {}
    for trial in trials:
        times.setdefault(_time_key(trial), []).append(1e3 * trial.plan_s)
    return {key: float(np.median(values)) for key, values in times.items()}


def _time_key(of: Trial | Row) -> str:
    return f"{of.mode} {of.cameras}x{of.targets} {of.configuration}"


_DUELS = (
    "| rig | cell | camrig, mm [95 %] | covered: camrig / best | paper's, mm | ratio [95 %] "
    "| paper's with camrig's corners, mm | ratio [95 %] | paper prints, mm |\n" + "|--" * 9 + "|"
)
_SHORT: dict[Estimator, str] = {
    "mean": "mean",
    "quality": "1/Q",
    "mean refined": "mean, refined",
    "quality refined": "1/Q, refined",
    "covariance": "covariance",
    "joint": "joint",
    "joint exact": "joint, told exact",
}
_ROWS = (
    "| cell | configuration | covered | detected | Q, mm | plan, ms | "
    + " | ".join(_SHORT[name] for name in ESTIMATORS)
    + " | joint, floor | joint, 95 % | NEES |\n"
    + "|--" * (9 + len(ESTIMATORS))
    + "|"
)


def as_markdown(report: Report) -> str:
    """Return the tables with their caption and the command that makes them again."""
    lines = [_caption(report), "", "### camrig against the paper", "", _DUELS]
    lines += [_duel_row(each) for each in duels(report.trials, report.own)]
    lines += ["", _DUELS_MEAN]
    compared = models(report.trials)
    if compared:
        lines += ["", "### Planned by `fisher` instead of `pixel`", "", *_models_table(compared)]
    times = _plan_ms(report.trials)
    all_rows = rows(report.trials)
    for condition in dict.fromkeys(row.condition for row in all_rows):
        lines += ["", f"### Every configuration and estimator, cameras {condition}", "", _ROWS]
        lines += _rows_table([row for row in all_rows if row.condition == condition], times)
    lines += ["", _ROWS_MEAN]
    lines += [f"Without {name}: {reason}." for name, reason in report.left_out.items()]
    return "\n".join(lines) + "\n"


_DUELS_MEAN = (
    "Errors are mean 3-D errors. camrig: its default configuration and its joint estimate, which where cameras are "
    "exact is told so. The paper: the better of SQP and IPOPT with the better of equal and 1/Q weights, with the "
    "detector's corners and, beside it, with camrig's refined ones; pixel centres and lens are put right for it too. "
    "Ratio: camrig's errors over the paper's on the bodies that both found, rooms drawn again for the interval. "
    "Covered: bodies detected by at least one camera, camrig's configuration / the best of all configurations. The "
    "paper prints: its best method's mean error."
)
_ROWS_MEAN = (
    "Mean 3-D errors in mm by estimator; floor, 95 % and NEES (3 where the covariance is right) are those of "
    "camrig's joint estimate as it runs. Detected: of the tags that lie wholly in a picture. Q: the paper's, fused "
    "over the cameras that detected a body, with its 95 % interval."
)


def _caption(report: Report) -> str:
    setup = report.setup
    seeds = f"seed {setup.seed}" if setup.runs == 1 else f"seeds {setup.seed} to {setup.seed + setup.runs - 1}"
    rooms = "random room" if setup.runs == 1 else "random rooms"
    return (
        f"**{setup.runs} {rooms} of every mode and size ({seeds})**, 5 m x 3 m, the lab lens, tag36h11 of 0.16 m on "
        "the floor, point spread 0.7 px, noise 4 grey levels, exposure 2 ms, detection at decimate 1. *exact*: poses "
        "and lenses are as believed. *off*: heads point 0.1 deg wrong, drones are off by 0.1 deg and 5 mm, lenses by f "
        "0.06 %, c 0.4 px, k1 5e-4 (one sigma, drawn for every camera). *anchored*: the same, with four anchors on "
        "the floor.\n"
        f"{in_words(report.machine, report.versions)}\n\n```sh\n{report.command}\n```"
    )


def _duel_row(duel: Duel) -> str:
    printed = "" if duel.printed_mm is None else f"{duel.printed_mm:.1f}"
    return _line(
        f"{duel.mode} {duel.cameras}, {duel.targets}",
        duel.condition,
        _ranged(duel.mean_mm, ".3f"),
        f"{duel.coverage:.1%} / {duel.best_coverage:.1%}",
        *_versus(duel.detected),
        *_versus(duel.refined),
        printed,
    )


def _versus(versus: Versus | None) -> tuple[str, str]:
    if versus is None:
        return "", ""
    solver = versus.configuration.removeprefix("paper-").upper()
    return f"{versus.mean_mm:.2f} ({solver}, {_SHORT[versus.estimator].split(',')[0]})", _ranged(versus.ratio, ".3f")


def _models_table(compared: Sequence[Models]) -> list[str]:
    conditions = list(dict.fromkeys(each.condition for each in compared))
    lines = ["| rig | " + " | ".join(conditions) + " |", "|--" * (1 + len(conditions)) + "|"]
    for rig in dict.fromkeys((each.mode, each.cameras, each.targets) for each in compared):
        ratios = {
            each.condition: _ranged(each.ratio, ".2f")
            for each in compared
            if (each.mode, each.cameras, each.targets) == rig
        }
        mode, cameras, targets = rig
        lines.append(_line(f"{mode} {cameras}, {targets}", *(ratios.get(each, "") for each in conditions)))
    return [*lines, "", "Ratio of camrig's mean 3-D errors, below 1 where `fisher` is better."]


def _rows_table(found: Sequence[Row], times: Mapping[str, float]) -> list[str]:
    lines, before = [], ""
    for row in found:
        name = f"{row.mode} {row.cameras}, {row.targets}"
        joint = row.errors.get("joint")
        lines.append(
            _line(
                "" if name == before else name,
                row.configuration,
                f"{row.coverage:.1%}",
                f"{row.detection_rate:.1%}",
                "" if row.quality_mm is None else _ranged(row.quality_mm, ".2f"),
                f"{times[_time_key(row)]:.0f}",
                *(f"{row.errors[each].mean_mm.value:.3g}" if each in row.errors else "" for each in ESTIMATORS),
                *(
                    ("", "", "")
                    if joint is None
                    else (
                        f"{joint.floor_mean_mm.value:.3g}",
                        f"{joint.p95_mm.value:.3g}",
                        "" if joint.nees is None else f"{joint.nees:.1f}",
                    )
                ),
            )
        )
        before = name
    return lines


def _line(*fields: str) -> str:
    return f"| {' | '.join(fields)} |"


def _ranged(found: Ranged, form: str) -> str:
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"
