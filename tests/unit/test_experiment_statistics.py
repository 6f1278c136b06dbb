"""Medians with their intervals, and the gaps and counts by which solvers are compared."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camrig.experiments import best_known
from camrig.experiments.best_known import Task
from camrig.experiments.planner import Answer, Clocks, SceneRun, Setup, run
from camrig.experiments.planner_report import cells, groups
from camrig.experiments.scenes import Place, random_hall, random_scene
from camrig.experiments.statistics import median, paired_ratio, spread
from camrig.messages import PlanStatus, RigPlan, TargetQuality
from camrig.optimise.configuration import task_of
from camrig.optimise.problem import problem_of
from camrig.optimise.solvers import Solver


def test_a_spread_is_the_median_the_90_percent_and_the_worst() -> None:
    found = spread([3.0, 1.0, 2.0, 5.0, 4.0])
    assert found is not None
    assert (found.n, found.median.value, found.worst) == (5, 3.0, 5.0)
    assert found.p90 == pytest.approx(4.6)
    assert 1.0 <= found.median.low < 3.0 < found.median.high <= 5.0
    assert spread([]) is None


def test_an_interval_is_the_same_every_time_and_nothing_wide_for_figures_that_agree() -> None:
    values = np.random.default_rng(1).normal(10.0, 1.0, 40)
    assert median(values) == median(values)
    assert median([7.0] * 5) == median([7.0])
    assert (median([7.0]).low, median([7.0]).high) == (7.0, 7.0)


def test_the_interval_holds_the_true_median_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    intervals = [median(rng.exponential(size=30)) for _ in range(200)]
    hits = sum(each.low <= math.log(2.0) <= each.high for each in intervals)
    assert 0.9 <= hits / 200 <= 0.99


def test_ratios_are_taken_pair_by_pair() -> None:
    assert paired_ratio([2.0, 30.0, 400.0], [1.0, 10.0, 100.0]).value == 3.0
    with pytest.raises(ValueError, match="zip"):
        paired_ratio([1.0], [1.0, 2.0])


def answer(uncovered: int, objective_m: float, solve_s: float = 1.0, *, permitted: bool = True) -> Answer:
    missed = tuple(f"t{k}" for k in range(uncovered))
    targets = dict.fromkeys(missed, TargetQuality(None, ()))
    found = RigPlan(0, 0.0, PlanStatus.OPTIMISED, objective_m, {}, targets, missed, solve_s)
    return Answer(found, solve_s, solve_s, 0.0, permitted)


def scene_run(best: tuple[int, float], **answers: Answer) -> SceneRun:
    named: dict[Solver, Answer] = {"camrig": answers["camrig"], "hold": answers["hold"]}
    return SceneRun(Place("ptz", 3, 3, 0), random_scene("ptz", 1, 1, 0), named, best, "camrig")


def test_gaps_are_of_scenes_covered_as_well_as_the_best_and_the_others_are_counted() -> None:
    runs = [
        scene_run((0, 1.0), camrig=answer(0, 1.0), hold=answer(0, 1.5, 0.5)),
        scene_run((0, 1.0), camrig=answer(0, 1.0 + 5e-7), hold=answer(2, 0.1, 0.25)),
        scene_run((1, 1.0), camrig=answer(1, 1.0), hold=answer(1, 1.0, permitted=False)),
    ]
    camrig, hold = cells(runs)
    assert camrig.gap_percent is not None
    assert (camrig.n, camrig.best, camrig.uncovered, camrig.short) == (3, 3, 0, 0)
    assert camrig.gap_percent.worst == pytest.approx(5e-5)
    assert hold.gap_percent is not None
    assert hold.gap_percent.n == 1
    assert hold.gap_percent.worst == pytest.approx(50.0)
    assert (hold.best, hold.uncovered, hold.short, hold.not_permitted) == (0, 2, 1, 1)
    assert hold.ratio is not None
    assert hold.ratio.value == 0.5
    assert [len(group.cells) for group in groups(runs)] == [2]


def test_solvers_meet_the_same_scenes_and_what_is_known_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(best_known, "FILE", tmp_path / "best_known.json")
    assert best_known.load() == {}
    key = Task("cone mean", "ptz", 2, 2, 4).key
    best_known.FILE.write_text(f'{{"{key}": [0, 1e-9]}}')
    setup = Setup(sizes=((2, 2),), modes=("ptz",), runs=2, seed=3, solvers=("greedy", "hold"))
    ticks = iter(range(10**6))
    first, second = run(setup, Clocks(lambda: float(next(ticks)), lambda: 0.0))
    assert [first.place.seed, second.place.seed] == [3, 4]
    assert first.best_from in {"greedy", "hold"}
    assert first.best == min(each.worth for each in first.answers.values())
    assert (second.best, second.best_from) == ((0, 1e-9), "best known")
    assert list(first.answers) == list(second.answers) == ["greedy", "hold"]
    (unknown,) = run(replace(setup, quality="perspective", runs=1, seed=4), Clocks(lambda: 0.0, lambda: 0.0))
    assert unknown.best_from != "best known"


def test_a_hall_has_the_density_that_is_asked_for_and_every_head_reaches_a_few_times_its_share() -> None:
    for cameras, targets in ((50, 500), (30, 750)):
        hall = random_hall(cameras, targets, 1)
        assert (len(hall.cameras), len(hall.targets)) == (cameras, targets)
        reached = len(task_of(problem_of(hall), worst=False).reachable) / targets
        assert 1.5 < reached < 4.0
    assert random_hall(4, 8, 1).targets == random_hall(4, 8, 1).targets != random_hall(4, 8, 2).targets
