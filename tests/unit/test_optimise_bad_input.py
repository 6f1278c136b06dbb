"""Bad input at the library level: a sentence, or a finite plan; never a traceback from within, never NaN."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.errors import InputError
from camrig.geometry.pose import transform
from camrig.messages import Aim, DroneAim, HeadAim, PlanStatus, RigPlan
from camrig.optimise import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    PoseSigma,
    Scene,
    SceneAnchor,
    SceneCamera,
    SceneTarget,
)
from camrig.optimise.scene import Objective, Quality, Visibility
from tests.planner_scenes import BOX, DOWN, LAB, drone, head, solve, targets

NAN, INF = math.nan, math.inf
SCENE = Scene((head("h", 1.0, 1.0), drone("d")), targets((1.5, 1.0), (2.0, 2.0), tag_size_m=0.2))


def check_finite(plan: RigPlan) -> None:
    numbers = [plan.solve_s, *([] if plan.objective_m is None else [plan.objective_m])]
    numbers += [target.quality_m for target in plan.targets.values() if target.quality_m is not None]
    for aim in plan.aims.values():
        numbers += [aim.pan_rad, aim.tilt_rad] if isinstance(aim, HeadAim) else [*aim.position_m, aim.yaw_rad]
    assert all(map(math.isfinite, numbers))
    for target in plan.targets.values():
        assert (target.quality_m is None) == (not target.seen_by)
        assert target.quality_m is None or target.quality_m > 0.0


def with_target(**changes: Any) -> Callable[[], Scene]:
    return lambda: replace(SCENE, targets=(replace(SCENE.targets[0], **changes), SCENE.targets[1]))


def with_settings(**changes: Any) -> Callable[[], Scene]:
    return lambda: replace(SCENE, settings=replace(SCENE.settings, **changes))


def with_place(index: int, **changes: Any) -> Callable[[], Scene]:
    def scene() -> Scene:
        cameras = list(SCENE.cameras)
        cameras[index] = replace(cameras[index], place=replace(cameras[index].place, **changes))
        return replace(SCENE, cameras=tuple(cameras))

    return scene


def with_camera(**changes: Any) -> Callable[[], Scene]:
    return lambda: replace(SCENE, cameras=(replace(SCENE.cameras[0], **changes), SCENE.cameras[1]))


def with_anchor(**changes: Any) -> Callable[[], Scene]:
    return lambda: replace(SCENE, anchors=(replace(SceneAnchor((1.0, 2.0, 0.0), 0.2), **changes),))


ASKEW = np.full((4, 4), NAN)
REFUSED: dict[str, tuple[Callable[[], Scene], str]] = {
    "a target nowhere": (with_target(position_m=(1.0, NAN, 0.0)), "target t0"),
    "a target at infinity": (with_target(position_m=(1.0, INF, 0.0)), "target t0"),
    "a normal that is no number": (with_target(normal=(0.0, NAN, 1.0)), "target t0"),
    "a normal without a length": (with_target(normal=(0.0, 0.0, 0.0)), "target t0"),
    "a facing that is no number": (with_target(facing_rad=NAN), "target t0"),
    "a weight that is no number": (with_target(weight=NAN), "target t0"),
    "no weight": (with_target(weight=0.0), "target t0"),
    "a negative weight": (with_target(weight=-1.0), "target t0"),
    "a reach that is no number": (with_target(reach_m=NAN), "target t0"),
    "a negative reach": (with_target(reach_m=-0.1), "target t0"),
    "a tag without a size": (with_target(tag_size_m=0.0), "target t0"),
    "a negative tag": (with_target(tag_size_m=-0.1), "target t0"),
    "a tag's size that is no number": (with_target(tag_size_m=NAN), "target t0"),
    "a margin that is no number": (with_settings(margin_rad=NAN), "margin_rad"),
    "a separation that is no number": (with_settings(min_separation_m=NAN), "min_separation_m"),
    "a tag limit that is no number": (with_settings(min_tag_px=NAN), "min_tag_px"),
    "an incidence that is no number": (with_settings(max_incidence_rad=NAN), "max_incidence_rad"),
    "a range that is no number": (with_settings(max_range_m=NAN), "max_range_m"),
    "a gain that is no number": (with_settings(gain=NAN), "gain"),
    "limits the wrong way round": (with_place(0, pan_limits_rad=(1.0, -1.0)), "camera h"),
    "limits that are no numbers": (with_place(0, tilt_limits_rad=(NAN, 0.0)), "camera h"),
    "a box that is empty": (with_place(1, box_m=((0.0, 0.0, 1.0), (5.0, -3.0, 2.0))), "camera d"),
    "a box below a metre": (with_place(1, box_m=((0.0, 0.0, 0.0), (5.0, 3.0, 0.9))), "camera d"),
    "an endless box": (with_place(1, box_m=((0.0, 0.0, 1.0), (INF, 3.0, 2.0))), "camera d"),
    "a mounting that is no pose": (with_place(0, T_mount_camera=ASKEW), "camera h"),
    "a drone's camera that is no pose": (with_place(1, T_body_camera=ASKEW), "camera d"),
    "a separation of its own that is no number": (with_place(1, min_separation_m=NAN), "camera d"),
    "an angle of view that is no number": (with_camera(alpha_rad=NAN), "camera h"),
    "a sigma that is no number": (with_camera(pose_sigma=PoseSigma(NAN)), "camera h"),
    "a negative sigma": (with_camera(pose_sigma=PoseSigma(pan_rad=-0.1)), "camera h"),
    "a bolted camera that is no pose": (with_camera(place=FixedPlace(ASKEW)), "camera h"),
    "an anchor nowhere": (with_anchor(position_m=(NAN, 1.0, 0.0)), "anchor"),
    "an anchor without a size": (with_anchor(tag_size_m=0.0), "anchor"),
    "an anchor without a normal": (with_anchor(normal=(0.0, 0.0, 0.0)), "anchor"),
    "a keep-out box that is no box": (
        lambda: replace(SCENE, keep_out_m=(((0.0, NAN, 0.0), (1.0, 1.0, 1.0)),)),
        "keep-out",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_planned_is_refused_by_the_name_of_the_culprit(name: str) -> None:
    build, culprit = REFUSED[name]
    for quality in ("pixel", "fisher"):
        scene = build()
        scene = replace(scene, settings=replace(scene.settings, quality=quality))
        with pytest.raises(InputError, match=culprit):
            solve(scene)


def test_an_aim_that_is_no_number_is_refused_by_its_camera() -> None:
    good: dict[str, Aim] = {"h": HeadAim(0.1, -0.5), "d": DroneAim((1.0, 1.0, 1.5))}
    odd: list[tuple[str, Aim]] = [
        ("h", HeadAim(NAN, -0.5)),
        ("h", HeadAim(0.1, -0.5, NAN)),
        ("d", DroneAim((1.0, NAN, 1.5))),
        ("d", DroneAim((1.0, 1.0, 1.5), NAN)),
    ]
    for name, aim in odd:
        for judge in (solve, optimise.quality_at):
            with pytest.raises(InputError, match=rf"aim of {name}\b"):
                judge(SCENE, {**good, name: aim})


def test_a_proposal_that_is_no_number_is_passed_over() -> None:
    start = solve(SCENE).aims
    odd: dict[str, Aim] = {"h": HeadAim(NAN, -0.5), "d": DroneAim((1.0, 1.0, 1.5))}
    found = optimise.plan(SCENE, start=start, proposals=(odd,), quick=True, now=lambda: 0.0)
    assert found.aims == optimise.plan(SCENE, start=start, quick=True, now=lambda: 0.0).aims


def test_a_missing_aim_is_named() -> None:
    with pytest.raises(InputError, match="no aim is known for d"):
        optimise.quality_at(SCENE, {"h": HeadAim(0.0, -0.5)})


def test_nothing_to_see_or_nothing_to_see_it_with_leaves_the_rig_as_it_is() -> None:
    aims: dict[str, Aim] = {"h": HeadAim(0.1, -0.5)}
    for plan in (solve(replace(SCENE, targets=()), aims), optimise.quality_at(replace(SCENE, targets=()), aims)):
        assert (plan.aims, plan.status, plan.objective_m, plan.uncovered) == (aims, PlanStatus.OPTIMISED, None, ())
    blind = solve(replace(SCENE, cameras=()))
    assert (blind.aims, blind.status, blind.uncovered) == ({}, PlanStatus.PARTIAL, ("t0", "t1"))
    check_finite(blind)


@pytest.mark.parametrize("quality", ["pixel", "fisher", "perspective"])
@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("objective", ["mean", "worst"])
def test_targets_at_the_camera_under_it_and_on_one_spot_give_a_finite_plan(
    quality: Quality, visibility: Visibility, objective: Objective
) -> None:
    spots = {"at camera": (1.0, 1.0, 2.7), "under": (1.0, 1.0, 0.0), "twin": (1.0, 1.0, 0.0), "above": (1.0, 1.0, 9.0)}
    scene = Scene(
        (head("h", 1.0, 1.0), SceneCamera("f", LAB, FixedPlace(transform(np.diag([1.0, -1.0, -1.0]), np.ones(3))))),
        tuple(SceneTarget(name, spot, 0.15) for name, spot in spots.items()),
        PlannerSettings(quality, visibility, objective),
    )
    plan = solve(scene)
    check_finite(plan)
    assert set(plan.uncovered) == {"at camera", "above"}
    assert plan.targets["under"] == plan.targets["twin"]


@pytest.mark.parametrize("visibility", ["cone", "image"])
def test_a_tag_so_near_that_a_corner_is_behind_the_camera_gives_no_nan(visibility: Visibility) -> None:
    for tilt in np.linspace(0.0, 1.5, 16):
        normal = (math.sin(tilt), 0.0, math.cos(tilt))
        tag = SceneTarget("t", (1.0, 1.0, 2.55), 0.5, normal)
        for quality in ("pixel", "fisher"):
            plan = solve(Scene((head("h", 1.0, 1.0),), (tag,), PlannerSettings(quality, visibility)))
            check_finite(plan)


def test_fisher_without_a_tags_size_is_refused() -> None:
    with pytest.raises(InputError, match=r"t1 has no tag_size_m; .*fisher"):
        solve(
            replace(
                SCENE,
                targets=(SCENE.targets[0], replace(SCENE.targets[1], tag_size_m=None)),
                settings=PlannerSettings("fisher"),
            )
        )


def test_limits_that_leave_one_point_are_a_bolted_camera() -> None:
    place = SCENE.cameras[0].place
    assert isinstance(place, HeadPlace)
    stiff = replace(place, pan_limits_rad=(0.0, 0.0), tilt_limits_rad=(-1.2, -1.2))
    plan = solve(Scene((replace(SCENE.cameras[0], place=stiff),), SCENE.targets))
    assert plan.aims == {"h": HeadAim(0.0, -1.2)}
    check_finite(plan)
    spot = DronePlace(DOWN, ((1.0, 1.0, 1.5), (1.0, 1.0, 1.5)))
    plan = solve(Scene((SceneCamera("d", LAB, spot),), SCENE.targets))
    assert plan.aims == {"d": DroneAim((1.0, 1.0, 1.5))}


ODD = st.sampled_from([-10.0, 0.0, 1e-9, 1.0, 2.7, 1e3, 1e9])


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(ODD, ODD, ODD), min_size=1, max_size=4),
    st.sampled_from(["pixel", "fisher", "perspective"]),
    st.sampled_from(["cone", "image"]),
    st.sampled_from([1e-6, 0.2, 50.0]),
    st.sampled_from([1e-9, 1.0, 1e9]),
    st.sampled_from([0.0, 0.5, 2.0]),
)
def test_odd_places_sizes_weights_and_margins_give_a_finite_plan(
    places: list[tuple[float, float, float]],
    quality: Quality,
    visibility: Visibility,
    size_m: float,
    weight: float,
    margin_rad: float,
) -> None:
    tags = tuple(SceneTarget(f"t{k}", place, size_m, weight=weight) for k, place in enumerate(places))
    scene = Scene((head("h", 1.0, 1.0), drone("d")), tags, PlannerSettings(quality, visibility, margin_rad=margin_rad))
    plan = solve(scene)
    check_finite(plan)
    assert all(
        a <= value <= b
        for aim in plan.aims.values()
        if isinstance(aim, DroneAim)
        for a, value, b in zip((0.0, 0.0, 1.0), aim.position_m, BOX[1], strict=True)
    )
