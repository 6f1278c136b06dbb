"""Two cameras in two threads of a process beside two processes of one camera each: what the GIL, or a lock, costs.

pytest tests/benchmarks/test_two_cameras.py -m slow --benchmark-enable
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

ROUNDS = 5
PICTURES = {"whole": 60, "windows": 600}
MOST_RATIO = 1.10


def took_s(processes: int, threads: int, kind: str) -> float:
    """Run so many programs at once; return how long the slowest took."""
    command = [sys.executable, "-m", "tests.benchmarks.two_cameras", str(threads), str(PICTURES[kind]), kind]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(processes)
    ]
    for each in running:
        assert each.stdout is not None
        assert each.stdout.readline() == "ready\n"
    for each in running:
        assert each.stdin is not None
        each.stdin.write("go\n")
        each.stdin.flush()
    said = [json.loads(each.communicate(timeout=120)[0]) for each in running]
    assert all(found == 5 for answer in said for found in answer["found"])
    return max(float(answer["took_s"]) for answer in said)


@pytest.mark.slow
@pytest.mark.parametrize("kind", PICTURES)
def test_two_threads_are_as_fast_as_two_processes(benchmark: BenchmarkFixture, kind: str) -> None:
    pairs: list[tuple[float, float]] = []

    def pair() -> None:
        if len(pairs) % 2:
            together = took_s(1, 2, kind)
            pairs.append((together, took_s(2, 1, kind)))
        else:
            apart = took_s(2, 1, kind)
            pairs.append((took_s(1, 2, kind), apart))

    benchmark.pedantic(pair, rounds=ROUNDS)  # type: ignore[no-untyped-call]
    ratios = [together / apart for together, apart in pairs]
    ratio = statistics.median(ratios)
    benchmark.extra_info.update(ratio=ratio, ratios=[round(each, 3) for each in ratios], pictures=PICTURES[kind])
    assert ratio <= MOST_RATIO
