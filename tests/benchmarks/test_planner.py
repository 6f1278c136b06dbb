"""How long a plan takes: cold, and warm after the targets moved 0.1 m. Run with ``--benchmark-enable``."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig import optimise
from camrig.config.scene import load_scene
from camrig.optimise import Scene, SceneTarget
from camrig.optimise.scene import Visibility

CASES = (("3x3", "cone"), ("5x10", "cone"), ("5x10", "image"), ("7x20", "cone"))


def moved(scene: Scene, distance_m: float, seed: int) -> Scene:
    turns = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(scene.targets))

    def step(target: SceneTarget, turn: float) -> SceneTarget:
        x, y, z = target.position_m
        return replace(target, position_m=(x + distance_m * np.cos(turn), y + distance_m * np.sin(turn), z))

    return replace(scene, targets=tuple(step(t, turn) for t, turn in zip(scene.targets, turns, strict=True)))


@pytest.fixture
def scene(shared_data: Path, kind: str, size: str, visibility: Visibility) -> Scene:
    scene = load_scene(shared_data / "scenes" / f"{kind}_{size}_8.yaml").scene
    return replace(scene, settings=replace(scene.settings, visibility=visibility))


@pytest.mark.parametrize(("size", "visibility"), CASES)
@pytest.mark.parametrize("kind", ["ptz", "drone"])
def test_cold(benchmark: BenchmarkFixture, scene: Scene) -> None:
    plan = benchmark(lambda: optimise.plan(scene, seed=1, now=time.monotonic))
    assert plan.uncovered == ()


@pytest.mark.parametrize(("size", "visibility"), CASES)
@pytest.mark.parametrize("kind", ["ptz", "drone"])
def test_warm(benchmark: BenchmarkFixture, scene: Scene) -> None:
    start = optimise.plan(scene, seed=1, now=time.monotonic).aims
    later = moved(scene, 0.1, seed=1)
    plan = benchmark(lambda: optimise.plan(later, start=start, seed=1, now=time.monotonic))
    assert plan.uncovered == ()
