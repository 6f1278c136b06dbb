"""Every slope that the polish follows, against finite differences: all models, all variables, all kinds of camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.corner_noise import NOISE_PX, SMALL_TAG_PX2, tag_width_px
from camrig.geometry.lens_row import R_MAX, pixel_at
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, PanTilt
from camrig.geometry.rotation import rotation_exp
from camrig.optimise import (
    DronePlace,
    HeadPlace,
    PlannerSettings,
    PoseSigma,
    Scene,
    SceneAnchor,
    SceneCamera,
    SceneTarget,
)
from camrig.optimise.configuration import configuration
from camrig.optimise.frozen import frozen
from camrig.optimise.kernels.frozen import hessian_of, joint, kept_of, qualities_of, totals, values, with_joint
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import CHANNELS, CORNERS, QUALITY, ZOOM, Ints, Problem, Z
from camrig.optimise.kernels.sight import cone_cosine, sees
from camrig.optimise.kernels.slopes import worth_slopes
from camrig.optimise.kernels.worth import anchors_in_view
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Quality, Visibility, ZoomStep
from tests.lenses import FISHEYE, LAB, PRISM
from tests.planner_scenes import LEVEL, PAN, TILT, drone, head, task

QUALITIES: tuple[Quality, ...] = ("pixel", "perspective", "fisher")
BIASED = PoseSigma(0.002, 0.001, 0.003, 0.002)
ASKEW = pose.transform(rotation_exp(np.array([0.05, -0.1, 0.08])) @ LEVEL[:3, :3], np.array([0.06, 0.02, 0.05]))
ARM = pose.transform(rotation_exp(np.array([0.02, 0.03, -0.04])), np.array([0.03, -0.02, 0.08]))
BASE = pose.transform(rotation_exp(np.array([0.04, -0.02, 0.7])), np.array([1.0, 1.2, 2.7]))
HUNG = pose.transform(rotation_exp(np.array([0.1, -0.05, 0.0])) @ R_BODY_OPTICAL_DOWN, np.array([0.1, 0.02, -0.05]))
TELE = replace(LAB, focal_px=(1300.0, 1310.0), distortion=(-0.2, 0.05, 0.0, 0.0))
ZOOM_TABLE = tuple(
    ZoomStep(float(k), lens) for k, lens in enumerate((LAB, TELE, replace(TELE, focal_px=(2000.0,) * 2)))
)

CAMERAS = {
    "head": SceneCamera("c", LAB, HeadPlace(PanTilt(BASE, ARM), ASKEW, PAN, TILT), pose_sigma=BIASED),
    "prism": SceneCamera("c", PRISM, HeadPlace(PanTilt(BASE, ARM), ASKEW, PAN, TILT), pose_sigma=BIASED),
    "to be mounted": SceneCamera(
        "c", LAB, HeadPlace(PanTilt(BASE, ARM), ASKEW, PAN, TILT, ((0.0, 0.0, 2.0), (4.0, 3.0, 3.0))), pose_sigma=BIASED
    ),
    "zoom": SceneCamera("c", LAB, HeadPlace(PanTilt(BASE, ARM), ASKEW, PAN, TILT), pose_sigma=BIASED, zoom=ZOOM_TABLE),
    "drone with its yaw": SceneCamera(
        "c",
        LAB,
        DronePlace(HUNG, ((0.0, 0.0, 1.0), (4.0, 3.0, 3.0)), yaw_limits_rad=(-2.0, 2.0)),
        pose_sigma=PoseSigma(0.02, 0.01),
    ),
    "fisheye drone": SceneCamera(
        "c", FISHEYE, DronePlace(HUNG, ((0.0, 0.0, 1.0), (4.0, 3.0, 3.0)), yaw_limits_rad=(-2.0, 2.0))
    ),
}
ANCHORS = (SceneAnchor((2.0, 1.5, 0.0), 0.3, (0.1, 0.0, 1.0), 0.3), SceneAnchor((1.2, 0.9, 0.1), 0.25))


def smooth_here(problem: Problem, u: Array, row: Array) -> bool:
    """Whether a tag is well within the lens and not where the noise law of a detector's corners has its kink."""
    lens = lens_of(problem.cameras[0], problem.lenses, u)
    R, origin = pose_of(problem.cameras[0], u)
    corners = (row[CORNERS : CORNERS + 12].reshape(4, 3) - origin) @ R
    if corners[:, 2].min() < 0.2:
        return False
    off_axis = np.linalg.norm(corners[:, :2], axis=1) / corners[:, 2]
    if off_axis.max() > 0.95 * min(float(lens[R_MAX]), 2.0):
        return False
    width = float(tag_width_px(np.array([pixel_at(lens, *corner) for corner in corners])))
    return abs(width * NOISE_PX / SMALL_TAG_PX2 - 1.0) > 0.02


