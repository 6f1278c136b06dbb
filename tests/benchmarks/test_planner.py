"""What the planner costs and what it gives for it.

    pytest tests/benchmarks --benchmark-enable -m 'slow or not slow' --benchmark-json FILE

Times are pytest-benchmark's, everything else is in ``extra_info``. Without ``--benchmark-enable`` every body runs once,
on as little as shows that it works.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig import optimise
from camrig.config.scene import load_scene
from camrig.experiments.planner import Clocks, Setup, run
from camrig.experiments.planner_report import cells
from camrig.experiments.scenes import Mode, random_scene
from camrig.experiments.statistics import spread
from camrig.messages import Aim, RigPlan
from camrig.optimise import PlannerSettings, Scene
from camrig.optimise.scene import Visibility
from tests.benchmarks.moving import moved
from tests.benchmarks.timed import timed

SCENES = 10
SIZES = [(3, 3), (5, 10), pytest.param((7, 20), marks=[pytest.mark.slow, pytest.mark.timeout(900)])]
MODES: list[Mode] = ["ptz", "drone"]
CLOCKS = Clocks(time.perf_counter, time.process_time)


def in_words(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def plan(scene: Scene) -> RigPlan:
    return optimise.plan(scene, seed=0, now=time.perf_counter)


def replan(case: tuple[Scene, Mapping[str, Aim]]) -> RigPlan:
    later, aims = case
    return optimise.plan(later, start=aims, quick=True, seed=0, now=time.perf_counter)


def scenes(benchmark: BenchmarkFixture, mode: Mode, size: tuple[int, int]) -> list[Scene]:
    settings = PlannerSettings(visibility="cone")
    return [random_scene(mode, *size, seed, settings) for seed in range(1 if benchmark.disabled else SCENES)]


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("size", ["3x3", "5x10", "7x20"])
@pytest.mark.parametrize("mode", MODES)
def test_cold_on_a_reference_scene(
    benchmark: BenchmarkFixture, shared_data: Path, mode: Mode, size: str, visibility: Visibility
) -> None:
    scene = load_scene(shared_data / "scenes" / f"{mode}_{size}_8.yaml").scene
    scene = replace(scene, settings=replace(scene.settings, visibility=visibility))
    found = benchmark(plan, scene)
    assert found.uncovered == ()


@pytest.mark.parametrize("size", SIZES, ids=in_words)
@pytest.mark.parametrize("mode", MODES)
def test_cold_on_random_scenes(benchmark: BenchmarkFixture, mode: Mode, size: tuple[int, int]) -> None:
    """A round is a scene: the median is over scenes."""
    found = timed(benchmark, plan, scenes(benchmark, mode, size))
    benchmark.extra_info["uncovered"] = sum(len(each.uncovered) for each in found)
    assert all(each.objective_m is not None for each in found)


@pytest.mark.parametrize("size", SIZES, ids=in_words)
@pytest.mark.parametrize("mode", MODES)
def test_cold_beside_the_papers_solvers(benchmark: BenchmarkFixture, mode: Mode, size: tuple[int, int]) -> None:
    """Ratios of paired times, gaps and counts of slsqp and ipopt beside camrig's, on the same scenes in turns."""
    pytest.importorskip("casadi")
    runs = 1 if benchmark.disabled else SCENES
    setup = Setup(sizes=(size,), modes=(mode,), runs=runs, solvers=("camrig", "slsqp", "ipopt"))
    (solved,) = timed(benchmark, lambda each: list(run(each, CLOCKS)), [setup])
    found = cells(solved)
    benchmark.extra_info["cells"] = [asdict(cell) for cell in found]
    assert [cell.solver for cell in found] == list(setup.solvers)
    assert (found[0].uncovered, found[0].not_permitted) == (0, 0)


@pytest.mark.parametrize("size", SIZES, ids=in_words)
@pytest.mark.parametrize("mode", MODES)
def test_warm_after_targets_moved_a_little(benchmark: BenchmarkFixture, mode: Mode, size: tuple[int, int]) -> None:
    """From the running aims after every target moved 0.1 m, beside a plan of the same from nothing."""
    cases = [
        (moved(scene, 0.1, np.random.default_rng(number)), plan(scene).aims)
        for number, scene in enumerate(scenes(benchmark, mode, size))
    ]
    warm = timed(benchmark, replan, cases)
    cold = [plan(later) for later, _ in cases]
    pairs = list(zip(warm, cold, strict=True))
    gaps = [
        100.0 * (new.objective_m / best.objective_m - 1.0)
        for new, best in pairs
        if new.objective_m and best.objective_m and len(new.uncovered) == len(best.uncovered)
    ]
    gap = spread(gaps)
    benchmark.extra_info["mean_gap_percent"] = float(np.mean(gaps)) if gaps else None
    benchmark.extra_info["gap_percent"] = None if gap is None else asdict(gap)
    benchmark.extra_info["cold_ms"] = [1e3 * each.solve_s for each in cold]
    assert all(len(new.uncovered) <= len(best.uncovered) for new, best in pairs)
