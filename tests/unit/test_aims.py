"""Directions worth a look: to every target, with two of them on the edge of view, to clusters, to a grid."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry.arrays import Array
from camrig.optimise.kernels.aims import directions_worth_a_look, grid_directions, pairs_of

EYE = np.array([1.0, 1.5, 2.7])
NO_EDGES = np.zeros(0)


def unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def test_pairs_are_each_two_things_once() -> None:
    first, second = pairs_of(5)
    assert {(int(a), int(b)) for a, b in zip(first, second, strict=True)} == {
        (a, b) for a in range(5) for b in range(a + 1, 5)
    }
    assert len(pairs_of(1)[0]) == len(pairs_of(0)[0]) == 0


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.floats(0.1, 1.2))
def test_two_targets_are_on_the_edge_of_view_wherever_they_fit_into_it(seed: int, count: int, edge_rad: float) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform((0.0, 0.0), (5.0, 3.0), (count, 2)), np.zeros(count)])
    first, second = pairs_of(count)
    plain = directions_worth_a_look(points, EYE, NO_EDGES, first, second, 8, 4)
    found = directions_worth_a_look(points, EYE, np.array([edge_rad]), first, second, 8, 4)
    added = unit(found[count : len(found) - len(plain) + count])
    rays = unit(points - EYE)
    np.testing.assert_allclose(found[:count], rays, atol=1e-12)
    at = 0
    for a, b in zip(rays[first], rays[second], strict=True):
        if math.acos(min(a @ b, 1.0)) / 2.0 < edge_rad:
            for axis in added[at : at + 2]:
                np.testing.assert_allclose(np.arccos([axis @ a, axis @ b]), edge_rad, atol=1e-6)
                assert min(axis @ a, axis @ b) >= math.cos(edge_rad)
            at += 2
    assert at == len(added)


def test_a_cluster_of_targets_is_looked_at_in_its_middle() -> None:
    near = np.array([[4.0, 1.0, 0.0], [4.2, 1.0, 0.0], [4.1, 1.2, 0.0]])
    far = np.array([[0.0, 2.9, 0.0]])
    none = np.zeros(0, dtype=np.int64)
    found = unit(directions_worth_a_look(np.concatenate([near, far]), EYE, NO_EDGES, none, none, 16, 3))
    rays = unit(near - EYE)
    middle = unit((rays.min(axis=0) + rays.max(axis=0)) / 2.0)
    assert (np.abs(found - middle).max(axis=1) < 1e-9).any()


def test_a_grid_reaches_a_quarter_beyond_what_there_is_to_see() -> None:
    points = np.array([[0.0, 0.0, 0.0], [4.0, 2.0, 0.2]])
    ends = grid_directions(points, EYE, 5) + EYE
    np.testing.assert_allclose(ends.min(axis=0), [-1.0, -0.5, 0.1])
    np.testing.assert_allclose(ends.max(axis=0), [5.0, 2.5, 0.1])
    assert len(np.unique(ends.round(9), axis=0)) == 25
