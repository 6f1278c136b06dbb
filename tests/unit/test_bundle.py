"""The bundle adjustment: its slopes by differences, its covariance by sampling, what marginalising a motion means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camrig import fuse
from camrig.geometry import bundle
from camrig.geometry.arrays import Array
from camrig.geometry.bundle import Estimate, adjust, camera_evidence, projected
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.lens.errors import error_slopes
from camrig.geometry.pnp_kernel import move_stack
from camrig.geometry.rotation import rotation_exp
from camrig.locate import AS_CALIBRATED
from camrig.locate.joint_problem import Problem, build
from camrig.messages import Motion
from tests.watched_floor import Errors, Floor

STEP = 1e-6


def problem(spread_s: float = 0.0) -> Problem:
    """Return three cameras' views of four bodies and four anchors, some views of bodies ``spread_s`` later."""
    floor = Floor(3, cameras=3, bodies=4, anchors=True, errors=Errors(0.002, True, True))
    views = floor.views()
    views[1] = replace(views[1], stamp_s=views[1].stamp_s + spread_s)
    motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
    return build(
        views,
        {name: (1.0, T) for name, T in floor.places.items()},
        motions,
        floor.rig,
        AS_CALIBRATED.priors(list(floor.rig.cameras.values())),
        [view.carried for view in views],
    )


def normal_at(of: Problem, at: Estimate) -> bundle._Normal:
    return bundle._normal(of.views, of.cameras, of.lenses, of.bodies, at)


def moved(at: Estimate, cameras: Array, bodies: Array) -> Estimate:
    return Estimate(move_stack(at.cameras, cameras[:, :6]), at.lenses + cameras[:, 6:], move_stack(at.bodies, bodies))


@pytest.mark.parametrize(("spread_s", "turn_rad"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.3)])
def test_the_gradient_is_the_slope_of_the_cost(spread_s: float, turn_rad: float) -> None:
    of = problem(spread_s)
    turn = np.where((of.views.body >= 0)[:, None, None], rotation_exp(np.array([0.0, 0.0, turn_rad])), np.eye(3))
    of = replace(of, views=replace(of.views, turn=turn, slack_rad=np.zeros((len(turn), 3))))
    normal = normal_at(of, of.start)
    for k in range(10):
        for c in range(3):
            step = np.zeros((3, 10))
            step[c, k] = STEP
            still = np.zeros((4, 6))
            above, below = (normal_at(of, moved(of.start, sign * step, still)).cost for sign in (1.0, -1.0))
            assert normal.gc[c, k] == pytest.approx((above - below) / (4.0 * STEP), rel=1e-3, abs=5.0)
    for k in range(6):
        step = np.zeros((4, 6))
        step[2, k] = STEP
        above, below = (normal_at(of, moved(of.start, np.zeros((3, 10)), sign * step)).cost for sign in (1.0, -1.0))
        assert normal.gb[2, k] == pytest.approx((above - below) / (4.0 * STEP), rel=1e-3, abs=5.0)


def test_at_the_end_nothing_pulls_any_more() -> None:
    of = problem()
    found = adjust(of.views, of.cameras, of.lenses, of.bodies, of.start)
    normal = normal_at(of, found.estimate)
    camera_step, body_step = bundle._step(normal, 0.0)
    sigmas = np.sqrt(np.einsum("cici->ci", found.camera_covariance))
    assert float(np.abs(camera_step / sigmas).max()) < 1e-2
    assert float(np.abs(body_step).max()) < 1e-5


def test_the_covariance_is_the_inverse_of_the_whole_system() -> None:
    """The Schur complement against the dense inverse."""
    of = problem()
    found = adjust(of.views, of.cameras, of.lenses, of.bodies, of.start)
    normal = normal_at(of, found.estimate)
    H = np.zeros((54, 54))
    for c in range(3):
        H[10 * c : 10 * c + 10, 10 * c : 10 * c + 10] = normal.Hcc[c]
    for b in range(4):
        at = 30 + 6 * b
        H[at : at + 6, at : at + 6] = normal.Hbb[b]
        H[at : at + 6, :30] = normal.Hbc[b]
        H[:30, at : at + 6] = normal.Hbc[b].T
    P = np.linalg.inv(H)
    scale = np.sqrt(np.diag(P))
    apart = P / np.outer(scale, scale)
    assert found.camera_covariance.reshape(30, 30) / np.outer(scale[:30], scale[:30]) == pytest.approx(
        apart[:30, :30], abs=1e-5
    )
    for b in range(4):
        own = slice(30 + 6 * b, 36 + 6 * b)
        assert found.body_covariance[b] / np.outer(scale[own], scale[own]) == pytest.approx(apart[own, own], abs=1e-5)
        assert found.sensitivity[b].reshape(6, 30) / np.outer(scale[own], scale[:30]) == pytest.approx(
            apart[own, :30], abs=1e-5
        )


