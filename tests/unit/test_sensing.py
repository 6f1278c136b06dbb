"""The paper's quality model: the table of the real lens, the direction trap, fusion; its kernels and their slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camrig import sensing
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.lens_row import half_angle, lens_row
from camrig.sensing.point import (
    perspective_gain,
    perspective_gain_slopes,
    pixel_gain,
    pixel_gain_slopes,
)
from tests.lenses import ALL, ideal_points, in_space

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


def q_d_of_kernel(lens: Lens, ideal: Array) -> Array:
    """What the kernel's gain makes of the distortion: f / (Z gain)."""
    fx, fy = lens.focal_px
    row = lens_row(lens)
    return np.array([math.sqrt(fx * fy) / (2.0 * pixel_gain(row, 2.0 * a, 2.0 * b, 2.0)) for a, b in ideal])


@pytest.mark.parametrize(
    ("r", "axis", "diagonal"),
    [(0.4, 1.2373, 1.2409), (0.6, 1.5941, 1.6169), (0.7732, 2.0673, 2.1376), (1.0, 2.6138, 2.7345)],
)
def test_the_kernel_holds_the_reference_table_in_units_of_tan_beta(r: float, axis: float, diagonal: float) -> None:
    ideal = np.array([[r, 0.0], [0.0, r], [r / math.sqrt(2.0), -r / math.sqrt(2.0)]])
    found = q_d_of_kernel(LAB, ideal)
    np.testing.assert_allclose(found, [axis, axis, diagonal], atol=6e-5)
    # The wrong way round (J's own diagonal) is below 1, and coefficients over tan(alpha) give another number.
    J = LAB.jacobian(ideal)
    assert (J[:, 0, 0] * J[:, 1, 1] < 1.0).all()
    scaled = q_d_of_kernel(LAB, ideal / math.tan(half_angle(LAB)))
    assert (np.abs(scaled - found) > 0.1).all()


def test_past_r_1_the_term_falls_again_so_one_to_one_is_no_protection() -> None:
    radii = np.array([1.0, 1.4])
    ideal = np.stack([radii, np.zeros(2)], axis=-1)
    assert LAB.r_max == math.sqrt(2.0)  # one-to-one all the way
    np.testing.assert_allclose(q_d_of_kernel(LAB, ideal), [2.61, 1.40], atol=5e-3)


@pytest.mark.parametrize("name", ALL)
def test_the_kernels_gain_is_one_over_the_papers_quality(name: str) -> None:
    lens = ALL[name]
    points = in_space(0.95 * ideal_points(lens, seed=6))
    row = lens_row(lens)
    gains = [pixel_gain(row, *point) for point in points]
    np.testing.assert_allclose(gains, 1.0 / sensing.pixel_quality(lens, points), rtol=1e-10)


def test_the_perspective_gain_knows_distance_and_angle_alone() -> None:
    row, straight = lens_row(LAB), lens_row(BrownLens(LAB.size_px, LAB.focal_px, LAB.centre_px))
    f = math.sqrt(827.6785 * 827.8561)
    assert perspective_gain(row, 0.0, 0.0, 3.0) == pytest.approx(f / 3.0)
    assert perspective_gain(row, 3.0, 0.0, 3.0) == pytest.approx(f * math.cos(math.pi / 4.0) / (3.0 * math.sqrt(2.0)))
    assert perspective_gain(row, 1.0, -0.4, 2.0) == perspective_gain(straight, 1.0, -0.4, 2.0)


@pytest.mark.parametrize("name", ALL)
@settings(deadline=None, max_examples=50)
@given(st.floats(0.0, 0.9), st.floats(0.0, 2.0 * math.pi), st.floats(0.2, 6.0))
def test_gains_have_the_slopes_they_say(name: str, share: float, angle: float, depth_m: float) -> None:
    lens = ALL[name]
    radius = share * min(lens.r_max, 2.5)
    row, point_ = lens_row(lens), depth_m * np.array([radius * math.cos(angle), radius * math.sin(angle), 1.0])
    assume(pixel_gain(row, *point_) > 1e-3)
    for gain, slopes in ((pixel_gain, pixel_gain_slopes), (perspective_gain, perspective_gain_slopes)):
        value, *by = slopes(row, *point_)
        assert value == pytest.approx(gain(row, *point_), rel=1e-12)
        step = 1e-5 * depth_m
        expected = [
            (gain(row, *(point_ + step * axis)) - gain(row, *(point_ - step * axis))) / (2.0 * step)
            for axis in np.eye(3)
        ]
        # Differences err by (step / depth)^2 of a third derivative: against the gradient's own length.
        scale = float(np.linalg.norm(expected))
        np.testing.assert_allclose(by, expected, rtol=0.0, atol=2e-6 * scale)
