"""The planner's promises: limits, boxes, separation, never worse than the start, the same for the same seed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.errors import InputError
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN
from camrig.geometry.pose import transform
from camrig.messages import Aim, DroneAim, HeadAim, PlanStatus
from camrig.optimise import FixedPlace, PlannerSettings, Scene, SceneCamera, SceneTarget
from camrig.optimise.configuration import configuration
from camrig.optimise.polish import sqp
from camrig.optimise.scene import Visibility
from tests.planner_scenes import LAB, TILT, check_permitted, clock, drone, head, scenes, solve, targets, task


@settings(deadline=None, max_examples=40)
@given(scenes(), st.integers(0, 5))
def test_a_plan_is_permitted_repeatable_honest_and_never_worse_than_its_start(scene: Scene, seed: int) -> None:
    plan = solve(scene, seed=seed)
    check_permitted(scene, plan)
    assert solve(scene, seed=seed).aims == plan.aims
    judged = optimise.quality_at(scene, plan.aims)
    assert judged.targets == plan.targets
    assert judged.objective_m == plan.objective_m
    assert (plan.status is PlanStatus.OPTIMISED) == (not plan.uncovered)
    moved = replace(scene, targets=tuple(_moved(target) for target in scene.targets))
    start = optimise.quality_at(moved, plan.aims)
    again = solve(moved, start=plan.aims, seed=seed + 1)
    check_permitted(moved, again)
    assert (len(again.uncovered), again.objective_m or 0.0) <= (len(start.uncovered), start.objective_m or 0.0)


def _moved(target: SceneTarget) -> SceneTarget:
    x, y, z = target.position_m
    return replace(target, position_m=(x + 0.1, y - 0.05, z))


def test_a_scene_without_targets_or_cameras_stays_as_it_is() -> None:
    aims: dict[str, Aim] = {"h": HeadAim(0.1, -0.5)}
    nothing = solve(Scene((head("h", 1.0, 1.0),), ()), aims)
    assert (nothing.aims, nothing.status, nothing.objective_m) == (aims, PlanStatus.OPTIMISED, None)
    blind = solve(Scene((), targets((1.0, 1.0))))
    assert (blind.aims, blind.status, blind.uncovered) == ({}, PlanStatus.PARTIAL, ("t0",))


def test_hard_input_is_named_in_the_answer_and_gives_no_nan() -> None:
    camera = head("h", 1.0, 1.0)
    places = (
        SceneTarget("under", (1.0, 1.0, 0.0)),
        SceneTarget("twin", (1.0, 1.0, 0.0)),
        SceneTarget("at_camera", (1.0, 1.0, 2.7)),
        SceneTarget("above", (1.0, 1.0, 5.0)),
    )
    plan = solve(Scene((camera,), places))
    assert plan.status is PlanStatus.PARTIAL
    assert plan.uncovered == ("at_camera", "above")
    assert all(math.isfinite(target.quality_m) for target in plan.targets.values() if target.quality_m is not None)


def test_drones_that_cannot_keep_apart_are_refused_with_a_sentence() -> None:
    scene = Scene((drone("a", 9.0), drone("b", 9.0)), targets((1.0, 1.0)))
    with pytest.raises(InputError, match="min_separation_m"):
        solve(scene)


def test_a_drone_covers_from_outside_the_box_that_it_may_not_enter() -> None:
    box = ((1.5, 0.5, 0.0), (2.5, 1.5, 3.0))
    scene = Scene((drone("d"),), (SceneTarget("t", (2.0, 1.0, 3.0)),), keep_out_m=(box,))
    assert solve(scene).uncovered == ("t",)
    low = replace(scene, targets=targets((1.2, 1.0)))
    plan = solve(low)
    check_permitted(low, plan)
    assert plan.uncovered == ()


def test_what_a_box_hides_is_not_covered() -> None:
    wall = ((2.0, 0.0, 0.0), (2.2, 3.0, 2.6))
    scene = Scene((head("h", 1.0, 1.5),), targets((1.5, 1.5), (2.5, 1.5)), keep_out_m=(wall,))
    assert solve(scene).uncovered == ("t1",)


def test_heavier_targets_are_covered_first() -> None:
    low_head = head("h", 2.5, 1.5, z=1.0)
    west, east = (0.2, 1.5), (4.8, 1.5)
    scene = Scene((low_head,), targets(west, east))
    for heavy in (0, 1):
        weighed = tuple(replace(t, weight=2.0 if i == heavy else 1.0) for i, t in enumerate(scene.targets))
        assert solve(replace(scene, targets=weighed)).uncovered == (f"t{1 - heavy}",)


def test_a_bolted_camera_counts_and_is_not_moved() -> None:
    T = transform(R_BODY_OPTICAL_DOWN, np.array([1.0, 1.0, 2.5]))
    fixed = SceneCamera("f", LAB, FixedPlace(T))
    plan = solve(Scene((fixed,), targets((1.0, 1.0), (4.5, 2.5))))
    assert (plan.aims, plan.uncovered) == ({}, ("t1",))
    both = solve(Scene((fixed, head("h", 4.0, 2.0)), targets((1.0, 1.0), (4.5, 2.5))))
    assert both.uncovered == ()
    assert "f" in both.targets["t0"].seen_by


def test_identical_drones_do_not_swap() -> None:
    scene = Scene((drone("a", 0.8), drone("b", 0.8)), targets((0.5, 0.5), (4.5, 2.5)))
    first = solve(scene)
    for seed in range(4):
        again = solve(scene, start={"a": first.aims["b"], "b": first.aims["a"]}, seed=seed)
        assert _near(again.aims["a"], first.aims["b"])
        assert _near(again.aims["b"], first.aims["a"])


def _near(one: Aim, other: Aim) -> bool:
    assert isinstance(one, DroneAim)
    assert isinstance(other, DroneAim)
    return math.dist(one.position_m, other.position_m) < 1e-3


def test_running_aims_stay_exactly_unless_moving_is_worth_it() -> None:
    scene = Scene(
        (head("a", 0.5, 0.5), head("b", 4.5, 2.5)),
        targets((1.0, 1.0), (2.0, 2.0), (3.5, 2.0)),
        PlannerSettings(visibility="image", margin_rad=0.02, gain=0.02),
    )
    best = solve(scene)
    nearly: dict[str, Aim] = {}
    for name, aim in best.aims.items():
        assert isinstance(aim, HeadAim)
        nearly[name] = HeadAim(aim.pan_rad + 0.004, aim.tilt_rad + 0.004)
    stays = solve(scene, nearly)
    assert all(stays.aims[name] is aim for name, aim in nearly.items())
    astray = {**nearly, "a": HeadAim(2.5, -0.2)}
    comes = solve(scene, astray)
    assert comes.objective_m is not None
    assert best.objective_m is not None
    assert comes.objective_m <= best.objective_m * 1.011
    assert comes.aims["b"] is nearly["b"]
    assert comes.aims["a"] != astray["a"]


def test_an_aim_outside_the_limits_comes_back_inside() -> None:
    scene = Scene((head("h", 1.0, 1.0),), targets((1.5, 1.2)), PlannerSettings(gain=0.5))
    aim = solve(scene, {"h": HeadAim(0.4, -2.0)}).aims["h"]
    assert isinstance(aim, HeadAim)
    assert TILT[0] <= aim.tilt_rad <= TILT[1]


def test_more_time_never_gives_a_worse_plan_and_no_time_still_gives_one() -> None:
    scene = Scene(tuple(head(f"h{i}", 1.0 + i, 1.5) for i in range(3)), targets((1, 1), (2, 2.5), (4, 1), (4.5, 2.8)))
    start: dict[str, Aim] = {f"h{i}": HeadAim(0.0, -0.2) for i in range(3)}
    hurried = optimise.plan(scene, start=start, deadline_s=0.0, now=clock(1.0))
    assert hurried.aims == start
    results = [
        optimise.plan(scene, start=start, deadline_s=deadline_s, now=clock(0.001)) for deadline_s in (0.02, 0.1, 100.0)
    ]
    ranks = [(len(plan.uncovered), plan.objective_m or 0.0) for plan in (hurried, *results)]
    assert ranks == sorted(ranks, reverse=True)


@pytest.mark.parametrize("visibility", ["cone", "image"])
def test_the_smooth_problem_agrees_with_the_hard_one_where_it_starts(visibility: Visibility) -> None:
    settings_ = PlannerSettings(visibility=visibility, min_separation_m=0.5)
    whole = task(
        Scene((head("h", 1.0, 1.0), drone("d"), drone("e")), targets((1, 1), (2, 2), tag_size_m=0.1), settings_)
    )
    vectors = np.array([[1.0, 1.0, 2.7, 0.7, -1.0, 0.0], [1.2, 1.1, 1.9, 0, 0, 0], [2.2, 2.1, 1.5, 0, 0, 0]])
    here = configuration(whole, vectors)
    assert here.score.uncovered == 0.0
    reached = sqp(whole, here, lambda: False)
    assert reached.score.uncovered == 0.0
    assert reached.score.quality_m < here.score.quality_m
