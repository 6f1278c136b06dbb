"""Who goes where: no exchange is better, nobody swaps, no two pass each other."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.arrays import Array
from camrig.geometry.assignment import least_travel

COUNT = st.shared(st.integers(2, 6), key="count")
POINT = st.tuples(st.floats(0.0, 6.0), st.floats(0.0, 5.0), st.floats(1.0, 3.0))
POINTS = COUNT.flatmap(lambda n: st.lists(POINT, min_size=n, max_size=n)).map(np.array)


def horizontal2(a: Array, b: Array) -> float:
    return float(np.sum(np.square(a[:2] - b[:2])))


@given(POINTS, POINTS)
def test_no_exchange_of_two_places_shortens_the_squared_ways(positions: Array, places: Array) -> None:
    ends = places[least_travel(positions, places)]
    for i, j in combinations(range(len(ends)), 2):
        dealt = horizontal2(positions[i], ends[i]) + horizontal2(positions[j], ends[j])
        exchanged = horizontal2(positions[i], ends[j]) + horizontal2(positions[j], ends[i])
        # Heights weigh a thousandth.
        assert dealt <= exchanged + 0.008 + 1e-9


@given(POINTS, POINTS)
def test_every_place_is_taken_once(positions: Array, places: Array) -> None:
    assert sorted(least_travel(positions, places).tolist()) == list(range(len(places)))


@given(POINTS, COUNT.flatmap(lambda n: st.permutations(range(n))))
def test_identical_drones_never_swap(positions: Array, order: list[int]) -> None:
    ends = positions[order][least_travel(positions, positions[order])]
    assert np.allclose(ends, positions)


@given(POINTS, POINTS)
def test_no_two_pass_each_other_however_fast_they_fly_together(positions: Array, places: Array) -> None:
    """Flown at the same share of their ways, two come no nearer than 0.7 of what they keep at their ends."""
    positions[:, 2] = places[:, 2] = 1.5
    ends = places[least_travel(positions, places)]
    for i, j in combinations(range(len(ends)), 2):
        before, after = (positions[i] - positions[j])[:2], (ends[i] - ends[j])[:2]
        least = min(math.hypot(*(before + share * (after - before))) for share in np.linspace(0.0, 1.0, 51))
        assert least >= math.sqrt(0.5) * min(math.hypot(*before), math.hypot(*after)) - 1e-6


def test_drones_in_a_row_move_up_one_place_and_none_flies_over_the_next() -> None:
    row = np.array([[0.0, 0.0, 1.5], [1.0, 0.0, 1.5], [2.0, 0.0, 1.5]])
    moved = row + np.array([1.0, 0.1, 0.0])
    assert least_travel(row, moved).tolist() == [0, 1, 2]
    assert least_travel(row, moved[::-1]).tolist() == [2, 1, 0]


def test_drones_above_each_other_do_not_swap() -> None:
    tower = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 2.0]])
    assert least_travel(tower, tower[::-1]).tolist() == [1, 0]
