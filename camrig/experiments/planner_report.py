"""The scenes of ``planner`` -> figures by mode, size and solver; as a JSON object and as a Markdown table. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

from camrig.experiments.machine import in_words
from camrig.experiments.planner import SAME, Answer, SceneRun, Setup
from camrig.experiments.scenes import Mode
from camrig.experiments.statistics import Ranged, Spread, paired_ratio, spread
from camrig.optimise.solvers import Solver

REFERENCE: Solver = "camrig"
"""Whose time the others' are divided by."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One solver on ``n`` scenes; ``gap_percent`` is over those of which it covers as much as the best does."""

    solver: Solver
    n: int
    solve_ms: Spread
    cpu_ms: Spread
    build_ms: Spread
    ratio: Ranged | None
    cpu_ratio: Ranged | None
    gap_percent: Spread | None
    uncovered: int
    """Targets it leaves out beyond those that the best leaves out, over all scenes."""
    short: int
    """Scenes of which it covers less than the best."""
    best: int
    """Scenes of which it is the best, within 1e-6."""
    not_permitted: int
    """Scenes of which its plan breaks a rule of the drones or the anchors."""


@dataclass(frozen=True, slots=True)
class Group:
    """The cells of all solvers on the same scenes: those of a mode and a size."""

    mode: Mode
    cameras: int
    targets: int
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """All that a run of the experiment is told by."""

    setup: Setup
    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]
    left_out: Mapping[Solver, str]
    scenes: Sequence[SceneRun]


def groups(scenes: Iterable[SceneRun]) -> list[Group]:
    """Return the figures of every mode and size, in the order in which they were run."""

    def which(each: SceneRun) -> tuple[Mode, int, int]:
        return each.place.mode, each.place.cameras, each.place.targets

    return [Group(*key, cells=cells(list(members))) for key, members in itertools.groupby(scenes, which)]


def cells(scenes: Sequence[SceneRun]) -> tuple[Cell, ...]:
    """Return the figures of every solver over these scenes, which all have solved."""
    return tuple(_cell(solver, scenes) for solver in scenes[0].answers)


def _cell(solver: Solver, scenes: Sequence[SceneRun]) -> Cell:
    answers = [each.answers[solver] for each in scenes]
    gaps = [each.gap(solver) for each in scenes]
    equal = [100.0 * gap for gap in gaps if gap is not None]
    missed = [max(0, answer.worth[0] - each.best[0]) for answer, each in zip(answers, scenes, strict=True)]
    references = [each.answers[REFERENCE] for each in scenes if REFERENCE in each.answers]
    return Cell(
        solver,
        n=len(scenes),
        solve_ms=_ms(answers, lambda answer: answer.solve_s),
        cpu_ms=_ms(answers, lambda answer: answer.cpu_s),
        build_ms=_ms(answers, lambda answer: answer.build_s),
        ratio=_ratio(answers, references, lambda answer: answer.solve_s),
        cpu_ratio=_ratio(answers, references, lambda answer: answer.cpu_s),
        gap_percent=spread(equal),
        uncovered=sum(missed),
        short=sum(count > 0 for count in missed),
        best=sum(gap <= 100.0 * SAME for gap in equal),
        not_permitted=sum(not answer.permitted for answer in answers),
    )


def _ms(answers: Sequence[Answer], of: Callable[[Answer], float]) -> Spread:
    found = spread([1e3 * of(answer) for answer in answers])
    assert found is not None  # no group is empty
    return found


def _ratio(answers: Sequence[Answer], references: Sequence[Answer], of: Callable[[Answer], float]) -> Ranged | None:
    return paired_ratio([of(each) for each in answers], [of(each) for each in references]) if references else None


def as_json(report: Report) -> dict[str, object]:
    """Return the whole report, down to every scene."""
    return {
        "experiment": "planner",
        "command": report.command,
        "setup": asdict(report.setup),
        "machine": report.machine,
        "versions": report.versions,
        "left_out": report.left_out,
        "cells": [
            {"mode": group.mode, "cameras": group.cameras, "targets": group.targets, **asdict(cell)}
            for group in groups(report.scenes)
            for cell in group.cells
        ],
        "together": [asdict(cell) for cell in cells(report.scenes)],
        "scenes": [_scene_as_json(each) for each in report.scenes],
    }


