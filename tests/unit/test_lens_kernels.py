"""A lens as a row of numbers: the kernels compute what the lens does, which is what OpenCV does; second derivatives."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.lens.brown import brown_curvatures, brown_slopes
from camrig.geometry.lens.fisheye import fisheye_curvatures, fisheye_slopes
from camrig.geometry.lens_row import curvatures_at, half_angle, lens_row, pixel_at, sensor_at, slopes_at
from tests.lenses import ALL, FISHEYE, LAB, ideal_points, in_space, opencv_camera

STEP = 1e-5
"""Of central differences: their error is about STEP^2 times a fourth derivative, and 1e-16 / STEP by rounding."""


def slopes(lens: Lens, ideal: Array) -> Array:
    J = lens.jacobian(ideal)
    return np.stack([J[..., 0, 0], J[..., 0, 1], J[..., 1, 0], J[..., 1, 1]], axis=-1)


def curvatures(lens: Lens, ideal: Array) -> Array:
    """(..., 6): the second derivatives of u by aa, ab, bb, then those of v."""
    row = lens_row(lens)
    return np.array([curvatures_at(row, float(a), float(b)) for a, b in ideal])


def differenced(lens: Lens, ideal: Array) -> Array:
    """The same, from central differences of the first derivatives."""
    by_a, by_b = ((slopes(lens, ideal + step) - slopes(lens, ideal - step)) / (2.0 * STEP) for step in STEP * np.eye(2))
    return np.stack([by_a[:, 0], by_a[:, 1], by_b[:, 1], by_a[:, 2], by_a[:, 3], by_b[:, 3]], axis=-1)


@pytest.mark.parametrize("name", ALL)
def test_second_derivatives_are_those_of_the_first(name: str) -> None:
    lens = ALL[name]
    ideal = np.concatenate([0.98 * ideal_points(lens, seed=3), [[0.0, 0.0], [1e-9, 0.0], [0.019, 0.003], [0.021, 0.0]]])
    # The scale of an entry is what the largest at that radius is; the fisheye's series within 0.02 drops O(r^3).
    np.testing.assert_allclose(curvatures(lens, ideal), differenced(lens, ideal), rtol=2e-5, atol=2e-5)


@settings(deadline=None)
@given(
    st.tuples(*[st.floats(-0.3, 0.3)] * 3, *[st.floats(-0.3, 0.3)] * 3),
    st.tuples(*[st.floats(-0.01, 0.01)] * 6),
    st.floats(-0.7, 0.7),
    st.floats(-0.7, 0.7),
)
def test_any_brown_lens_has_the_second_derivatives_of_its_first(
    radial: tuple[float, ...], other: tuple[float, ...], a: float, b: float
) -> None:
    k = np.array([radial[0], radial[1], other[0], other[1], radial[2], *radial[3:], *other[2:]])
    found = brown_curvatures(k, a, b)
    by_a = (np.array(brown_slopes(k, a + STEP, b)) - brown_slopes(k, a - STEP, b)) / (2.0 * STEP)
    by_b = (np.array(brown_slopes(k, a, b + STEP)) - brown_slopes(k, a, b - STEP)) / (2.0 * STEP)
    expected = [by_a[0], by_a[1], by_b[1], by_a[2], by_a[3], by_b[3]]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    # A mixed derivative is one, whichever way round.
    np.testing.assert_allclose(by_b[[0, 2]], by_a[[1, 3]], rtol=1e-6, atol=1e-7)


@settings(deadline=None)
@given(st.tuples(*[st.floats(-0.05, 0.05)] * 4), st.floats(0.0, 5.0), st.floats(0.0, 2.0 * math.pi))
def test_any_fisheye_has_the_second_derivatives_of_its_first(
    coefficients: tuple[float, ...], radius: float, angle: float
) -> None:
    k, a, b = np.array(coefficients), radius * math.cos(angle), radius * math.sin(angle)
    found = fisheye_curvatures(k, a, b)
    by_a = (np.array(fisheye_slopes(k, a + STEP, b)) - fisheye_slopes(k, a - STEP, b)) / (2.0 * STEP)
    by_b = (np.array(fisheye_slopes(k, a, b + STEP)) - fisheye_slopes(k, a, b - STEP)) / (2.0 * STEP)
    # Near the axis the slopes' own quotients lose digits (1e-16 / r^2), and differences of them STEP more.
    expected = [by_a[0], by_a[1], by_b[1], by_a[2], by_a[3], by_b[3]]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=5e-5)


@pytest.mark.parametrize("name", ALL)
def test_the_kernels_compute_what_the_lens_does(name: str) -> None:
    lens = ALL[name]
    row, ideal = lens_row(lens), ideal_points(lens, seed=4)
    # The same formula, compiled: only the order of roundings may differ.
    np.testing.assert_allclose([sensor_at(row, a, b) for a, b in ideal], lens.distort(ideal), rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose([slopes_at(row, a, b) for a, b in ideal], slopes(lens, ideal), rtol=1e-11, atol=1e-12)
    points = in_space(ideal)
    np.testing.assert_allclose([pixel_at(row, *point) for point in points], lens.project(points), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ALL)
def test_the_kernels_compute_what_opencv_does(name: str) -> None:
    lens = ALL[name]
    points = in_space(ideal_points(lens, seed=5))
    camera, none = opencv_camera(lens), np.zeros(3)
    if isinstance(lens, FisheyeLens):
        expected, jacobian = cv2.fisheye.projectPoints(points[:, None], none, none, camera, np.array(lens.distortion))
        by_translation = jacobian[:, 11:14]
    else:
        assert isinstance(lens, BrownLens)
        expected, jacobian = cv2.projectPoints(points, none, none, camera, np.array(lens.distortion))
        by_translation = jacobian[:, 3:6]
    row = lens_row(lens)
    np.testing.assert_allclose([pixel_at(row, *point) for point in points], expected.reshape(-1, 2), rtol=0, atol=1e-8)
    # d pixel / d (x, y) of a point at depth z is f J / z.
    (fx, fy), z = lens.focal_px, points[:, 2]
    J = np.array([slopes_at(row, a, b) for a, b in points[:, :2] / z[:, None]])
    found = J / z[:, None] * [fx, fx, fy, fy]
    theirs = by_translation.reshape(-1, 2, 3)[:, :, :2].reshape(-1, 4)
    np.testing.assert_allclose(found, theirs, rtol=1e-7, atol=1e-6)


def test_the_half_angle_is_the_papers() -> None:
    assert math.degrees(half_angle(LAB)) == pytest.approx(37.71, abs=0.01)
    assert half_angle(LAB) == math.atan(1280.0 / (2.0 * math.sqrt(827.6785 * 827.8561)))


def test_far_past_r_max_a_pixel_stays_in_its_direction_and_finite() -> None:
    for lens in ALL.values():
        row = lens_row(lens)
        far = np.array(
            [
                pixel_at(row, 100.0 * lens.r_max * math.cos(t), 100.0 * lens.r_max * math.sin(t), 1.0)
                for t in np.linspace(0.0, 6.0, 13)
            ]
        )
        rim = np.array(
            [
                pixel_at(row, 2.0 * lens.r_max * math.cos(t), 2.0 * lens.r_max * math.sin(t), 1.0)
                for t in np.linspace(0.0, 6.0, 13)
            ]
        )
        np.testing.assert_allclose(far, rim, rtol=1e-9)


def test_a_lens_that_the_kernels_do_not_know_is_refused_by_its_name() -> None:
    class Pinhole:
        size_px, focal_px, centre_px, r_max = (640, 480), (500.0, 500.0), (320.0, 240.0), 1.0

    with pytest.raises(InputError, match="Pinhole"):
        lens_row(Pinhole())  # type: ignore[arg-type]


def test_a_given_half_angle_replaces_the_lenss_own() -> None:
    assert (lens_row(FISHEYE, 0.3) != lens_row(FISHEYE)).sum() <= 2  # the angle, and its tangent if that is kept
