"""Halls of 50 to 1000 cameras: seconds, memory, and the cost of a pair of a camera and a target that it can reach."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig import optimise
from camrig.experiments.scenes import random_hall
from camrig.optimise.configuration import task_of
from camrig.optimise.problem import problem_of
from tests.benchmarks.timed import timed

HALLS = [
    pytest.param((4, 8), id="4x8"),
    *(
        pytest.param(size, id=f"{size[0]}x{size[1]}", marks=[pytest.mark.slow, pytest.mark.timeout(900)])
        for size in ((50, 500), (200, 5_000), (1_000, 100_000))
    ),
]


@pytest.mark.parametrize("size", HALLS)
def test_a_hall(benchmark: BenchmarkFixture, size: tuple[int, int]) -> None:
    hall = random_hall(*size, 0)
    pairs = len(task_of(problem_of(hall), worst=False).reachable)
    optimise.plan(random_hall(4, 8, 0), now=time.perf_counter)
    rounds = 1 if benchmark.disabled else 3
    *_, found = timed(benchmark, lambda each: optimise.plan(each, now=time.perf_counter), [hall] * rounds)
    benchmark.extra_info.update(pairs=pairs, solve_s=found.solve_s, uncovered=len(found.uncovered))
    benchmark.extra_info["us_per_pair"] = 1e6 * found.solve_s / pairs
    benchmark.extra_info.update(memory(size))
    assert len(found.targets) == size[1]
    assert benchmark.extra_info["peak_mib"] <= 2048.0


def memory(size: tuple[int, int]) -> dict[str, float]:
    """The peak memory of a process of its own that plans such a hall, and what it was before that."""
    command = [sys.executable, "-m", "tests.benchmarks.hall", *map(str, size)]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900.0, check=True, cwd=root)
    found: dict[str, float] = json.loads(done.stdout)
    return found
