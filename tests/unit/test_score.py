"""Published positions against the truth: errors and coverage on a grid of the world's own time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from camrig.geometry.arrays import Transform
from camrig.geometry.pose import transform
from camrig.messages import TargetStatus
from camrig.report.score import Samples, ScoreSink, coverage, errors_on_common
from tests.runtime_parts import one_head_rig, published, target

BEGAN_S = 100.0


@dataclass
class TwoStill:
    """A world whose two targets stand, which began at BEGAN_S of the monotonic clock."""

    def start(self) -> Mapping[str, str]:
        return {}

    def truth(self, stamp_s: float) -> Mapping[str, Transform]:
        assert stamp_s >= BEGAN_S
        places = {"robot1": (1.0, 2.0, 0.0), "robot2": (3.0, 1.0, 0.0)}
        return {name: transform(np.eye(3), np.array(place)) for name, place in places.items()}

    def elapsed_s(self, stamp_s: float) -> float:
        return stamp_s - BEGAN_S

    def stop(self) -> None:
        """Nothing runs."""


def scored(*instants: tuple[float, float | None]) -> ScoreSink:
    """Score robot1 at instants of the world's time, each with its error along x, None where it is lost."""
    sink = ScoreSink(TwoStill())
    sink.open(one_head_rig())
    for elapsed_s, error_m in instants:
        status = TargetStatus.LOST if error_m is None else TargetStatus.TRACKED
        sink.write(published(BEGAN_S + elapsed_s, target("robot1", (1.0 + (error_m or 0.0), 2.0, 0.0), status)))
    sink.close()
    return sink


def test_one_published_state_is_scored_per_sample() -> None:
    sink = scored((0.00, 0.01), (0.02, 0.5), (0.08, 0.5), (0.11, 0.02), (0.35, 0.03))
    assert sink.samples == {
        (0, "robot1"): pytest.approx(0.01),
        (1, "robot1"): pytest.approx(0.02),
        (3, "robot1"): pytest.approx(0.03),
    }


def test_the_error_is_the_distance_in_space() -> None:
    sink = ScoreSink(TwoStill())
    sink.write(published(BEGAN_S, target("robot2", (3.0 + 0.02, 1.0 - 0.03, 0.06))))
    assert sink.samples[0, "robot2"] == pytest.approx(0.07)


def test_what_is_lost_or_unseen_has_no_error_and_counts_as_not_covered() -> None:
    sink = ScoreSink(TwoStill())
    sink.write(published(BEGAN_S, target("robot1"), target("robot2", status=TargetStatus.UNSEEN)))
    sink.write(published(BEGAN_S + 0.15, target("robot1", status=TargetStatus.LOST), target("robot2")))
    assert [key for key, error in sink.samples.items() if error is None] == [(0, "robot2"), (1, "robot1")]
    assert coverage(sink.samples) == 0.5


def test_a_span_of_the_worlds_time_is_cut_out() -> None:
    sink = scored(*((0.1 * k + 0.01, 0.001 * k) for k in range(10)))
    assert [number for number, _ in sink.between(0.2, 0.5)] == [2, 3, 4]
    assert sink.between(2.0, 3.0) == {}


def test_only_what_both_runs_published_is_compared() -> None:
    ours: Samples = {(0, "a"): 0.01, (1, "a"): 0.03, (2, "a"): 9.0, (3, "a"): None, (4, "a"): 9.0}
    other: Samples = {(0, "a"): 0.5, (1, "a"): 0.5, (2, "a"): None, (3, "a"): 0.5}
    found = errors_on_common(ours, other)
    assert found.n == 2
    assert found.mean_m == pytest.approx(0.02)
    assert found.p95_m == pytest.approx(0.029)


def test_without_samples_nothing_is_claimed() -> None:
    assert math.isnan(coverage({}))
    found = errors_on_common({(0, "a"): 0.1}, {})
    assert found.n == 0
    assert math.isnan(found.mean_m)
    assert math.isnan(found.p95_m)
