"""One round of a benchmark a case, so that medians and percentiles are over cases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from pytest_benchmark.fixture import BenchmarkFixture

CaseT = TypeVar("CaseT")
FoundT = TypeVar("FoundT")


def timed(benchmark: BenchmarkFixture, work: Callable[[CaseT], FoundT], cases: Sequence[CaseT]) -> list[FoundT]:
    """Do the work of each case once, timed; without timing too, where pytest-benchmark would do the first alone."""
    found: list[FoundT] = []
    if benchmark.disabled:
        return [benchmark(work, case) for case in cases[:1]] + [work(case) for case in cases[1:]]
    turn = iter(cases)
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        lambda case: found.append(work(case)), setup=lambda: ((next(turn),), {}), rounds=len(cases)
    )
    return found
