"""Lenses against OpenCV, both directions; the analytic Jacobian; what ``r_max`` means."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.errors import InputError
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.lens.pinhole import R_MAX_DEFAULT
from tests.lenses import ALL, BARREL, BROWN, FISHEYE, LAB, STRAIGHT, ideal_points, in_space, opencv_camera


@pytest.mark.parametrize("name", BROWN)
def test_brown_projects_as_opencv_does(name: str) -> None:
    lens = BROWN[name]
    points = in_space(ideal_points(lens))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), opencv_camera(lens), np.asarray(lens.distortion, dtype=float)
    )
    assert lens.project(points) == pytest.approx(expected[:, 0], abs=1e-8)


def test_fisheye_projects_as_opencv_does() -> None:
    points = in_space(ideal_points(FISHEYE))
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), opencv_camera(FISHEYE), np.array(FISHEYE.distortion)
    )
    assert FISHEYE.project(points) == pytest.approx(expected[:, 0], abs=1e-8)


@pytest.mark.parametrize("name", ["lab", "tangential", "prism"])
def test_brown_unprojects_as_opencv_does(name: str) -> None:
    lens = BROWN[name]
    pixels = lens.project(in_space(0.6 * ideal_points(lens)))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    expected = cv2.undistortPoints(
        pixels[:, None], opencv_camera(lens), np.asarray(lens.distortion, dtype=float), criteria=criteria
    )
    assert lens.unproject(pixels) == pytest.approx(expected[:, 0], abs=1e-8)


def test_fisheye_unprojects_as_opencv_does() -> None:
    pixels = FISHEYE.project(in_space(0.3 * ideal_points(FISHEYE)))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    expected = cv2.fisheye.undistortPoints(
        pixels[:, None], opencv_camera(FISHEYE), np.array(FISHEYE.distortion), criteria=criteria
    )
    assert FISHEYE.unproject(pixels) == pytest.approx(expected[:, 0], abs=1e-8)


@pytest.mark.parametrize("name", ALL)
def test_undistort_undoes_distort_over_the_whole_disc(name: str) -> None:
    lens = ALL[name]
    ideal = ideal_points(lens, seed=1)
    assert lens.undistort(lens.distort(ideal)) == pytest.approx(ideal, abs=1e-8)


@pytest.mark.parametrize("name", ALL)
def test_jacobian_is_the_derivative(name: str) -> None:
    lens, step = ALL[name], 1e-6
    ideal = np.concatenate([ideal_points(lens, seed=2), [[0.0, 0.0], [1e-9, 0.0], [1e-5, -1e-5]]])
    for axis in range(2):
        delta = step * np.eye(2)[axis]
        slope = (lens.distort(ideal + delta) - lens.distort(ideal - delta)) / (2.0 * step)
        assert lens.jacobian(ideal)[..., axis] == pytest.approx(slope, abs=1e-7)


def test_leading_axes_are_kept() -> None:
    ideal = ideal_points(LAB, 24).reshape(2, 3, 4, 2)
    assert LAB.jacobian(ideal).shape == (2, 3, 4, 2, 2)
    assert LAB.undistort(LAB.distort(ideal)) == pytest.approx(ideal, abs=1e-9)
    assert LAB.undistort(LAB.distort(ideal[0, 0, 0])) == pytest.approx(ideal[0, 0, 0], abs=1e-9)
    assert LAB.undistort(np.empty((0, 2))).shape == (0, 2)


@given(
    st.floats(-0.35, 0.3),
    st.floats(-0.1, 0.2),
    st.floats(-0.003, 0.003),
    st.floats(-0.003, 0.003),
    st.floats(0.0, 0.98),
    st.floats(0.0, 2.0 * math.pi),
)
def test_any_ordinary_lens_inverts_wherever_it_claims_to(
    k1: float, k2: float, p1: float, p2: float, share: float, angle: float
) -> None:
    lens = BrownLens((1280, 800), (800.0, 800.0), (639.5, 399.5), (k1, k2, p1, p2))
    ideal = share * lens.r_max * np.array([math.cos(angle), math.sin(angle)])
    assert lens.undistort(lens.distort(ideal)) == pytest.approx(ideal, abs=1e-7)


def test_r_max_is_sqrt_2_for_a_lens_that_is_one_to_one_so_far() -> None:
    assert LAB.r_max == R_MAX_DEFAULT == math.sqrt(2.0)
    assert STRAIGHT.r_max == R_MAX_DEFAULT


def test_r_max_ends_where_a_barrel_lens_folds_back() -> None:
    fold = math.sqrt(1.0 / (3.0 * 0.4))  # d(r - 0.4 r^3)/dr = 0
    assert BARREL.r_max <= fold
    assert pytest.approx(fold, abs=1e-3) == BARREL.r_max


def test_r_max_ends_before_a_pole_of_the_rational_part() -> None:
    lens = BrownLens((640, 480), (400.0, 400.0), (319.5, 239.5), (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0))
    assert lens.r_max < 1.0
    assert pytest.approx(1.0, abs=2e-3) == lens.r_max


def test_a_fisheye_reaches_further() -> None:
    assert FISHEYE.r_max > math.tan(math.radians(80.0))


@pytest.mark.parametrize("name", ALL)
def test_nothing_past_r_max_is_visible_in_either_direction(name: str) -> None:
    lens = replace(ALL[name], r_max=0.5)  # type: ignore[type-var]  # a Protocol of frozen dataclasses
    inside, outside = np.array([0.3, 0.39]), np.array([0.3, 0.41])
    assert np.isnan(lens.project(np.array([*outside, 1.0]))).all()
    assert np.isnan(lens.undistort(lens.distort(outside))).all()
    assert lens.undistort(lens.distort(inside)) == pytest.approx(inside, abs=1e-9)
    assert np.isfinite(lens.project(np.array([*inside, 1.0]))).all()


def test_behind_the_camera_and_in_its_plane_nothing_projects() -> None:
    assert np.isnan(LAB.project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.0]]))).all()


def test_one_pixel_without_a_solution_spoils_no_other() -> None:
    good = LAB.project(in_space(0.5 * ideal_points(LAB, 8)))
    pixels = np.concatenate([good, [[1e6, 400.0], [np.nan, 3.0], [-1e9, 1e9]]])
    ideal = LAB.unproject(pixels)
    assert ideal[:8] == pytest.approx(LAB.unproject(good), abs=1e-12)
    assert np.isnan(ideal[8:]).all()


def test_lenses_travel_to_another_process() -> None:
    for lens in ALL.values():
        twin = pickle.loads(pickle.dumps(lens))
        ideal = ideal_points(lens, 5)
        assert np.array_equal(
            twin.unproject(lens.project(in_space(ideal))), lens.unproject(lens.project(in_space(ideal)))
        )


def test_wrong_coefficients_are_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="distortion has 3 numbers"):
        BrownLens((640, 480), (400.0, 400.0), (320.0, 240.0), (0.1, 0.2, 0.3))
    with pytest.raises(InputError, match="tilted sensor"):
        BrownLens((640, 480), (400.0, 400.0), (320.0, 240.0), (*(0.0,) * 12, 0.01, 0.0))
    with pytest.raises(InputError, match="4 numbers, not 5"):
        FisheyeLens((640, 480), (400.0, 400.0), (320.0, 240.0), (0.0,) * 5)