def worths(problem: Problem, u: Array) -> Array:
    return _worths_and_slopes(problem, u)[0]


def _worths_and_slopes(problem: Problem, u: Array) -> tuple[Array, Array]:
    targets: Ints = np.arange(len(problem.targets))
    channels = CHANNELS[int(problem.settings[QUALITY])]
    found, slopes = np.empty((len(targets), channels)), np.empty((len(targets), 6, channels))
    lens = lens_of(problem.cameras[0], problem.lenses, u)
    anchors = anchors_in_view(problem, lens, *pose_of(problem.cameras[0], u))
    worth_slopes(problem, 0, u, anchors, targets, found, slopes)
    return found, slopes


def check_slopes(problem: Problem, u: Array) -> None:
    _, slopes = _worths_and_slopes(problem, u)
    for variable in range(6):
        if problem.low[0, variable] == problem.high[0, variable]:
            assert (slopes[:, variable] == 0.0).all()
            continue
        # Fourth-order differences: what a smooth function of unit length scale is wrong by is 1e-12 and rounding.
        step = 1e-4 * np.eye(6)[variable]
        near = worths(problem, u + step) - worths(problem, u - step)
        far = worths(problem, u + 2.0 * step) - worths(problem, u - 2.0 * step)
        expected = (8.0 * near - far) / 12e-4
        scale = np.abs(slopes).max() + 1e-6 * np.abs(worths(problem, u)).max()
        np.testing.assert_allclose(slopes[:, variable], expected, rtol=0.0, atol=1e-5 * scale)


@st.composite
def tags(draw: st.DrawFn) -> SceneTarget:
    x, y, z = draw(st.floats(0.0, 4.0)), draw(st.floats(0.0, 3.0)), draw(st.floats(0.0, 0.5))
    normal = draw(st.floats(-0.5, 0.5)), draw(st.floats(-0.5, 0.5)), 1.0
    return SceneTarget("t", (x, y, z), draw(st.sampled_from([0.08, 0.2, 0.4])), normal, draw(st.floats(-3.0, 3.0)))


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize("name", CAMERAS)
@settings(deadline=None, max_examples=25)
@given(st.sampled_from(QUALITIES), st.booleans(), tags(), st.lists(st.floats(0.05, 0.95), min_size=6, max_size=6))
def test_what_a_camera_adds_has_the_slopes_it_says(
    name: str, anchored: bool, quality: Quality, refined: bool, tag: SceneTarget, shares: list[float]
) -> None:
    anchors = ANCHORS if anchored else ()
    how = PlannerSettings(quality, "image", refined_corners=refined)
    problem = problem_of(Scene((CAMERAS[name],), (tag,), how, anchors=anchors))
    u = problem.low[0] + np.array(shares) * (problem.high[0] - problem.low[0])
    if isinstance(CAMERAS[name].place, HeadPlace):
        about = np.array([shares[3] - 0.5, shares[4] - 0.5, 0.0])
        u = looking_at(problem, u, np.array(tag.position_m) + about)
    assume(abs(u[ZOOM] - round(u[ZOOM])) > 1e-3 or problem.high[0, ZOOM] == 0.0)
    assume(smooth_here(problem, u, problem.targets[0]))
    for anchor in problem.anchors:
        seen = [anchor_seen(problem, u + 1e-2 * delta, anchor) for delta in (*np.eye(6), *-np.eye(6))]
        assume(len(set(seen)) == 1)
        assume(smooth_here(problem, u, anchor) or not seen[0])
    check_slopes(problem, u)


