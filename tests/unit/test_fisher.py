"""The Fisher quality: what least squares reaches from noisy corners, and what the camera's own error adds to it."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry import pose
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.corner_noise import detected_sigma_px, planned_sigma_px, tag_width_px
from camrig.geometry.lens import Lens
from camrig.geometry.lens_row import lens_row
from camrig.geometry.rotation import rotation_exp, rotation_x, rotation_y, rotation_z
from camrig.geometry.tags import tag_corners
from camrig.sensing.fisher import corner_rows, corner_sigma, invert_symmetric, place_covariance, tag_information
from tests.lenses import ALL, FISHEYE, LAB, TANGENTIAL, opencv_camera

SIZE_M = 0.162
FACING = rotation_x(math.pi)
"""R_camera_tag of a tag that faces the camera upright."""


class View(NamedTuple):
    """A tag of ``SIZE_M`` before a camera: where its centre is, and how it is turned out of facing the camera."""

    lens: Lens
    centre: tuple[float, float, float]
    turn: Array

    def corners(self, size_m: float = SIZE_M) -> Array:
        square = tag_corners(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0, size_m)
        return np.asarray(square @ (self.turn @ FACING).T + self.centre)

    def information(self, size_m: float = SIZE_M) -> Array:
        found, centre = np.empty((6, 6)), np.array(self.centre)
        tag_information(lens_row(self.lens), self.corners(size_m), centre, centre, found)
        return found

    def covariance(self, size_m: float = SIZE_M) -> Array:
        found = np.empty((3, 3))
        place_covariance(self.information(size_m), found, np.empty((3, 6)))
        return found


VIEWS = {
    "oblique": View(LAB, (0.1, -0.1, 1.5), rotation_x(0.7)),
    "off the axis": View(LAB, (0.9, 0.4, 1.8), rotation_y(-0.6) @ rotation_z(0.5)),
    "tangential": View(TANGENTIAL, (-0.5, 0.3, 1.2), rotation_x(-0.5) @ rotation_y(0.5)),
    "fisheye": View(FISHEYE, (0.8, 0.2, 0.7), rotation_y(0.9)),
}


def rms(covariance: Array) -> float:
    return math.sqrt(float(np.trace(covariance)))


@pytest.mark.parametrize("name", ALL)
def test_the_rows_are_the_derivatives_of_the_corners_pixels(name: str) -> None:
    lens = ALL[name]
    centre, corner = np.array([0.3, -0.2, 1.4]), np.array([0.37, -0.26, 1.35])
    rows = np.empty((2, 6))
    corner_rows(lens_row(lens), corner, centre, rows)
    step = 1e-6
    for k in range(6):
        moved = np.zeros(6)
        moved[k] = step
        ahead, behind = (
            lens.project(centre + rotation_exp(np.asarray(sign * moved[3:])) @ (corner - centre) + sign * moved[:3])
            for sign in (1.0, -1.0)
        )
        # Rounding of a pixel coordinate (1e-13) over the step.
        np.testing.assert_allclose(rows[:, k], (ahead - behind) / (2.0 * step), atol=1e-5)


@pytest.mark.parametrize("size_m", [0.02, SIZE_M, 0.5])
@pytest.mark.parametrize("name", VIEWS)
def test_the_corners_sigma_is_the_noise_law_at_width_and_radius(name: str, size_m: float) -> None:
    view, corners = VIEWS[name], VIEWS[name].corners(size_m)
    x, y, z = view.centre
    width = tag_width_px(view.lens.project(corners))
    found = [
        corner_sigma(lens_row(view.lens, refined=refined), corners, np.array(view.centre)) for refined in (True, False)
    ]
    expected = planned_sigma_px(width), detected_sigma_px(width, np.asarray(math.hypot(x, y) / z))
    assert found == pytest.approx([float(sigma) for sigma in expected])


def fitted(view: View, pixels: Array) -> Array:
    """The place that least squares finds for a tag of known size from noisy corners: Gauss-Newton from the truth."""
    centre, arms = np.array(view.centre), view.corners() - view.centre
    R = np.eye(3)
    row, rows = lens_row(view.lens), np.empty((4, 2, 6))
    for _ in range(6):
        corners = centre + arms @ R.T
        for k in range(4):
            corner_rows(row, corners[k], centre, rows[k])
        residual = (pixels - view.lens.project(corners)).ravel()
        step: Array = np.linalg.lstsq(rows.reshape(8, 6), residual, rcond=None)[0].astype(np.float64)
        centre, R = centre + step[:3], rotation_exp(step[3:]) @ R
    return centre


N = 3000
"""Draws: a variance is then known to sqrt(2/N) = 2.6 %, so 12 % is 4.6 sigma, wide enough for second order too."""


@pytest.mark.parametrize("name", VIEWS)
def test_the_covariance_is_what_least_squares_scatters_by(name: str) -> None:
    view = VIEWS[name]
    sigma = corner_sigma(lens_row(view.lens), view.corners(), np.array(view.centre))
    exact, rng = view.lens.project(view.corners()), np.random.default_rng(1)
    found = np.array([fitted(view, exact + sigma * rng.normal(size=(4, 2))) for _ in range(N)])
    scatter = np.cov(found.T)
    whitened = np.linalg.eigvals(np.linalg.solve(view.covariance(), scatter)).real
    assert whitened == pytest.approx(np.ones(3), abs=0.12)
    assert np.linalg.norm(found.mean(axis=0) - view.centre) < 0.15 * rms(view.covariance())


def test_opencvs_solver_scatters_by_the_covariance_too() -> None:
    view = VIEWS["oblique"]
    sigma = corner_sigma(lens_row(view.lens), view.corners(), np.array(view.centre))
    model = tag_corners(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0, SIZE_M)
    turn = cv2.Rodrigues(view.turn @ FACING)[0]
    exact, rng = view.lens.project(view.corners()), np.random.default_rng(2)
    found = np.empty((1500, 3))  # 3.7 % of a variance: 15 % is 4 sigma
    for k in range(len(found)):
        pixels = exact + sigma * rng.normal(size=(4, 2))
        _, _, place = cv2.solvePnP(
            model,
            pixels,
            opencv_camera(view.lens),
            np.array(LAB.distortion),
            turn.copy(),
            np.array(view.centre)[:, None].copy(),
            useExtrinsicGuess=True,
            flags=cv2.SOLVEPNP_ITERATIVE,
        )
        found[k] = place.ravel()
    whitened = np.linalg.eigvals(np.linalg.solve(view.covariance(), np.cov(found.T))).real
    assert whitened == pytest.approx(np.ones(3), abs=0.15)


def test_what_the_rotation_takes_is_taken_by_the_schur_complement() -> None:
    for view in VIEWS.values():
        information = view.information()
        whole = np.linalg.inv(information)
        np.testing.assert_allclose(view.covariance(), whole[:3, :3], rtol=1e-7, atol=1e-7 * rms(view.covariance()) ** 2)
        lever = np.empty((3, 6))
        place_covariance(information, np.empty((3, 3)), lever)
        found = lever @ information @ lever.T
        np.testing.assert_allclose(found, np.linalg.inv(whole[:3, :3]), rtol=1e-7, atol=1e-7 * np.abs(found).max())


@settings(deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9), st.floats(1e-3, 1e3))
def test_a_symmetric_inverse_is_the_inverse(entries: list[float], scale: float) -> None:
    root = np.array(entries).reshape(3, 3)
    matrix = scale * (root @ root.T + 0.1 * np.eye(3))
    inverse = np.empty((3, 3))
    invert_symmetric(matrix, inverse)
    np.testing.assert_allclose(inverse @ matrix, np.eye(3), atol=1e-10)  # condition below 200


def test_obliquity_matters_and_a_tag_that_faces_the_camera_is_worst_in_depth() -> None:
    facing = View(LAB, (0.0, 0.0, 2.0), np.eye(3)).covariance()
    oblique = View(LAB, (0.0, 0.0, 2.0), rotation_x(math.radians(50.0))).covariance()
    assert facing[2, 2] > 4.0 * facing[0, 0]
    assert abs(rms(oblique) / rms(facing) - 1.0) > 0.1


def test_a_larger_or_nearer_tag_is_better_placed_while_its_noise_is_the_floors() -> None:
    sizes = [rms(View(LAB, (0.0, 0.0, 2.0), rotation_x(0.6)).covariance(size_m)) for size_m in (0.05, 0.08, 0.12, 0.16)]
    assert sizes == sorted(sizes, reverse=True)
    depths = [rms(View(LAB, (0.0, 0.0, z), rotation_x(0.6)).covariance()) for z in (1.0, 2.0, 4.0, 8.0)]
    assert depths == sorted(depths)
    # Depth from size: beyond the noise's floor the error grows like depth^2 and faster.
    assert depths[3] > 4.0 * depths[2]


def turned(T: Transform, covariance: Array) -> Array:
    R = T[:3, :3]
    return np.asarray(R @ covariance @ R.T)


def test_the_covariance_is_that_of_the_camera_frame_whatever_the_worlds() -> None:
    view = VIEWS["off the axis"]
    T = pose.transform(rotation_exp(np.array([0.3, -1.0, 0.4])), np.array([3.0, 1.0, 2.0]))
    assert rms(turned(T, view.covariance())) == pytest.approx(rms(view.covariance()))
