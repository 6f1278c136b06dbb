"""How far the sightings of static targets scatter, on points whose spread can be done by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.geometry.pose import transform
from camrig.interfaces import Published
from camrig.messages import Sighting
from camrig.report.spread import SpreadSink, spread
from tests.runtime_parts import one_head_rig


def sighting(name: str, x_m: float) -> Sighting:
    return Sighting(name, "north", 0.0, transform(np.eye(3), np.array([x_m, 0, 0])), np.eye(6), np.eye(6), 0.001, 1)


def test_the_spread_of_four_corners_and_an_outlier() -> None:
    points = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
    found = spread(points)
    assert (found.n, found.mean_m) == (4, (0.0, 0.0, 0.0))
    assert found.rms_m == pytest.approx(math.sqrt(2.0))
    assert found.median_m == pytest.approx(math.sqrt(2.0))
    far = spread(np.vstack([np.zeros((99, 3)), [[10.0, 0.0, 0.0]]]))
    assert far.median_m == 0.0
    assert far.rms_m == pytest.approx(math.sqrt((99 * 0.1**2 + 9.9**2) / 100))


def test_a_single_sighting_scatters_not_at_all() -> None:
    found = spread(np.array([[1.0, 2.0, 3.0]]))
    assert (found.n, found.mean_m, found.rms_m, found.median_m) == (1, (1.0, 2.0, 3.0), 0.0, 0.0)


def test_noise_of_known_size_is_measured() -> None:
    rng = np.random.default_rng(5)
    found = spread(rng.normal(0.0, 0.01, (20_000, 3)))
    assert found.rms_m == pytest.approx(0.01 * math.sqrt(3.0), rel=0.02)


def test_only_static_targets_are_collected() -> None:
    sink = SpreadSink()
    rig = one_head_rig()
    static = replace(rig.targets["robot1"], motion="static"), replace(rig.targets["robot3"], motion="static")
    sink.open(replace(rig, targets={**rig.targets, "robot1": static[0], "robot3": static[1]}))
    sink.write(Published(0.0, (), sightings=(sighting("robot1", 1.0), sighting("robot2", 1.0))))
    sink.write(Published(0.1, (), sightings=(sighting("robot1", 3.0),)))
    sink.close()
    found = sink.spreads()
    assert set(found) == {"robot1"}  # robot2 moves, robot3 was never seen
    assert (found["robot1"].n, found["robot1"].mean_m, found["robot1"].rms_m) == (2, (2.0, 0.0, 0.0), 1.0)
