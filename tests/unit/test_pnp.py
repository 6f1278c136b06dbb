"""Poses from tag corners against OpenCV's exact projections; covariance against sampling."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.corner_noise import detected_sigma_px, refined_sigma_px, tag_width_px
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.pnp import (
    TAG_CORNERS,
    ImagePoints,
    observe_tags,
    refine,
    square_poses,
    whitened_residuals,
)
from camrig.geometry.rotation import rotation_exp, rotation_from_rpy

LAB = BrownLens((1280, 800), (827.6785, 827.8561), (640.0, 400.0), (-0.335814, 0.101432, 0.0, 0.0, 0.0))
BENT = BrownLens((1280, 800), (830.0, 826.0), (652.0, 391.0), (-0.2, 0.05, 0.002, -0.001, 0.004))
FISHEYE = FisheyeLens((1280, 960), (380.0, 382.0), (639.0, 481.0), (-0.01, 0.02, -0.01, 0.002))
SIZE_M = 0.162
FACING = np.diag([1.0, -1.0, -1.0])
"""R_camera_tag of a tag that faces the camera, upright in the picture."""


def opencv_pixels(lens: Lens, T_camera_body: Array, points_body: Array) -> Array:
    """Project with OpenCV, so that a mistake in our geometry shows."""
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    rvec, tvec = cv2.Rodrigues(T_camera_body[:3, :3])[0], T_camera_body[:3, 3]
    if isinstance(lens, FisheyeLens):
        pixels, _ = cv2.fisheye.projectPoints(points_body[:, None], rvec, tvec, K, np.array(lens.distortion))
    else:
        assert isinstance(lens, BrownLens)
        pixels, _ = cv2.projectPoints(points_body, rvec, tvec, K, np.array(lens.distortion))
    return np.asarray(pixels[:, 0], dtype=float)


def random_pose(rng: np.random.Generator, tilt: float = 0.6) -> Array:
    where = np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.35, 0.35), 1.0]) * rng.uniform(1.2, 2.4)
    return pose.transform(FACING @ rotation_exp(rng.uniform(-tilt, tilt, 3)), where)


def noisy(lens: Lens, T: Array, corners: Array, rng: np.random.Generator) -> ImagePoints:
    """Corners with exactly the noise that the law claims."""
    pixels = opencv_pixels(lens, T, corners).reshape(-1, 4, 2)
    sigma = observe_tags(lens, pixels).sigma_px
    return observe_tags(lens, pixels + rng.normal(size=pixels.shape) * sigma[..., None])


@pytest.mark.parametrize("lens", [LAB, BENT, FISHEYE], ids=["lab", "bent", "fisheye"])
@pytest.mark.parametrize("seed", range(5))
def test_one_of_the_two_poses_of_an_exact_square_is_the_true_one(lens: Lens, seed: int) -> None:
    T = random_pose(np.random.default_rng(seed))
    points = observe_tags(lens, opencv_pixels(lens, T, SIZE_M * TAG_CORNERS)[None])
    better, worse = square_poses(points.ideal[0], points.px_per_ideal[0], SIZE_M)
    assert better.T_camera_tag == pytest.approx(T, abs=1e-6)
    assert better.rms_px < 1e-4 < worse.rms_px


def test_a_tag_whose_first_corner_is_bottom_left_in_the_picture_stands_upright_and_faces_the_camera() -> None:
    corners_px = np.array([[600.0, 440.0], [680.0, 440.0], [680.0, 360.0], [600.0, 360.0]])
    straight = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0))
    points = observe_tags(straight, corners_px[None])
    found = square_poses(points.ideal[0], points.px_per_ideal[0], SIZE_M)[0]
    # Seen head-on, a tilt shows only squared: a micropixel is 1e-4 rad.
    assert found.T_camera_tag[:3, :3] == pytest.approx(FACING, abs=1e-3)
    assert found.T_camera_tag[:3, 3] == pytest.approx([0.0, 0.0, SIZE_M * 800.0 / 80.0], abs=1e-5)


def test_corners_on_a_line_have_no_pose() -> None:
    corners = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    found = square_poses(corners, np.broadcast_to(800.0 * np.eye(2), (4, 2, 2)), SIZE_M)
    assert all(np.isfinite(square.T_camera_tag).all() for square in found)


def test_the_residual_derivative_is_the_derivative() -> None:
    rng = np.random.default_rng(3)
    T = np.stack([random_pose(rng), random_pose(rng)])
    corners = np.repeat(SIZE_M * TAG_CORNERS[None], 2, axis=0)
    ideal, whitener = rng.normal(size=(2, 4, 2)), rng.normal(size=(2, 4, 2, 2))
    _, J = whitened_residuals(T, corners, ideal, whitener)
    step = 1e-6
    for k in range(6):
        delta = step * np.eye(6)[k]
        ahead, behind = (
            whitened_residuals(np.stack([pose.perturb(one, sign * delta) for one in T]), corners, ideal, whitener)[0]
            for sign in (1.0, -1.0)
        )
        assert J[..., k] == pytest.approx((ahead - behind) / (2.0 * step), abs=1e-6)


def test_residuals_are_those_of_the_true_lens_in_pixels() -> None:
    """What ``refine`` minimises is linear in the lens; half a pixel off, that is right to a thousandth of a pixel."""
    rng = np.random.default_rng(4)
    T = random_pose(rng)
    pixels = opencv_pixels(BENT, T, SIZE_M * TAG_CORNERS)
    offset = rng.uniform(-0.5, 0.5, (4, 2))
    points = observe_tags(BENT, (pixels + offset)[None])
    residual, _ = whitened_residuals(T[None], SIZE_M * TAG_CORNERS[None], points.ideal, points.px_per_ideal)
    assert residual[0] == pytest.approx(-offset, abs=1e-3)


@pytest.mark.parametrize("lens", [LAB, BENT, FISHEYE], ids=["lab", "bent", "fisheye"])
def test_refinement_finds_the_true_pose_of_a_body_from_a_poor_start(lens: Lens) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        T = random_pose(rng, tilt=0.3)
        tags = [
            pose.transform(rotation_from_rpy(*rng.uniform(-0.4, 0.4, 3)), rng.uniform(-0.2, 0.2, 3)) for _ in range(3)
        ]
        corners = np.concatenate([pose.apply(tag, 0.1 * TAG_CORNERS) for tag in tags])
        points = observe_tags(lens, opencv_pixels(lens, T, corners).reshape(-1, 4, 2))
        start = pose.perturb(T, rng.normal(size=6) * 0.1)
        fit = refine(start[None], corners[None], points.ideal.reshape(1, -1, 2), points.whitener.reshape(1, -1, 2, 2))
        assert fit.T_camera_body[0] == pytest.approx(T, abs=1e-5)
        assert fit.chi2[0] < 1e-3


def nees(T: Array, found: Array, covariance: Array) -> float:
    error = pose.difference(T, found)
    return float(error @ np.linalg.solve(covariance, error))


def within_chance(values: list[float], freedoms: int) -> bool:
    """Whether a mean of NEES lies within the two-sided 99.8 % bounds of chi2."""
    n = len(values)
    low, high = (float(chi2.ppf(p, freedoms * n)) / n for p in (0.001, 0.999))
    return bool(low <= np.mean(values) <= high)


def test_the_covariance_of_one_tag_is_what_sampling_shows() -> None:
    rng = np.random.default_rng(6)
    corners = SIZE_M * TAG_CORNERS
    values = []
    for _ in range(600):
        T = random_pose(rng)
        points = noisy(LAB, T, corners, rng)
        squares = square_poses(points.ideal[0], points.px_per_ideal[0], SIZE_M)
        starts = np.stack([square.T_camera_tag for square in squares])
        twice = [np.repeat(part, len(starts), axis=0) for part in (corners[None], points.ideal, points.whitener)]
        fit = refine(starts, twice[0], twice[1], twice[2])
        values.append(min(nees(T, fit.T_camera_body[k], fit.covariance[k]) for k in range(len(starts))))
    assert within_chance(values, 6)


def test_the_covariance_with_a_prior_is_what_sampling_shows() -> None:
    rng = np.random.default_rng(7)
    corners = SIZE_M * TAG_CORNERS
    sigma = np.array([0.01, 0.02, 0.01, 0.01, 0.005, 0.02])
    values = []
    for _ in range(500):
        T = random_pose(rng)
        believed = pose.perturb(T, -rng.normal(size=6) * sigma)
        points = noisy(LAB, T, corners, rng)
        prior = pose.PosePriors(believed[None], np.diag(sigma**-2.0)[None])
        fit = refine(believed[None], corners[None], points.ideal, points.whitener, prior)
        values.append(nees(T, fit.T_camera_body[0], fit.covariance[0]))
    assert within_chance(values, 6)


def test_points_of_no_weight_change_nothing() -> None:
    rng = np.random.default_rng(8)
    T = random_pose(rng)
    corners = SIZE_M * TAG_CORNERS
    points = noisy(LAB, T, corners, rng)
    alone = refine(T[None], corners[None], points.ideal, points.whitener)
    padded = refine(
        T[None],
        np.concatenate([corners, corners])[None],
        np.concatenate([points.ideal, np.zeros((1, 4, 2))], axis=1),
        np.concatenate([points.whitener, np.zeros((1, 4, 2, 2))], axis=1),
    )
    assert padded.T_camera_body == pytest.approx(alone.T_camera_body, abs=1e-12)
    assert padded.rms_sigma == pytest.approx(alone.rms_sigma, abs=1e-9)


def test_a_corner_past_r_max_is_nan() -> None:
    lens = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0), (0.0, 0.0, 0.0, 0.0), r_max=0.5)
    points = observe_tags(lens, np.array([[[1000.0, 400.0], [1060.0, 400.0], [1060.0, 340.0], [1000.0, 340.0]]]))
    assert np.isfinite(points.ideal[0, 0]).all()
    assert np.isnan(points.ideal[0, 1]).all()


@pytest.mark.parametrize(
    ("width_px", "radius", "low", "high"),
    [
        (32.0, 0.3, 0.05, 0.09),
        (50.0, 0.3, 0.06, 0.1),
        (75.0, 0.1, 0.06, 0.12),
        (75.0, 0.7, 0.2, 0.3),
        (110.0, 0.5, 0.3, 0.45),
    ],
)
def test_the_noise_law_of_a_detectors_corners_meets_what_was_measured(
    width_px: float, radius: float, low: float, high: float
) -> None:
    assert low < detected_sigma_px(np.asarray(width_px), np.asarray(radius)) < high


def test_each_corner_is_weighed_by_whether_it_was_refined() -> None:
    corners = np.array([[[600.0, 440.0], [650.0, 440.0], [650.0, 390.0], [600.0, 390.0]]])
    sigma = observe_tags(LAB, corners, np.array([[True, False, True, True]])).sigma_px
    assert sigma[0, [0, 2, 3]] == pytest.approx(float(refined_sigma_px(np.asarray(50.0))))
    assert sigma[0, 1] == observe_tags(LAB, corners).sigma_px[0, 1]
    assert sigma[0, 1] > 3.0 * sigma[0, 0]


def test_the_width_of_a_tag_is_the_root_of_its_area_whichever_way_round() -> None:
    corners = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 2.0], [0.0, 2.0]])
    assert tag_width_px(corners) == pytest.approx(4.0)
    assert tag_width_px(corners[::-1]) == pytest.approx(4.0)
