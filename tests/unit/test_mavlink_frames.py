"""NED and ENU: hand-made values first, then the inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.rotation import wrap_angle, yaw_of
from camrig_drivers.mavlink.frames import (
    R_world_body,
    ned_from_world,
    world_from_ned,
    yaw_enu_from_ned,
    yaw_ned_from_enu,
)

ORIGIN_M = (0.5, -0.2, 0.1)
metres = st.floats(-100.0, 100.0)
angles = st.floats(-math.pi, math.pi)


def test_east_north_up_becomes_north_east_down() -> None:
    assert ned_from_world((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)) == (2.0, 1.0, -3.0)
    assert world_from_ned((2.0, 1.0, -3.0), (0.0, 0.0, 0.0)) == (1.0, 2.0, 3.0)


def test_origin_is_where_the_local_frame_starts_in_the_world() -> None:
    assert world_from_ned((0.0, 0.0, 0.0), ORIGIN_M) == ORIGIN_M


@given(st.tuples(metres, metres, metres))
def test_positions_come_back(position_m: tuple[float, float, float]) -> None:
    assert world_from_ned(ned_from_world(position_m, ORIGIN_M), ORIGIN_M) == pytest.approx(position_m, abs=1e-12)


@pytest.mark.parametrize(
    ("east_ccw_deg", "north_cw_deg"), [(0.0, 90.0), (90.0, 0.0), (45.0, 45.0), (-90.0, 180.0), (180.0, -90.0)]
)
def test_yaw_golden(east_ccw_deg: float, north_cw_deg: float) -> None:
    yaw_ned_rad = yaw_ned_from_enu(math.radians(east_ccw_deg))
    assert math.cos(yaw_ned_rad - math.radians(north_cw_deg)) == pytest.approx(1.0)


@given(angles)
def test_yaw_comes_back(yaw_rad: float) -> None:
    assert abs(wrap_angle(yaw_enu_from_ned(yaw_ned_from_enu(yaw_rad)) - yaw_rad)) < 1e-12


@given(angles)
def test_level_attitude_is_yaw_alone(yaw_ned_rad: float) -> None:
    R = R_world_body(0.0, 0.0, yaw_ned_rad)
    assert R[2] == pytest.approx(np.array([0.0, 0.0, 1.0]))
    assert abs(wrap_angle(yaw_of(R) - yaw_enu_from_ned(yaw_ned_rad))) < 1e-9


def test_nose_down_points_forward_axis_down() -> None:
    forward = R_world_body(0.0, -0.1, math.pi / 2.0)[:, 0]  # nose east, pitched down
    assert forward == pytest.approx(np.array([math.cos(0.1), 0.0, -math.sin(0.1)]))


def test_rolling_right_points_left_axis_up() -> None:
    left = R_world_body(0.1, 0.0, math.pi / 2.0)[:, 1]  # nose east: left is north
    assert left == pytest.approx(np.array([0.0, math.cos(0.1), math.sin(0.1)]))
