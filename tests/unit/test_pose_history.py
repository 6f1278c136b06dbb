"""Histories of heads and drones: interpolation at a stamp, what it costs in certainty, and what is unknown."""

from __future__ import annotations

import itertools
import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.geometry.rotation import rotation_z
from camrig.locate import AxisHistory, DroneHistory, HeadHistory, Histories
from camrig.locate.history import KEEP_S
from camrig.messages import AxisReading, DroneReading, FlightState
from camrig.rig import CameraSpec, DroneMount, FreeMount, HeadMount

LENS = BrownLens((640, 480), (500.0, 500.0), (319.5, 239.5))


def reading(
    stamp_s: float,
    angle_rad: float,
    axis: Literal["pan", "tilt"] = "pan",
    sigma_rad: float = 0.001,
    stamp_sigma_s: float = 0.0,
) -> AxisReading:
    return AxisReading("h", axis, angle_rad, stamp_s, sigma_rad, stamp_sigma_s)


def flying(stamp_s: float, position_m: Array, yaw_rad: float = 0.0, sigma: float = 0.01) -> DroneReading:
    T = pose.transform(rotation_z(yaw_rad), position_m)
    return DroneReading("d", stamp_s, T, sigma**2 * np.eye(6), FlightState.FLYING)


def pan_at(readings: list[AxisReading], stamp_s: float) -> tuple[float, float]:
    history = HeadHistory()
    for one in readings:
        history = history.with_reading(one)
    found = history.pan.at(stamp_s)
    assert found is not None
    return found


def test_an_axis_is_interpolated_between_its_readings() -> None:
    angle, variance = pan_at([reading(1.0, 0.0), reading(1.1, 0.05)], 1.04)
    assert angle == pytest.approx(0.02)
    assert variance >= (0.6**2 + 0.4**2) * 0.001**2


def test_the_short_way_round_is_taken_across_the_half_turn() -> None:
    angle, _ = pan_at([reading(0.0, math.pi - 0.01), reading(0.1, -math.pi + 0.01)], 0.05)
    assert math.cos(angle) == pytest.approx(-1.0, abs=1e-9)


def test_a_standing_axis_is_known_as_well_as_it_is_read_however_unsure_the_stamps() -> None:
    _, variance = pan_at([reading(0.0, 0.3, stamp_sigma_s=0.05), reading(0.2, 0.3, stamp_sigma_s=0.05)], 0.1)
    assert variance == pytest.approx(0.001**2, rel=1e-3)


def test_an_unsure_stamp_costs_a_moving_axis_its_rate_times_that() -> None:
    moving = [(0.0, 0.0), (0.1, 0.05)]
    _, sure = pan_at([reading(t, a) for t, a in moving], 0.1)
    _, unsure = pan_at([reading(t, a, stamp_sigma_s=0.02) for t, a in moving], 0.1)
    assert unsure - sure == pytest.approx((0.5 * 0.02) ** 2)


@given(st.floats(0.3, 1.0), st.floats(0.0, 0.2), st.floats(-2.0, 2.0), st.floats(0.0, 1.0))
def test_a_motion_of_bounded_acceleration_stays_within_two_sigma(
    start_s: float, gap_s: float, acceleration: float, share: float
) -> None:
    gap_s = max(gap_s, 0.01)

    def path(t: float) -> float:
        return 0.5 * acceleration * t * t + 0.3 * t

    assume((acceleration * start_s + 0.3) * (acceleration * (start_s + gap_s) + 0.3) > 0.0)  # it does not turn round
    a, b = reading(start_s, path(start_s)), reading(start_s + gap_s, path(start_s + gap_s))
    stamp_s = start_s + share * gap_s
    angle, variance = pan_at([a, b], stamp_s)
    assert abs(angle - path(stamp_s)) <= 2.0 * math.sqrt(variance) + 1e-12


def test_an_axis_that_turns_evenly_is_known_well_and_one_that_has_just_started_is_not() -> None:
    even = [reading(0.15 * k, 0.075 * k, sigma_rad=1e-4) for k in range(6)]
    _, while_even = pan_at(even, 0.68)
    started = [reading(0.15 * k, 0.0, sigma_rad=1e-4) for k in range(5)] + [reading(0.75, 0.02, sigma_rad=1e-4)]
    angle, while_starting = pan_at(started, 0.68)
    assert math.sqrt(while_even) < math.radians(0.05)
    assert math.sqrt(while_starting) > 3.0 * math.sqrt(while_even)
    assert angle < 0.02 * 8.0 / 15.0, "it has stood before, so it started late: the chord would be too far"


