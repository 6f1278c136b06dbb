"""Robots that drive, brake hard and start again under heads that swing: what is published is honest all the while."""

from __future__ import annotations

import numpy as np
import pytest

from tests.moving_study import Room, Sample, watched

SECONDS = 10.0


def seen(motion: str, way: str, seeds: range) -> list[Sample]:
    return [sample for seed in seeds for sample in watched(Room(seed, 20.0, motion, way, SECONDS), SECONDS)]


@pytest.mark.parametrize("motion", ["floor", "drives"])
def test_no_robot_that_stops_and_starts_is_further_than_five_sigma_from_where_it_is_published(motion: str) -> None:
    """At 2 m/s2, shown by frames up to a quarter of a second old: it is centimetres off, and says that it may be."""
    found = seen(motion, "stops", range(2000, 2003))
    assert len(found) > 1200
    assert max(sample.nees for sample in found) < 25.0
    assert np.mean([sample.plane_nees for sample in found]) < 2.5
    assert np.median([sample.error_m for sample in found]) < 0.003


def test_robots_that_drive_on_along_their_arcs_are_followed_within_millimetres() -> None:
    found = seen("drives", "stadium", range(2000, 2003))
    assert max(sample.nees for sample in found) < 25.0
    assert np.quantile([sample.error_m for sample in found], 0.95) < 0.005
    assert abs(np.mean([sample.along_m for sample in found])) < 0.001