def looking_at(problem: Problem, u: Array, point: Array) -> Array:
    """About at a point: askew axes leave a few degrees."""
    x, y, z = BASE[:3, :3].T @ (point - u[: Z + 1])
    out = u.copy()
    out[3:5] = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    return np.clip(out, problem.low[0], problem.high[0])


def anchor_seen(problem: Problem, u: Array, anchor: Array) -> bool:
    lens = lens_of(problem.cameras[0], problem.lenses, u)
    cosine = cone_cosine(problem.settings, lens)
    return bool(sees(problem.settings, problem.boxes, lens, cosine, *pose_of(problem.cameras[0], u), anchor))


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize(("zoom", "inwards"), [(0.0, 1.0), (2.0, -1.0)])
def test_a_zoom_at_the_end_of_its_table_has_the_slope_inwards(quality: Quality, zoom: float, inwards: float) -> None:
    tag = SceneTarget("t", (2.0, 1.6, 0.0), 0.3)
    problem = problem_of(Scene((CAMERAS["zoom"],), (tag,), PlannerSettings(quality, "image")))
    u = looking_at(problem, np.array([*BASE[:3, 3], 0.0, 0.0, zoom]), np.array(tag.position_m))
    _, slopes = _worths_and_slopes(problem, u)
    step = 1e-6 * inwards
    inner = u + step * np.eye(6)[ZOOM]
    expected = (worths(problem, inner) - worths(problem, u)) / step
    np.testing.assert_allclose(slopes[:, ZOOM], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("quality", QUALITIES)
def test_the_whole_smooth_problem_has_the_slopes_and_the_curvature_it_says(
    quality: Quality, visibility: Visibility
) -> None:
    scene = Scene(
        (head("h", 1.0, 1.0), drone("d", yaw_free=True), drone("e")),
        (SceneTarget("a", (1.2, 1.1, 0.0), 0.2), SceneTarget("b", (2.1, 1.8, 0.1), 0.2, weight=3.0)),
        PlannerSettings(quality, visibility, margin_rad=0.01, min_separation_m=0.5),
    )
    whole = task(scene)
    start = np.array([[1.0, 1.0, 2.7, 0.7, -1.1, 0], [1.4, 1.2, 1.9, 0.3, 0, 0], [2.0, 1.7, 1.6, 0, 0, 0]])
    here = configuration(whole, start)
    assert here.seen().sum() >= 4
    smooth = frozen(whole, here)
    problem, x, size = whole.problem, joint(smooth, start), int(smooth.column.max()) + 1
    prices = np.linspace(0.5, 2.0, len(smooth.edges) + len(smooth.pairs))
    importance = np.array([0.7, 1.2])

    def slopes(at: Array) -> tuple[Array, Array, Array]:
        """Of the qualities, of the constraints, and the Lagrangian's curvature."""
        vectors = with_joint(smooth, start, at)
        total, by = totals(problem, smooth, vectors)
        quality_slopes = qualities_of(problem, total, by, smooth.share)[1]
        hessian = hessian_of(problem, smooth, vectors, total, by, importance, prices)
        return quality_slopes, kept_of(problem, smooth, vectors, size)[1], hessian

    assert len(prices) > 1
    by_variable, kept_by_variable, hessian = slopes(x)
    scale = np.abs(hessian).max()
    for k, delta in enumerate(1e-5 * np.eye(size)):
        ahead, behind = (values(problem, smooth, with_joint(smooth, start, x + sign * delta)) for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_variable[:, k], (ahead[0] - behind[0]) / 2e-5, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(kept_by_variable[:, k], (ahead[1] - behind[1]) / 2e-5, rtol=1e-4, atol=1e-5)
        after, before = slopes(x + 10.0 * delta), slopes(x - 10.0 * delta)
        bent = importance @ (after[0] - before[0]) - prices @ (after[1] - before[1])
        np.testing.assert_allclose(hessian[k], bent / 2e-4, rtol=0.0, atol=1e-3 * scale)
