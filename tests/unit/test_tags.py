"""Corners of square tags in the world."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from camrig.geometry.tags import tag_corners


def test_tag_corners_lie_round_the_centre_in_apriltags_order() -> None:
    centre = np.array([1.0, 2.0, 0.1])
    corners = tag_corners(centre, np.array([0.0, 0.0, 2.0]), 0.0, 0.2)
    expected = centre + 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    np.testing.assert_allclose(corners, expected, atol=1e-12)
    turned = tag_corners(centre, np.array([0.0, 0.0, 1.0]), math.pi / 2, 0.2)
    np.testing.assert_allclose(turned[0], centre + np.array([0.1, -0.1, 0.0]), atol=1e-12)
    on_wall = tag_corners(centre, np.array([1.0, 0.0, 0.0]), 0.3, 0.2)
    np.testing.assert_allclose(on_wall[:, 0], 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(on_wall - centre, axis=1), 0.1 * math.sqrt(2.0))


COORDINATE = st.floats(-1.0, 1.0)


@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.floats(-4.0, 4.0), st.floats(0.01, 1.0))
def test_any_tag_is_a_square_about_its_centre_turned_by_the_right_hand_rule(
    normal: tuple[float, float, float], facing_rad: float, size_m: float
) -> None:
    up, centre = np.array(normal), np.array([0.3, -0.2, 0.7])
    length = np.linalg.norm(up)
    assume(length > 0.1)
    up /= length
    corners = tag_corners(centre, np.array(normal), facing_rad, size_m)
    np.testing.assert_allclose(corners.mean(axis=0), centre, atol=1e-12)
    x, y = corners[1] - corners[0], corners[3] - corners[0]
    np.testing.assert_allclose(corners[2], corners[1] + y, atol=1e-12)
    np.testing.assert_allclose([np.linalg.norm(x), np.linalg.norm(y), x @ y], [size_m, size_m, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.cross(x, y) / size_m**2, up, atol=1e-12)
    unturned = tag_corners(centre, np.array(normal), 0.0, size_m)
    x0 = unturned[1] - unturned[0]
    np.testing.assert_allclose(x, math.cos(facing_rad) * x0 + math.sin(facing_rad) * np.cross(up, x0), atol=1e-12)


def test_many_tags_at_once_are_the_same_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    places, normals = rng.uniform(-1.0, 1.0, (5, 3)), rng.uniform(-1.0, 1.0, (5, 3))
    facing_rad, sizes = rng.uniform(-3.0, 3.0, 5), rng.uniform(0.1, 1.0, 5)
    together = tag_corners(places, normals, facing_rad, sizes)
    for k in range(5):
        one = tag_corners(places[k], normals[k], float(facing_rad[k]), float(sizes[k]))
        np.testing.assert_allclose(together[k], one, atol=1e-14)
