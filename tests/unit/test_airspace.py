"""Boxes, lines of sight, and how near two flights come."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry import airspace


def test_a_box_blocks_what_passes_through_it_only() -> None:
    box = ((1.0, 1.0, 0.0), (2.0, 2.0, 1.0))
    eye = np.array([0.0, 1.5, 0.5])
    points = np.array([[3.0, 1.5, 0.5], [0.5, 1.5, 0.5], [1.0, 1.5, 0.5], [3.0, 1.5, 4.0], [0.0, 3.0, 0.5]])
    assert airspace.blocked(eye, points, [box]).tolist() == [True, False, False, False, False]
    on_top = np.array([1.5, 1.5, 1.0])
    assert not airspace.blocked(np.array([1.5, 1.5, 3.0]), on_top, [box])
    assert not airspace.blocked(eye, points, []).any()


# On a coarse grid, so that segments run along faces, through edges and corners, and stand still.
COARSE = st.tuples(*[st.integers(-2, 6).map(lambda k: k / 2.0)] * 3)
PLACES = COARSE | st.tuples(*[st.floats(-1.0, 3.0)] * 3)


@given(PLACES, PLACES, COARSE, st.tuples(*[st.sampled_from([0.5, 1.0, 2.0])] * 3))
def test_kernels_and_steering_agree_on_what_is_in_the_way(
    origin: tuple[float, ...], point: tuple[float, ...], low: tuple[float, ...], size: tuple[float, ...]
) -> None:
    start, end = np.array(origin), np.array(point)
    least, most = np.array(low), np.array(low) + np.array(size)
    a, b, c = least.tolist()
    d, e, f = most.tolist()
    assert airspace.crosses_box(start, end, least, most) == bool(airspace.blocked(start, end, [((a, b, c), (d, e, f))]))


def test_inside_is_strict() -> None:
    box = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    points = np.array([[0.5, 0.5, 0.5], [1.0, 0.5, 0.5], [2.0, 0.5, 0.5]])
    assert airspace.inside_any(points, [box]).tolist() == [True, False, False]


def test_a_flight_box_never_begins_below_one_metre() -> None:
    low, high = airspace.flight_box(((0.0, 0.0, 0.2), (5.0, 3.0, 2.5)))
    assert low.tolist() == [0.0, 0.0, 1.0]
    assert high.tolist() == [5.0, 3.0, 2.5]


def test_from_inside_a_box_the_way_out_is_free_and_the_way_deeper_is_not() -> None:
    box, inside = ((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)), np.array([0.1, 1.0, 1.0])
    out, through = np.array([-1.0, 1.5, 1.0]), np.array([3.0, 1.0, 1.0])
    assert airspace.blocked(inside, np.array([out, through]), airspace.eased([box], inside)).tolist() == [False, True]
    assert airspace.eased([box], out) == [box]
    assert airspace.eased([box], np.array([1.0, 1.0, 1.0])) == []


def test_a_widened_box_reaches_further_on_every_side() -> None:
    (low, high) = airspace.widened([((0.0, 0.0, 0.0), (2.0, 2.0, 2.0))], 0.5)[0]
    assert (low, high) == ((-0.5, -0.5, -0.5), (2.5, 2.5, 2.5))


COORDINATE = st.floats(-3.0, 3.0)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)


@given(POINT, POINT, POINT, POINT)
def test_least_distance_is_that_of_the_nearest_pair_of_points(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> None:
    shares = np.linspace(0.0, 1.0, 101)[:, None]
    pairs = (a + shares * (b - a))[:, None] - (c + shares * (d - c))[None]
    sampled = np.linalg.norm(pairs, axis=-1).min()
    least = airspace.least_distance(a, b, c, d)
    assert least <= sampled + 1e-9
    assert least == pytest.approx(sampled, abs=float(0.02 * (np.linalg.norm(b - a) + np.linalg.norm(d - c))) + 1e-9)


def test_crossing_flights_have_no_distance() -> None:
    a, b = np.array([0.0, 0.0]), np.array([2.0, 2.0])
    assert airspace.least_distance(a, b, np.array([0.0, 2.0]), np.array([2.0, 0.0])) == pytest.approx(0.0, abs=1e-12)
    assert airspace.least_distance(a, b, np.array([1.0, 0.0]), np.array([3.0, 2.0])) == pytest.approx(2**-0.5)