def _scene_as_json(each: SceneRun) -> dict[str, object]:
    return {
        **asdict(each.place),
        "best": {"uncovered": each.best[0], "objective_m": each.best[1], "from": each.best_from},
        "solvers": {
            solver: {
                "solve_s": answer.solve_s,
                "cpu_s": answer.cpu_s,
                "build_s": answer.build_s,
                "status": answer.plan.status.value,
                "uncovered": answer.worth[0],
                "objective_m": answer.plan.objective_m,
                "gap": each.gap(solver),
                "permitted": answer.permitted,
            }
            for solver, answer in each.answers.items()
        },
    }


_HEAD = (
    "| {first} | solver | n | time, ms: median [95 %] | 90 % | CPU, ms | time / camrig's [95 %] "
    "| gap, %: median | 90 % | worst | uncovered | best |\n" + "|--" * 12 + "|"
)


def as_markdown(report: Report) -> str:
    """Return the table with its caption and the command that makes it again."""
    lines = [_caption(report), "", _HEAD.format(first="mode, size")]
    for group in groups(report.scenes):
        name = f"{group.mode} {group.cameras}x{group.targets}"
        lines += [_row(name if k == 0 else "", cell, timed=True) for k, cell in enumerate(group.cells)]
    together = cells(report.scenes)
    lines += [_row("all" if k == 0 else "", cell, timed=False) for k, cell in enumerate(together)]
    return "\n".join([*lines, "", *_notes(report, together)]) + "\n"


_MEANING = (
    "Time and CPU leave out compiling and building. Gap: to the best of all solvers and of what long searches know, "
    "over the scenes of which as many targets are covered. Uncovered: targets missed that the best covers, in how many "
    "scenes. Best: scenes within 1e-6 of the best."
)


def _caption(report: Report) -> str:
    setup = report.setup
    seeds = f"seed {setup.seed}" if setup.runs == 1 else f"seeds {setup.seed} to {setup.seed + setup.runs - 1}"
    return (
        f"**Quality `{setup.quality}`, visibility `{setup.visibility}`, objective `{setup.objective}`**: "
        f"{setup.runs} random scenes of every mode and size ({seeds}), the same for all solvers, which took turns.\n"
        f"{in_words(report.machine, report.versions)}\n\n```sh\n{report.command}\n```"
    )


def _row(first: str, cell: Cell, *, timed: bool) -> str:
    gap, time = cell.gap_percent, cell.solve_ms
    times = [f"{_ranged(time.median, '.1f')}", f"{time.p90:.1f}", f"{cell.cpu_ms.median.value:.1f}"]
    gaps = ["", "", ""] if gap is None else [f"{x:.2f}" for x in (gap.median.value, gap.p90, gap.worst)]
    fields = [
        first,
        cell.solver,
        str(cell.n),
        *(times if timed else ["", "", ""]),
        "" if cell.ratio is None else _ranged(cell.ratio, ".2f"),
        *gaps,
        f"{cell.uncovered} in {cell.short}" if cell.short else "0",
        str(cell.best),
    ]
    return f"| {' | '.join(fields)} |"


def _ranged(found: Ranged, form: str) -> str:
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"


def _notes(report: Report, together: Sequence[Cell]) -> list[str]:
    notes = [_MEANING]
    for cell in together:
        if cell.build_ms.worst > 0.0:
            built = cell.build_ms
            notes.append(
                f"{cell.solver} besides builds its graph: median {built.median.value:.0f} ms, "
                f"worst {built.worst:.0f} ms."
            )
        if cell.not_permitted:
            notes.append(f"{cell.solver} broke a rule of the drones or the anchors in {cell.not_permitted} scenes.")
    return notes + [f"Without {solver}: {reason}." for solver, reason in report.left_out.items()]
