"""The paper's quality model: the table of the real lens, the direction trap, visibility, fusion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig import sensing
from camrig.geometry.lens import BrownLens, FisheyeLens

LAB = BrownLens(
    size_px=(1280, 800), focal_px=(827.6785, 827.8561), centre_px=(640.0, 400.0), distortion=(-0.335814, 0.101432, 0, 0)
)
PINHOLE = BrownLens(size_px=(1280, 800), focal_px=(800.0, 800.0), centre_px=(640.0, 400.0))
TANGENTIAL = BrownLens((1280, 800), (800.0, 790.0), (640.0, 400.0), (-0.3, 0.1, 0.002, -0.003, 0.01))


def point(a: float, b: float, depth_m: float = 2.0) -> np.ndarray:
    return np.array([a * depth_m, b * depth_m, depth_m])


@pytest.mark.parametrize(
    ("r", "axis", "diagonal", "inverse_det"),
    [
        (0.4, 1.2373, 1.2409, 1.2373),
        (0.6, 1.5941, 1.6169, 1.5941),
        (0.7732, 2.0673, 2.1376, 2.0673),
        (1.0, 2.6138, 2.7345, 2.6138),
    ],
)
def test_distortion_term_equals_the_reference_table(r: float, axis: float, diagonal: float, inverse_det: float) -> None:
    ideal = np.array([[r, 0.0], [0.0, r], [r / math.sqrt(2.0), r / math.sqrt(2.0)]])
    np.testing.assert_allclose(sensing.q_d(LAB, ideal), [axis, axis, diagonal], atol=6e-5)
    assert 1.0 / np.linalg.det(LAB.jacobian(ideal[0])) == pytest.approx(inverse_det, abs=6e-5)


def test_distortion_term_is_the_product_of_the_inverse_maps_partials() -> None:
    step = 1e-5
    for lens in (LAB, TANGENTIAL, FisheyeLens((1280, 800), (400.0, 400.0), (640.0, 400.0), (0.05, -0.01, 0.0, 0.0))):
        ideal = np.array([0.45, -0.3])
        sensor = lens.distort(ideal)
        right, below = step * np.eye(2)
        across = lens.undistort(sensor + right) - lens.undistort(sensor - right)
        down = lens.undistort(sensor + below) - lens.undistort(sensor - below)
        expected = across[0] / (2 * step) * down[1] / (2 * step)
        assert sensing.q_d(lens, ideal) == pytest.approx(expected, rel=1e-6)


def test_a_squeezing_lens_never_rewards_the_edge_of_its_image() -> None:
    radii = np.linspace(0.0, 1.0, 50)
    along = sensing.q_d(LAB, np.stack([radii, np.zeros(50)], axis=-1))
    assert (np.diff(along) > 0.0).all()
    assert along[0] == 1.0


def test_quality_is_metres_per_pixel_at_the_targets_depth() -> None:
    assert sensing.pixel_quality(PINHOLE, point(0.5, 0.2, 3.0)) == pytest.approx(3.0 / 800.0)
    assert sensing.pixel_quality(LAB, point(0.0, 0.0, 3.0)) == pytest.approx(3.0 / math.sqrt(827.6785 * 827.8561))
    assert sensing.pixel_quality(LAB, np.array([0.1, 0.1, -1.0])) == np.inf


@given(st.floats(-0.9, 0.9), st.floats(-0.5, 0.5), st.floats(0.5, 5.0), st.floats(0.1, 10.0))
def test_quality_scales_with_depth_and_is_even_in_both_axes(a: float, b: float, depth_m: float, scale: float) -> None:
    here = sensing.pixel_quality(LAB, point(a, b, depth_m))
    assert sensing.pixel_quality(LAB, point(a, b, depth_m) * scale) == pytest.approx(here * scale, rel=1e-9)
    mirrored = np.stack([point(-a, b, depth_m), point(a, -b, depth_m), point(-a, -b, depth_m)])
    np.testing.assert_allclose(sensing.pixel_quality(LAB, mirrored), here, rtol=1e-9)


@given(st.lists(st.floats(1e-4, 1e-1), min_size=1, max_size=6), st.floats(1e-4, 1e-1))
def test_another_camera_never_hurts(qualities: list[float], added: float) -> None:
    gain = 1.0 / np.array(qualities)[:, None]
    fused = sensing.fused(gain)[0]
    with_another = sensing.fused(np.vstack([gain, [[1.0 / added]]]))[0]
    assert with_another < fused <= min(qualities) * (1 + 1e-12)
    assert sensing.fused(np.vstack([gain, [[0.0]]]))[0] == fused


def test_nothing_seen_is_infinite() -> None:
    assert sensing.fused(np.zeros((3, 1)))[0] == np.inf


def test_the_real_lens_has_the_known_fields_of_view() -> None:
    assert math.degrees(sensing.half_angle(LAB)) == pytest.approx(37.71, abs=0.01)
    for direction, expected_deg in (((1, 0), 45.43), ((0, 1), 27.86), ((640 / 400, 1.0), 51.61)):
        unit = np.array(direction) / np.hypot(*direction)
        # The corner of the image lies on the diagonal of the *sensor*; a radial lens keeps directions.
        angles = np.radians(np.linspace(20.0, 54.0, 34001))
        inside = sensing.in_image(LAB, np.stack([*(unit[:, None] * np.sin(angles)), np.cos(angles)], axis=-1))
        assert math.degrees(angles[inside].max()) == pytest.approx(expected_deg, abs=0.02)


def test_a_target_on_the_edge_of_the_cone_is_seen_and_the_margin_shrinks_it() -> None:
    alpha = sensing.half_angle(LAB)
    on_edge = np.array([math.sin(alpha), 0.0, math.cos(alpha)])
    beyond = np.array([math.sin(alpha + 1e-7), 0.0, math.cos(alpha + 1e-7)])
    assert sensing.in_cone(LAB, on_edge, alpha)
    assert not sensing.in_cone(LAB, beyond, alpha)
    assert not sensing.in_cone(LAB, on_edge, alpha, margin_rad=0.01)
    assert not sensing.in_cone(LAB, -on_edge, alpha)


def test_nothing_beyond_r_max_is_visible() -> None:
    short = BrownLens((1280, 800), (400.0, 400.0), (640.0, 400.0), r_max=0.5)
    inside, outside = point(0.49, 0.0), point(0.51, 0.0)
    assert sensing.in_image(short, inside)
    assert not sensing.in_image(short, outside)
    assert sensing.in_cone(short, inside, 1.2)
    assert not sensing.in_cone(short, outside, 1.2)
    assert sensing.in_image(PINHOLE, point(0.79, 0.0))


@pytest.mark.parametrize("lens", [LAB, PINHOLE, TANGENTIAL])
@pytest.mark.parametrize("pixel", [(1279.0, 400.0), (640.0, 1.0), (900.0, 799.0), (2.0, 700.0)])
def test_the_image_margin_is_the_angle_to_the_edge(lens: BrownLens, pixel: tuple[float, float]) -> None:
    ideal = lens.unproject(np.array(pixel))
    towards = np.append(ideal, 1.0) / math.sqrt(1.0 + float(ideal @ ideal))
    rays = towards + 0.001 * np.random.default_rng(1).normal(size=(4000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angles = np.arccos(np.clip(rays @ towards, -1.0, 1.0))
    nearest_outside = angles[~sensing.in_image(lens, rays)].min()
    assert sensing.in_image(lens, towards, nearest_outside * 0.95)
    assert not sensing.in_image(lens, towards, nearest_outside * 1.05)


def test_far_outside_a_polynomial_lens_folds_back_and_must_not_be_seen() -> None:
    folding = BrownLens((1280, 800), (827.0, 827.0), (640.0, 400.0), (-0.5, 0.1, 0, 0))
    radii = np.linspace(0.0, 60.0, 6001)
    seen = sensing.in_image(folding, np.stack([radii, np.zeros_like(radii), np.ones_like(radii)], axis=-1))
    assert radii[seen].max() <= folding.r_max


def test_tag_corners_lie_round_the_centre_in_apriltags_order() -> None:
    centre = np.array([1.0, 2.0, 0.1])
    corners = sensing.tag_corners(centre, np.array([0.0, 0.0, 2.0]), 0.0, 0.2)
    expected = centre + 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    np.testing.assert_allclose(corners, expected, atol=1e-12)
    turned = sensing.tag_corners(centre, np.array([0.0, 0.0, 1.0]), math.pi / 2, 0.2)
    np.testing.assert_allclose(turned[0], centre + np.array([0.1, -0.1, 0.0]), atol=1e-12)
    on_wall = sensing.tag_corners(centre, np.array([1.0, 0.0, 0.0]), 0.3, 0.2)
    np.testing.assert_allclose(on_wall[:, 0], 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(on_wall - centre, axis=1), 0.1 * math.sqrt(2.0))


def test_tag_side_is_the_narrow_one() -> None:
    corners = np.array([[-0.1, -0.1, 2.0], [0.1, -0.1, 2.0], [0.1, 0.1, 2.0], [-0.1, 0.1, 2.0]])
    assert sensing.tag_side_px(PINHOLE, corners) == pytest.approx(80.0)
    squeezed = corners * [0.5, 1.0, 1.0]
    assert sensing.tag_side_px(PINHOLE, squeezed) == pytest.approx(40.0)
    assert np.isnan(sensing.tag_side_px(PINHOLE, corners * [1, 1, -1]))
