"""What it saves to let heads stay where moving hardly pays: targets walk, every second a plan from the running aims."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig import optimise
from camrig.experiments.scenes import random_scene
from camrig.experiments.statistics import median
from camrig.messages import Aim, HeadAim, RigPlan
from camrig.optimise import Scene
from tests.benchmarks.moving import moved
from tests.benchmarks.timed import timed

STEPS, STEP_M, GAIN = 30, 0.1, 0.02
GIVEN_BACK = 0.5
"""The share of the gain that putting single heads back may cost: what a move brings after that is at least the rest."""


@dataclass(frozen=True)
class Walk:
    """What following the targets took, and what it gave, step by step."""

    motion_rad: float
    moves: int
    plans: tuple[RigPlan, ...]
    gains: tuple[float, ...]
    """The share by which a plan that moved heads was better than staying; infinite where it covered more."""


def travel_rad(before: Mapping[str, Aim], after: Mapping[str, Aim]) -> list[float]:
    """How far each head turns, pan and tilt together."""
    ways = []
    for name, aim in after.items():
        old = before[name]
        assert isinstance(aim, HeadAim)
        assert isinstance(old, HeadAim)
        ways.append(abs(aim.pan_rad - old.pan_rad) + abs(aim.tilt_rad - old.tilt_rad))
    return ways


def walk_of(scene: Scene, count: int, seed: int) -> list[Scene]:
    """Return a scene and ``count`` more, in each of which every target has gone on."""
    rng, steps = np.random.default_rng(seed), [scene]
    for _ in range(count):
        steps.append(moved(steps[-1], STEP_M, rng))
    return steps


def follow(steps: Sequence[Scene], gain: float) -> Walk:
    """Plan the first step from nothing, every later one from where the heads are."""
    aims = optimise.plan(steps[0], seed=0, now=time.perf_counter).aims
    motion_rad, moves, plans, gains = 0.0, 0, [], []
    for step in steps[1:]:
        scene = replace(step, settings=replace(step.settings, gain=gain))
        found = optimise.plan(scene, start=aims, quick=True, seed=0, now=time.perf_counter)
        ways = travel_rad(aims, found.aims)
        if any(ways):
            gains.append(gain_of(optimise.quality_at(scene, aims), found))
        motion_rad, moves = motion_rad + sum(ways), moves + sum(way > 0.0 for way in ways)
        plans.append(found)
        aims = found.aims
    return Walk(motion_rad, moves, tuple(plans), tuple(gains))


def gain_of(staying: RigPlan, found: RigPlan) -> float:
    if len(found.uncovered) < len(staying.uncovered) or not staying.objective_m or not found.objective_m:
        return math.inf
    return 1.0 - found.objective_m / staying.objective_m


@pytest.mark.parametrize(
    "size", [(5, 10), pytest.param((7, 20), marks=[pytest.mark.slow, pytest.mark.timeout(900)])], ids=["5x10", "7x20"]
)
def test_heads_that_stay_where_moving_hardly_pays(benchmark: BenchmarkFixture, size: tuple[int, int]) -> None:
    seeds, count = (range(1), 5) if benchmark.disabled else (range(10), STEPS)
    walks = [walk_of(random_scene("ptz", *size, seed), count, seed) for seed in seeds]
    calm = timed(benchmark, lambda walk: follow(walk, GAIN), walks)
    eager = [follow(walk, 0.0) for walk in walks]
    saved = [100.0 * (1.0 - a.motion_rad / b.motion_rad) for a, b in zip(calm, eager, strict=True)]
    lost = [100.0 * (lasting_m(a) / lasting_m(b) - 1.0) for a, b in zip(calm, eager, strict=True)]
    gains = [gain for walk in calm for gain in walk.gains]
    benchmark.extra_info.update(
        walks=len(walks),
        steps=count,
        motion_rad={"calm": [each.motion_rad for each in calm], "eager": [each.motion_rad for each in eager]},
        moves={"calm": sum(each.moves for each in calm), "eager": sum(each.moves for each in eager)},
        motion_saved_percent=summary_of(saved),
        quality_lost_percent=summary_of(lost),
        least_gain_of_a_move_percent=100.0 * min(gains, default=math.inf),
    )
    assert all(gain >= GAIN * (1.0 - GIVEN_BACK) for gain in gains)
    for walk in zip(calm, eager, strict=True):
        assert len({len(each.plans) for each in walk}) == 1


def lasting_m(walk: Walk) -> float:
    """The mean over a walk of what the plans reach."""
    return float(np.mean([found.objective_m for found in walk.plans if found.objective_m is not None]))


def summary_of(values: Sequence[float]) -> dict[str, float]:
    found = median(values)
    return {"median": found.value, "low": found.low, "high": found.high, "mean": float(np.mean(values))}
