"""What cameras together make of a target under ``fisher``: pose errors, anchors, several cameras, the objective."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import lens_row
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.rotation import rotation_exp
from camrig.messages import HeadAim
from camrig.optimise import HeadPlace, PlannerSettings, PoseSigma, Scene, SceneAnchor, SceneCamera, SceneTarget
from camrig.optimise.kernels.pose import lens_of, pose_covariance, pose_of
from camrig.optimise.kernels.problem import CORNERS, FISHER, PAN, TILT, Problem
from camrig.optimise.kernels.worth import add_worth, known_pose, lever_of, quality_of, quality_slopes, with_information
from camrig.optimise.problem import problem_of
from camrig.sensing.fisher import corner_sigma
from tests.lenses import LAB
from tests.planner_scenes import LEVEL, head, under
from tests.planner_scenes import PAN as PAN_LIMITS
from tests.planner_scenes import TILT as TILT_LIMITS

SETTINGS = PlannerSettings(quality="fisher", visibility="image")
SIGMA = PoseSigma(position_m=0.002, attitude_rad=0.001, pan_rad=0.002, tilt_rad=0.003)
ASKEW = pose.transform(rotation_exp(np.array([0.05, -0.1, 0.08])) @ LEVEL[:3, :3], np.array([0.06, 0.02, 0.05]))
ARM = pose.transform(rotation_exp(np.array([0.02, 0.03, -0.04])), np.array([0.03, -0.02, 0.08]))
BASE = pose.transform(rotation_exp(np.array([0.04, -0.02, 0.7])), np.array([1.0, 1.2, 2.7]))
TARGET = SceneTarget("t", (2.0, 1.6, 0.0), 0.16, (0.2, 0.1, 1.0), 0.4)
ANCHOR = SceneAnchor((2.4, 1.3, 0.1), 0.2, (0.0, 0.1, 1.0), 0.2)
AIM = np.array([1.0, 1.2, 2.7, -0.4, -1.1, 0.0])
"""Both tags are in the picture."""


def crooked_head(sigma: PoseSigma) -> SceneCamera:
    """A head whose base, axes and camera are all askew."""
    return SceneCamera("h", LAB, HeadPlace(PanTilt(BASE, ARM), ASKEW, PAN_LIMITS, TILT_LIMITS), pose_sigma=sigma)


def scene(sigma: PoseSigma = SIGMA, anchors: tuple[SceneAnchor, ...] = ()) -> Scene:
    return Scene((crooked_head(sigma),), (TARGET,), SETTINGS, anchors=anchors)


def covariance(problem: Problem, u: Array = AIM) -> Array:
    """The (3, 3) covariance of the place of the first target, from the first camera alone, in the world."""
    lens = lens_of(problem.cameras[0], problem.lenses, u)
    R, origin = pose_of(problem.cameras[0], u)
    channels = np.zeros(6)
    known = known_pose(problem, 0, u, lens, R, origin)
    add_worth(FISHER, lens, R, origin, known, problem.targets[0], 1.0, channels)
    xx, xy, xz, yy, yz, zz = channels
    return np.linalg.inv(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


NONE = PoseSigma(0.0, 0.0)


def test_the_pose_of_a_vector_is_that_of_the_kinematics() -> None:
    R, origin = pose_of(problem_of(scene()).cameras[0], AIM)
    expected = PanTilt(BASE, ARM).T_world_camera(AIM[PAN], AIM[TILT], ASKEW)
    np.testing.assert_allclose(R, expected[:3, :3], atol=1e-12)
    np.testing.assert_allclose(origin, expected[:3, 3], atol=1e-12)


def test_an_uncertain_pose_adds_its_lever_to_the_covariance_exactly() -> None:
    with_prior, without = (covariance(problem_of(scene(sigma))) for sigma in (SIGMA, NONE))
    problem = problem_of(scene())
    S = np.empty((6, 6))
    pose_covariance(problem.cameras[0], AIM, S)
    A = lever_of(pose_of(problem.cameras[0], AIM)[1], problem.targets[0])
    np.testing.assert_allclose(with_prior, without + A @ S @ A.T, rtol=1e-9, atol=1e-15)


def test_the_poses_errors_scatter_a_place_by_a_s_at() -> None:
    """Monte Carlo through the kinematics: 4000 draws know a variance to 2.2 %, so 10 % is 4.5 sigma."""
    problem, kinematics = problem_of(scene()), PanTilt(BASE, ARM)
    believed = kinematics.T_world_camera(AIM[PAN], AIM[TILT], ASKEW)
    in_camera = pose.apply(pose.invert(believed), np.array(TARGET.position_m))
    rng = np.random.default_rng(3)
    places = np.empty((4000, 3))
    for k in range(len(places)):
        pan, tilt = AIM[PAN : TILT + 1] + rng.normal(size=2) * (SIGMA.pan_rad, SIGMA.tilt_rad)
        free = rng.normal(size=6) * np.repeat((SIGMA.position_m, SIGMA.attitude_rad), 3)
        places[k] = pose.apply(pose.perturb(kinematics.T_world_camera(pan, tilt, ASKEW), free), in_camera)
    S = np.empty((6, 6))
    pose_covariance(problem.cameras[0], AIM, S)
    A = lever_of(believed[:3, 3], np.array(TARGET.position_m))
    whitened = np.linalg.eigvals(np.linalg.solve(A @ S @ A.T, np.cov(places.T))).real
    assert whitened == pytest.approx(np.ones(3), abs=0.1)


def differenced_rows(problem: Problem, tag: Array, u: Array, sigma_px: float) -> tuple[Array, Array, Array]:
    """Whitened derivatives of a tag's eight pixel coordinates, by central differences in the world: by the camera's
    pose (8, 6), by the head's pan and tilt (8, 2), by the tag's place and turn (8, 6).
    """
    T = pose.transform(*pose_of(problem.cameras[0], u))
    corners = tag[CORNERS : CORNERS + 12].reshape(4, 3)
    step = 1e-6

    def pixels(camera: Array, points: Array) -> Array:
        return np.asarray(LAB.project(pose.apply(pose.invert(camera), points)).ravel() / sigma_px)

    def central(pair: tuple[Array, Array]) -> Array:
        return (pair[0] - pair[1]) / (2.0 * step)

    by_pose, by_tag, by_aim = np.empty((8, 6)), np.empty((8, 6)), np.empty((8, 2))
    for k, delta in enumerate(step * np.eye(6)):
        by_pose[:, k] = central((pixels(pose.perturb(T, delta), corners), pixels(pose.perturb(T, -delta), corners)))
        moved = [tag[:3] + s * delta[:3] + (corners - tag[:3]) @ rotation_exp(s * delta[3:]).T for s in (1.0, -1.0)]
        by_tag[:, k] = central((pixels(T, moved[0]), pixels(T, moved[1])))
    for k, delta in enumerate(step * np.eye(6)[PAN : TILT + 1]):
        ahead, behind = (pose.transform(*pose_of(problem.cameras[0], u + s * delta)) for s in (1.0, -1.0))
        by_aim[:, k] = central((pixels(ahead, corners), pixels(behind, corners)))
    return by_pose, by_aim, by_tag


def sigma_px(problem: Problem, tag: Array, u: Array) -> float:
    R, origin = pose_of(problem.cameras[0], u)
    corners = (tag[CORNERS : CORNERS + 12].reshape(4, 3) - origin) @ R
    return float(corner_sigma(lens_row(LAB), np.ascontiguousarray(corners), (tag[:3] - origin) @ R))


def test_the_sum_is_the_marginal_of_the_eight_states_together() -> None:
    """The matrix inversion lemma of sensing.fisher: tag pose and head biases estimated together from the corners."""
    problem = problem_of(scene(PoseSigma(0.0, 0.0, SIGMA.pan_rad, SIGMA.tilt_rad)))
    tag = problem.targets[0]
    _, by_aim, by_tag = differenced_rows(problem, tag, AIM, sigma_px(problem, tag, AIM))
    J = np.hstack([by_tag, by_aim])
    prior = np.diag([0.0] * 6 + [SIGMA.pan_rad**-2, SIGMA.tilt_rad**-2])
    marginal = np.linalg.inv(J.T @ J + prior)[:3, :3]
    # Differences of the rows are good to 1e-7 of the largest, and the depth's conditioning costs two digits.
    np.testing.assert_allclose(covariance(problem), marginal, rtol=1e-4, atol=1e-5 * np.trace(marginal))


def test_an_anchor_in_view_enters_as_if_all_were_estimated_together() -> None:
    problem = problem_of(scene(anchors=(ANCHOR,)))
    tag, anchor = problem.targets[0], problem.anchors[0]
    by_pose, _, by_tag = differenced_rows(problem, tag, AIM, sigma_px(problem, tag, AIM))
    anchor_by_pose, _, _ = differenced_rows(problem, anchor, AIM, sigma_px(problem, anchor, AIM))
    J = np.vstack([np.hstack([by_tag, by_pose]), np.hstack([np.zeros((8, 6)), anchor_by_pose])])
    S = np.empty((6, 6))
    pose_covariance(problem.cameras[0], AIM, S)
    prior = np.zeros((12, 12))
    prior[6:, 6:] = np.linalg.inv(S)
    marginal = np.linalg.inv(J.T @ J + prior)[:3, :3]
    np.testing.assert_allclose(covariance(problem), marginal, rtol=1e-4, atol=1e-5 * np.trace(marginal))


def test_anchors_reduce_what_the_pose_adds_and_only_where_they_are_seen() -> None:
    loose = PoseSigma(0.02, 0.01)
    without, exact = (np.trace(covariance(problem_of(scene(sigma)))) for sigma in (loose, NONE))
    one = np.trace(covariance(problem_of(scene(loose, (ANCHOR,)))))
    two = np.trace(covariance(problem_of(scene(loose, (ANCHOR, replace(ANCHOR, position_m=(1.6, 1.8, 0.0)))))))
    assert exact < two < one < 0.5 * without
    unseen = replace(ANCHOR, position_m=(-3.0, 1.0, 0.0))
    assert np.trace(covariance(problem_of(scene(loose, (unseen,))))) == without


def test_an_exactly_known_camera_gains_nothing_from_an_anchor_and_is_no_error() -> None:
    np.testing.assert_allclose(
        covariance(problem_of(scene(NONE, (ANCHOR,)))), covariance(problem_of(scene(NONE))), rtol=1e-9
    )


CHANNELS = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9)


def information(entries: list[float]) -> Array:
    """The channels of a positive definite information of some 1e6 per square metre."""
    root = np.array(entries).reshape(3, 3)
    M = 1e6 * (root @ root.T + 0.05 * np.eye(3))
    return np.array([M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]])


@settings(deadline=None)
@given(CHANNELS, CHANNELS)
def test_the_worth_is_the_rms_and_another_camera_never_makes_it_worse(one: list[float], other: list[float]) -> None:
    a, b = information(one), information(other)
    M = np.array([[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]])
    assert quality_of(a, FISHER) == pytest.approx(math.sqrt(np.trace(np.linalg.inv(M))), rel=1e-8)
    assert quality_of(a + b, FISHER) < min(quality_of(a, FISHER), quality_of(b, FISHER)) * (1.0 + 1e-12)


@settings(deadline=None)
@given(CHANNELS)
def test_the_worth_has_the_slopes_it_says(entries: list[float]) -> None:
    total, slopes = information(entries), np.empty(6)
    value = quality_slopes(total, FISHER, slopes)
    step = 1.0  # of some 1e6
    for k, delta in enumerate(step * np.eye(6)):
        expected = (quality_of(total + delta, FISHER) - quality_of(total - delta, FISHER)) / (2.0 * step)
        assert slopes[k] == pytest.approx(expected, rel=1e-4, abs=1e-4 * value / 1e6)


def test_another_camera_never_makes_a_target_worse() -> None:
    tag = SceneTarget("t", (2.0, 1.5, 0.0), 0.16)
    one, two = head("a", 1.0, 1.0), head("b", 3.0, 2.5)
    aims = {"a": HeadAim(0.46, -1.17), "b": HeadAim(-2.36, -1.09)}
    for quality in ("pixel", "fisher", "perspective"):
        judged = [
            optimise.quality_at(under(Scene(cameras, (tag,), SETTINGS), quality=quality), aims)
            for cameras in ((one,), (two,), (one, two))
        ]
        alone_a, alone_b, both = (plan.targets["t"].quality_m for plan in judged)
        assert alone_a is not None
        assert alone_b is not None
        assert both is not None
        assert both < min(alone_a, alone_b)
        if quality != "fisher":
            assert 1.0 / both == pytest.approx(1.0 / alone_a + 1.0 / alone_b)  # the paper's harmonic sum


def test_two_cameras_from_two_sides_are_better_than_two_from_one() -> None:
    """A tag's depth is what one view knows least: another side of it counts for more."""
    tag = SceneTarget("t", (2.5, 1.5, 0.0), 0.16)
    pixel: dict[str, float] = {}
    fisher: dict[str, float] = {}
    for name, other in (("beside", head("b", 1.2, 1.5)), ("across", head("b", 4.0, 1.5))):
        cameras = (head("a", 1.0, 1.5), other)
        pan = 0.0 if name == "beside" else 2.8
        tilt_a, tilt_b = -math.atan2(2.7, 1.5), -math.atan2(2.7, 1.3 if name == "beside" else 1.5)
        aims = {"a": HeadAim(0.0, tilt_a), "b": HeadAim(pan, tilt_b)}
        for quality, found in (("pixel", pixel), ("fisher", fisher)):
            plan = optimise.quality_at(under(Scene(cameras, (tag,), SETTINGS), quality=quality), aims)
            assert plan.targets["t"].seen_by == ("a", "b")
            found[name] = plan.objective_m or 0.0
    assert fisher["across"] < 0.85 * fisher["beside"]
    assert pixel["across"] > 0.9 * pixel["beside"]


@pytest.mark.parametrize("size", [0.0, 1.0, 1e9, 1e30, 1e300, math.inf, math.nan])
def test_what_is_known_of_a_pose_stays_a_number_whatever_anchors_tell(size: float) -> None:
    """A step that is tried may put an anchor where the lens's polynomial means nothing."""
    rows = np.random.default_rng(3).normal(size=(6, 2))
    before = np.diag([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 0.0])
    after = with_information(before, size * (rows @ rows.T))
    assert np.isfinite(after).all()
    assert np.trace(after) <= np.trace(before) * (1.0 + 1e-9)
    if size <= 1e9:
        exact = before[:5, :5] - before[:5, :5] @ rows[:5] @ np.linalg.solve(
            np.eye(2) / max(size, 1e-30) + rows[:5].T @ before[:5, :5] @ rows[:5], rows[:5].T @ before[:5, :5]
        )
        np.testing.assert_allclose(after[:5, :5], exact, rtol=1e-6, atol=1e-12)
