"""What a camera sees: the paper's cone, the true image rectangle, their margins, and where a lens ends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, Lens
from camrig.geometry.lens_row import half_angle, lens_row
from camrig.optimise.kernels.problem import Flags
from camrig.sensing.view import cone_clearance, image_clearance, in_cone, in_image
from tests.lenses import ALL, LAB, TANGENTIAL

PINHOLE = BrownLens(size_px=(1280, 800), focal_px=(800.0, 800.0), centre_px=(640.0, 400.0))


def point(a: float, b: float, depth_m: float = 2.0) -> Array:
    return np.array([a * depth_m, b * depth_m, depth_m])


def image_holds(lens: Lens, points: Array, margin_rad: float = 0.0) -> Flags:
    """in_image for (..., 3) points."""
    row = lens_row(lens)
    flat = [in_image(row, float(x), float(y), float(z), margin_rad) for x, y, z in points.reshape(-1, 3)]
    return np.array(flat).reshape(points.shape[:-1])


def cone_holds(lens: Lens, at: Array, alpha_rad: float, margin_rad: float = 0.0) -> bool:
    return in_cone(lens_row(lens, alpha_rad), float(at[0]), float(at[1]), float(at[2]), margin_rad)


def test_the_real_lens_has_the_known_fields_of_view() -> None:
    assert math.degrees(half_angle(LAB)) == pytest.approx(37.71, abs=0.01)
    for direction, expected_deg in (((1, 0), 45.43), ((0, 1), 27.86), ((640 / 400, 1.0), 51.61)):
        unit = np.array(direction) / np.hypot(*direction)
        # The corner of the image lies on the diagonal of the *sensor*; a radial lens keeps directions.
        angles = np.radians(np.linspace(20.0, 54.0, 34001))
        inside = image_holds(LAB, np.stack([*(unit[:, None] * np.sin(angles)), np.cos(angles)], axis=-1))
        assert math.degrees(angles[inside].max()) == pytest.approx(expected_deg, abs=0.02)


def test_the_cone_leaves_the_true_rectangle_above_and_below_and_misses_its_corners() -> None:
    alpha = half_angle(LAB)
    above = np.array([0.0, -math.sin(alpha - 0.01), math.cos(alpha - 0.01)])
    assert cone_holds(LAB, above, alpha)
    assert not image_holds(LAB, above)
    corner = np.append(LAB.unproject(np.array([1279.0, 799.0])), 1.0)
    assert image_holds(LAB, corner)
    assert not cone_holds(LAB, corner, alpha)


def test_a_target_on_the_edge_of_the_cone_is_seen_and_the_margin_shrinks_it() -> None:
    alpha = half_angle(LAB)
    on_edge = np.array([math.sin(alpha), 0.0, math.cos(alpha)])
    beyond = np.array([math.sin(alpha + 1e-7), 0.0, math.cos(alpha + 1e-7)])
    assert cone_holds(LAB, on_edge, alpha)
    assert not cone_holds(LAB, beyond, alpha)
    assert not cone_holds(LAB, on_edge, alpha, margin_rad=0.01)
    assert not cone_holds(LAB, -on_edge, alpha)


def test_nothing_beyond_r_max_is_visible() -> None:
    short = BrownLens((1280, 800), (400.0, 400.0), (640.0, 400.0), r_max=0.5)
    inside, outside = point(0.49, 0.0), point(0.51, 0.0)
    assert image_holds(short, inside)
    assert not image_holds(short, outside)
    assert cone_holds(short, inside, 1.2)
    assert not cone_holds(short, outside, 1.2)
    assert image_holds(PINHOLE, point(0.79, 0.0))


@pytest.mark.parametrize("lens", [LAB, PINHOLE, TANGENTIAL])
@pytest.mark.parametrize("pixel", [(1279.0, 400.0), (640.0, 1.0), (900.0, 799.0), (2.0, 700.0)])
def test_the_image_margin_is_the_angle_to_the_edge(lens: BrownLens, pixel: tuple[float, float]) -> None:
    ideal = lens.unproject(np.array(pixel))
    towards = np.append(ideal, 1.0) / math.sqrt(1.0 + float(ideal @ ideal))
    rays = towards + 0.001 * np.random.default_rng(1).normal(size=(4000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angles = np.arccos(np.clip(rays @ towards, -1.0, 1.0))
    nearest_outside = angles[~image_holds(lens, rays)].min()
    assert image_holds(lens, towards, nearest_outside * 0.95)
    assert not image_holds(lens, towards, nearest_outside * 1.05)


def test_the_image_margin_is_an_angle_at_r_max_too() -> None:
    short = replace(PINHOLE, r_max=0.5)
    rim, margin_rad = math.atan(0.5), 0.02
    for off, seen in ((margin_rad + 1e-6, True), (margin_rad - 1e-6, False)):
        assert image_holds(short, np.array([math.sin(rim - off), 0.0, math.cos(rim - off)]), margin_rad) == seen


def test_far_outside_a_polynomial_lens_folds_back_and_must_not_be_seen() -> None:
    folding = BrownLens((1280, 800), (827.0, 827.0), (640.0, 400.0), (-0.5, 0.1, 0, 0))
    radii = np.linspace(0.0, 60.0, 6001)
    seen = image_holds(folding, np.stack([radii, np.zeros_like(radii), np.ones_like(radii)], axis=-1))
    assert radii[seen].max() <= folding.r_max


@pytest.mark.parametrize("name", ALL)
@settings(deadline=None)
@given(st.floats(0.0, 1.2), st.floats(0.0, 2.0 * math.pi), st.floats(0.1, 5.0))
def test_what_is_in_the_image_is_what_the_lens_projects_there(
    name: str, share: float, angle: float, depth_m: float
) -> None:
    lens = ALL[name]
    radius = share * lens.r_max
    at = depth_m * np.array([radius * math.cos(angle), radius * math.sin(angle), 1.0])
    pixel, size = lens.project(at), np.array(lens.size_px)
    inside = np.minimum(pixel, size - pixel).min()  # NaN past r_max
    if not abs(inside) < 1e-5 and abs(share - 1.0) > 1e-8:  # beside the slack
        assert image_holds(lens, at) == bool(inside > 0.0)
    assert not image_holds(lens, -at)


@pytest.mark.parametrize("name", ALL)
@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 2.0 * math.pi), st.floats(0.0, 0.2), st.floats(1e-3, 0.1))
def test_a_wider_margin_never_shows_more(name: str, share: float, angle: float, margin: float, more: float) -> None:
    lens = ALL[name]
    radius = share * lens.r_max
    x, y = radius * math.cos(angle), radius * math.sin(angle)
    row = lens_row(lens)
    assert cone_clearance(row, x, y, 1.0, margin + more) < cone_clearance(row, x, y, 1.0, margin)
    for wide, narrow in zip(
        image_clearance(row, x, y, 1.0, margin), image_clearance(row, x, y, 1.0, margin + more), strict=True
    ):
        assert narrow < wide


def test_behind_a_camera_every_clearance_is_hopeless() -> None:
    assert set(image_clearance(lens_row(LAB), 0.1, 0.1, -1.0, 0.0)) == {-math.inf}
    assert cone_clearance(lens_row(LAB), 0.0, 0.0, -1.0, 0.0) < -math.pi / 2.0
