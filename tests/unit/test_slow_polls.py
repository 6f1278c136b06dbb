"""A head that is asked seldom (a slow line, many heads on it, a slow computer) is never confidently elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from camrig.geometry.arrays import Array
from camrig.locate import AxisHistory
from camrig.messages import AxisReading

STEP_S = 0.01
LASTS_S = 600.0
SPEED_RAD_S = np.radians(30.0)
SIGMA_RAD = np.radians(0.01)
SURE_SIGMAS = 4.5
WRONG_RAD = np.radians(0.5)


def moving_now_and_then(random: np.random.Generator) -> Array:
    """Return an axis's angles every ``STEP_S``: it rests for 0.3 to 6 s, and goes 2 to 60 deg with ramps."""
    speeds: list[float] = []
    while len(speeds) * STEP_S < LASTS_S:
        ramp_s = SPEED_RAD_S / np.radians(random.uniform(60.0, 300.0))
        at_speed_s = max(0.0, np.radians(random.uniform(2.0, 60.0)) / SPEED_RAD_S - ramp_s)
        times_s = np.arange(0.0, at_speed_s + 2.0 * ramp_s, STEP_S)
        ramped = np.interp(times_s, [0.0, ramp_s, ramp_s + at_speed_s, at_speed_s + 2.0 * ramp_s], [0.0, 1.0, 1.0, 0.0])
        speeds += [0.0] * int(random.uniform(0.3, 6.0) / STEP_S) + list(random.choice([-1, 1]) * SPEED_RAD_S * ramped)
    return np.cumsum(speeds) * STEP_S


@pytest.mark.parametrize("period_s", [0.1, 0.6, 0.8, 0.9, 0.99])
def test_where_polls_are_far_apart_the_pose_is_as_unsure_as_it_may_be_wrong(period_s: float) -> None:
    random = np.random.default_rng(1)
    angles_rad = moving_now_and_then(random)
    polled = np.arange(0, len(angles_rad), round(period_s / STEP_S))
    readings = tuple(
        AxisReading("pt1", "pan", float(angles_rad[at]), at * STEP_S, SIGMA_RAD, 0.005, SIGMA_RAD) for at in polled
    )
    for at in random.integers(polled[8], polled[-1], 1500):
        after = int(np.searchsorted(polled, at)) + 1
        found = AxisHistory(readings[max(0, after - 8) : after]).at(at * STEP_S)
        assert found is not None
        wrong_rad, sigma_rad = abs(found[0] - angles_rad[at]), found[1] ** 0.5
        assert wrong_rad <= max(WRONG_RAD, SURE_SIGMAS * sigma_rad), f"at {at * STEP_S} s"