def test_a_view_of_another_time_counts_less_the_less_is_known_of_the_motion() -> None:
    of = problem(0.1)
    names = np.flatnonzero(of.views.camera == 1)
    sure = replace(of, views=replace(of.views, spread=np.zeros_like(of.views.spread)))
    with_motion = normal_at(of, of.start).chi2[names]
    without = normal_at(sure, of.start).chi2[names]
    bodies = of.views.body[names] >= 0
    assert (with_motion[bodies] < without[bodies]).all()
    assert with_motion[~bodies] == pytest.approx(without[~bodies])


def test_how_a_body_may_move_grows_with_time() -> None:
    motion = Motion(1.0, None, np.array([0.2, 0.0, 0.0]), 0.01 * np.eye(3), np.full(3, 0.03), np.array([0, 0, 0.5]))
    assert motion.shift_m(0.5) == pytest.approx([0.1, 0.0, 0.0])
    spread = motion.spread(-0.1)
    assert np.diag(spread) == pytest.approx([1.1e-4, 1.1e-4, 1.1e-4, 0.0, 0.0, 0.05])


@pytest.mark.parametrize(
    "lens",
    [
        BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.001, -0.002, 0.0)),
        FisheyeLens((1280, 800), (500.0, 500.0), (640.0, 400.0), (0.01, -0.002, 0.0, 0.0)),
    ],
    ids=["brown", "fisheye"],
)
def test_a_lenss_errors_move_pixels_as_another_lens_would(lens: BrownLens | FisheyeLens) -> None:
    ideal = np.random.default_rng(0).uniform(-0.6, 0.6, (20, 2))
    points = np.column_stack([ideal, np.ones(20)])
    slopes = error_slopes(lens, ideal)
    f, c, k = lens.focal_px, lens.centre_px, lens.distortion
    h = 1e-6
    others = (
        replace(lens, focal_px=(f[0] * (1 + h), f[1] * (1 + h)), r_max=lens.r_max),
        replace(lens, centre_px=(c[0] + h, c[1])),
        replace(lens, centre_px=(c[0], c[1] + h)),
        replace(lens, distortion=(k[0] + h, *k[1:])),
    )
    for j, other in enumerate(others):
        assert (other.project(points) - lens.project(points)) / h == pytest.approx(slopes[..., j], abs=2e-3)


def test_an_estimate_without_error_has_corners_where_they_were_seen() -> None:
    floor = Floor(3, cameras=3, bodies=4, anchors=True)
    views = [floor.view(name, noise=0.0) for name in floor.rig.cameras]
    motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
    lenses = AS_CALIBRATED.priors(list(floor.rig.cameras.values()))
    starts, poses = {name: (1.0, T) for name, T in floor.places.items()}, [view.carried for view in views]
    of = build(views, starts, motions, floor.rig, lenses, poses)
    at = replace(of.start, cameras=np.stack([floor.true_poses[view.camera_id] for view in views]))
    assert projected(of.views, at) == pytest.approx(of.views.ideal, abs=1e-7)


def test_evidence_on_cameras_is_what_is_left_once_bodies_are_eliminated() -> None:
    """Against the dense inverse: the cameras' covariance, once their priors are added."""
    of = problem()
    found = adjust(of.views, of.cameras, of.lenses, of.bodies, of.start)
    information, gradient = camera_evidence(of.views, of.bodies, found.estimate)
    for c in range(3):
        information[10 * c : 10 * c + 6, 10 * c : 10 * c + 6] += of.cameras.information[c]
        information[10 * c + 6 : 10 * c + 10, 10 * c + 6 : 10 * c + 10] += of.lenses.information[c]
    P = np.linalg.inv(information)
    expected = found.camera_covariance.reshape(30, 30)
    scale = np.sqrt(np.diag(expected))
    assert P / np.outer(scale, scale) == pytest.approx(expected / np.outer(scale, scale), abs=1e-3)
    lenses = [slice(10 * c + 6, 10 * c + 10) for c in range(3)]
    pulled = np.concatenate([of.lenses.information[c] @ found.estimate.lenses[c] for c in range(3)])
    assert np.concatenate([gradient[own] for own in lenses]) == pytest.approx(
        -pulled, rel=0.05, abs=0.02 * np.abs(pulled).max()
    )