def test_certainty_falls_outside_the_readings_and_ends_half_a_second_on() -> None:
    readings = [reading(0.0, 0.0), reading(0.1, 0.01)]
    angle, soon = pan_at(readings, 0.15)
    assert angle == pytest.approx(0.015)
    _, later = pan_at(readings, 0.4)
    assert later > 10.0 * soon > 0.0
    history = HeadHistory().with_reading(readings[0]).with_reading(readings[1])
    assert history.pan.at(0.7) is None
    assert history.pan.at(-0.6) is None


def test_a_silence_of_more_than_a_second_is_not_bridged() -> None:
    history = AxisHistory((reading(0.0, 0.0), reading(1.5, 0.4)))
    assert history.at(0.7) is None
    before = history.at(1.5)
    after = history.at(1.6)
    assert before is not None
    assert after is not None
    assert before[0] == after[0] == 0.4


def test_one_reading_alone_stands_for_a_moment() -> None:
    history = AxisHistory((reading(1.0, 0.2),))
    there, soon = history.at(1.0), history.at(1.1)
    assert there is not None
    assert soon is not None
    assert there == pytest.approx((0.2, 1e-6))
    assert soon[1] > there[1]
    assert AxisHistory().at(1.0) is None


def test_pan_and_tilt_are_two_series() -> None:
    history = HeadHistory()
    for k in range(4):
        history = history.with_reading(reading(0.1 * k, 0.1 * k, "pan"))
        history = history.with_reading(reading(0.1 * k + 0.05, -0.2 * k, "tilt"))
    state = history.at(0.2)
    assert state is not None
    assert state.angles_rad == pytest.approx([0.2, -0.3])
    assert state.covariance.shape == (2, 2)
    assert history.covers(0.2)
    assert history.covers(0.3)
    assert not history.covers(0.32)  # tilt is known there, pan not yet
    assert not history.covers(0.02)
    assert HeadHistory().at(0.0) is None


def test_order_of_arrival_does_not_matter_and_three_seconds_are_kept() -> None:
    readings = [reading(0.5 * k, 0.01 * k) for k in range(5)]
    kept = set()
    for order in itertools.permutations(readings):
        history = HeadHistory()
        for one in order:
            history = history.with_reading(one)
        kept.add(history.pan.readings)
    assert kept == {tuple(readings)}
    history = HeadHistory()
    for k in range(1000):
        history = history.with_reading(reading(0.1 * k, 0.0))
    assert len(history.pan.readings) == round(KEEP_S / 0.1)
    assert history.with_reading(reading(99.9, 1.0)).pan.readings[-1].angle_rad == 1.0
    assert len(history.with_reading(reading(99.9, 1.0)).pan.readings) == len(history.pan.readings)


def test_a_drone_is_interpolated_in_place_and_attitude() -> None:
    history = DroneHistory().with_reading(flying(0.0, np.zeros(3))).with_reading(flying(0.1, np.ones(3), yaw_rad=0.2))
    found = history.at(0.025)
    assert found is not None
    T, covariance = found
    assert pytest.approx(pose.transform(rotation_z(0.05), np.full(3, 0.25))) == T
    # Shared errors: two readings are no better than one; and it may have strayed in between.
    assert (np.diag(covariance) > 0.01**2).all()
    assert (np.diag(covariance) < 0.0135**2).all()
    assert DroneHistory().at(0.0) is None


def test_a_drone_out_of_hearing_is_soon_unknown() -> None:
    history = DroneHistory().with_reading(flying(0.0, np.zeros(3))).with_reading(flying(0.1, np.array([0.1, 0.0, 0.0])))
    found = history.at(0.2)
    assert found is not None
    assert found[0][:3, 3] == pytest.approx([0.2, 0.0, 0.0])
    assert history.at(0.61) is None


def test_histories_sort_readings_by_carrier_and_know_which_cameras_they_cover() -> None:
    histories = Histories()
    for one in (reading(0.0, 0.0), reading(0.0, 0.0, "tilt"), flying(0.0, np.zeros(3)), reading(0.2, 0.0)):
        histories = histories.with_reading(one)
    on_head = CameraSpec("a", LENS, HeadMount("h", np.eye(4)))
    on_drone = CameraSpec("b", LENS, DroneMount("d", np.eye(4)))
    free = CameraSpec("c", LENS, FreeMount())
    assert not histories.covers(on_head, 0.1)
    histories = histories.with_reading(reading(0.2, 0.0, "tilt")).with_reading(flying(0.05, np.zeros(3)))
    assert histories.covers(on_head, 0.1)
    assert not histories.covers(on_drone, 0.1)
    assert histories.covers(on_drone, 0.04)
    assert histories.covers(free, 1e9)
    assert not Histories().covers(on_head, 0.0)
