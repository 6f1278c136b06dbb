"""`infeasible` is said only where it is proven: never where some configuration covers everything."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.frustum import ray_floor, rim_directions
from camrig.messages import DroneAim, PlanStatus
from camrig.optimise import PlannerSettings, PoseSigma, Scene, SceneCamera, SceneTarget
from camrig.optimise.certificate import certified_infeasible
from camrig.optimise.kernels.pose import pose_of
from camrig.optimise.scene import Visibility
from tests.lenses import FISHEYE
from tests.planner_scenes import LAB, clock, drone, head, shown, solve, targets, task

SHORT = replace(LAB, r_max=0.45)
"""Its view ends at r_max to the left and right, at the picture's edge above and below."""
CAMERAS = {
    "head": head("c", 2.0, 1.5),
    "drone": drone("c"),
    "head that r_max ends": head("c", 2.0, 1.5, lens=SHORT),
    "drone that r_max ends": drone("c", lens=SHORT),
    "fisheye": head("c", 2.0, 1.5, lens=replace(FISHEYE, r_max=1.0)),
}


def about_the_rim(camera: SceneCamera, u: Array, shares: list[float], inside: float) -> Array:
    """Points (K, 3) of the floor just inside the rim of what the camera shows from a vector."""
    whole = task(Scene((camera,), targets((0.0, 0.0))))
    T = pose.transform(*pose_of(whole.problem.cameras[0], u))
    rim = rim_directions(camera.lens, per_edge=16)
    rim[:, :2] *= 1.0 - inside
    hits = ray_floor(T[:3, 3], rim[[int(share * len(rim)) for share in shares]] @ T[:3, :3].T)
    return np.asarray(hits[np.isfinite(hits).all(axis=1)])


@pytest.mark.parametrize("tag_size_m", [None, 0.01, 0.3])
@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("name", CAMERAS)
@settings(deadline=None, max_examples=20)
@given(
    st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3),
    st.lists(st.floats(0.0, 0.999), min_size=4, max_size=12),
    st.sampled_from([1e-6, 0.01, 0.1]),
)
def test_what_one_vector_covers_is_never_called_infeasible(
    name: str,
    visibility: Visibility,
    tag_size_m: float | None,
    vector: list[float],
    shares: list[float],
    inside: float,
) -> None:
    camera = CAMERAS[name]
    low, high = task(Scene((camera,), targets((0.0, 0.0)))).problem.cameras[0, 33:45].reshape(2, 6)
    u = low.copy()
    u[low < high] = (low + np.resize(vector, 6) * (high - low))[low < high]
    spots = about_the_rim(camera, u, shares, max(inside, 1.5 * (tag_size_m or 0.0)))
    tags = tuple(SceneTarget(f"t{k}", tuple(spot.tolist()), tag_size_m) for k, spot in enumerate(spots))
    scene = Scene((camera,), tags, PlannerSettings(visibility=visibility, margin_rad=0.0))
    assume(tags)
    seen = shown(task(scene).problem, 0, u[None])[0]
    assume(seen.any())
    feasible = replace(scene, targets=tuple(tag for tag, there in zip(tags, seen, strict=True) if there))
    assert not certified_infeasible(task(feasible), lambda: False)


def test_a_target_that_no_camera_can_ever_see_is_proof() -> None:
    scene = Scene((head("h", 1.0, 1.0),), (*targets((1.5, 1.0)), SceneTarget("above", (1.0, 1.5, 5.0))))
    plan = solve(scene)
    assert (plan.status, plan.uncovered) == (PlanStatus.INFEASIBLE, ("above",))


def test_two_targets_on_two_sides_are_proof_for_one_head_and_not_for_two() -> None:
    sides = targets((0.2, 1.5), (4.8, 1.5))
    low = head("h", 2.5, 1.5, z=1.0)
    alone = solve(Scene((low,), sides))
    assert (alone.status, len(alone.uncovered)) == (PlanStatus.INFEASIBLE, 1)
    assert solve(Scene((low, replace(low, id="g")), sides)).status is PlanStatus.OPTIMISED


def test_three_sides_are_proof_for_two_heads_though_each_side_can_be_seen() -> None:
    low = head("h", 2.5, 1.5, z=1.0)
    scene = Scene((low, replace(low, id="g")), targets((0.2, 1.5), (4.8, 0.8), (2.9, 5.0)))
    plan = solve(scene)
    assert (plan.status, len(plan.uncovered)) == (PlanStatus.INFEASIBLE, 1)


def test_what_only_nearly_fits_is_not_found_rather_than_infeasible() -> None:
    """Two targets a hair too far apart for the cone: no proof, because the grid's views are widened."""
    half = math.atan(1280.0 / (2.0 * math.sqrt(827.7 * 827.9)))
    reach_m = 1.5 * math.tan(half) * 1.002  # the highest drone is 1.5 m above the targets
    spots = tuple(SceneTarget(f"t{k}", (2.5 + side * reach_m, 1.5, 1.0)) for k, side in enumerate((-1.0, 1.0)))
    plan = solve(Scene((drone("d"),), spots))
    assert (plan.status, len(plan.uncovered)) == (PlanStatus.PARTIAL, 1)


def test_without_time_or_from_a_start_nothing_is_proven() -> None:
    scene = Scene((head("h", 1.0, 1.0),), (SceneTarget("above", (1.0, 1.5, 5.0)),))
    hurried = optimise.plan(scene, deadline_s=0.5, now=clock(1.0))
    assert hurried.status is PlanStatus.PARTIAL
    again = solve(scene, start=hurried.aims)
    assert again.status is PlanStatus.PARTIAL


def test_a_rig_whose_proof_would_take_long_is_not_proven() -> None:
    rng = np.random.default_rng(0)
    heads = tuple(head(f"h{k}", float(x), float(y)) for k, (x, y) in enumerate(rng.uniform((0, 0), (5, 3), (20, 2))))
    spots = targets(*((float(x), float(y)) for x, y in rng.uniform((0, 0), (5, 3), (400, 2))))
    whole = task(Scene(heads, spots, PlannerSettings(visibility="image")))
    assert not certified_infeasible(whole, lambda: False)


def test_free_yaws_are_too_many_poses_to_prove_anything() -> None:
    scene = Scene((drone("d", yaw_free=True),), targets((0.1, 1.5), (4.9, 1.5)))
    plan = solve(scene)
    assert plan.status is PlanStatus.PARTIAL
    assert isinstance(plan.aims["d"], DroneAim)
    assert PoseSigma() == scene.cameras[0].pose_sigma
