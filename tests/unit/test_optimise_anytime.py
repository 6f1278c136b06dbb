"""On line: a clock that runs out, starts, hysteresis, motion costs, quick plans and proposals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.messages import Aim, DroneAim, HeadAim, PlanStatus, RigPlan
from camrig.optimise import Motion, PlannerSettings, Scene
from camrig.optimise.scene import Objective, Visibility
from tests.planner_scenes import (
    at,
    check_permitted,
    clock,
    drone,
    head,
    jittered,
    rank,
    room_scene,
    scenes,
    solve,
    targets,
    under,
)


def quick(scene: Scene, start: Mapping[str, Aim], proposals: tuple[Mapping[str, Aim], ...] = ()) -> RigPlan:
    return optimise.plan(scene, start=start, proposals=proposals, quick=True, now=lambda: 0.0)


def shifted(aims: Mapping[str, Aim], by: float) -> dict[str, Aim]:
    """Every camera a little aside of where it is."""
    out: dict[str, Aim] = {}
    for name, aim in aims.items():
        if isinstance(aim, HeadAim):
            out[name] = HeadAim(aim.pan_rad + by, aim.tilt_rad - by)
        elif isinstance(aim, DroneAim):
            x, y, z = aim.position_m
            out[name] = DroneAim((x + by, y - by, z), aim.yaw_rad)
    return out


@settings(deadline=None, max_examples=20)
@given(scenes(), st.integers(0, 3))
def test_when_time_is_up_at_once_there_is_a_plan_and_with_a_start_it_is_the_start(scene: Scene, seed: int) -> None:
    hurried = optimise.plan(scene, deadline_s=0.0, seed=seed, now=clock(1.0))
    check_permitted(scene, hurried)
    assert hurried.status in {PlanStatus.OPTIMISED, PlanStatus.PARTIAL}  # no time for a proof either
    again = optimise.plan(scene, start=hurried.aims, deadline_s=0.0, seed=seed, now=clock(1.0))
    assert again.aims == hurried.aims
    assert all(again.aims[name] is aim for name, aim in hurried.aims.items())


@pytest.mark.parametrize("objective", ["mean", "worst"])
@pytest.mark.parametrize("step_s", [1e-4, 1e-3, 1e-2])
def test_whenever_time_runs_out_the_plan_is_no_worse_than_the_start(objective: Objective, step_s: float) -> None:
    for seed in range(4):
        scene = room_scene(2, 2, 8, seed, PlannerSettings(objective=objective, min_separation_m=0.5))
        start = shifted(solve(scene).aims, 0.05)
        if not all(math.dist(a.position_m[:2], b.position_m[:2]) >= 0.5 for a, b in [drones_of(start)]):
            continue
        before = optimise.quality_at(scene, start)
        for fast in (False, True):
            plan = optimise.plan(scene, start=start, quick=fast, deadline_s=0.1, seed=seed, now=clock(step_s))
            assert rank(plan) <= rank(before)


def drones_of(aims: Mapping[str, Aim]) -> tuple[DroneAim, ...]:
    return tuple(aim for aim in aims.values() if isinstance(aim, DroneAim))


def test_a_plan_says_how_long_it_took_and_when_it_began() -> None:
    plan = optimise.plan(Scene((head("h", 1.0, 1.0),), targets((1.0, 1.5))), now=clock(0.5))
    assert plan.stamp_s == 0.0
    assert plan.solve_s > 0.0


@settings(deadline=None, max_examples=10)
@given(scenes(), st.integers(0, 9))
def test_a_seed_decides_everything(scene: Scene, seed: int) -> None:
    start = solve(scene, seed=99).aims
    for first, second in (
        (solve(scene, seed=seed), solve(scene, seed=seed)),
        (quick(scene, start), quick(scene, start)),
    ):
        assert first == second


@settings(deadline=None, max_examples=15)
@given(scenes(), st.floats(0.0, 0.1), st.sampled_from(["mean", "worst"]))
def test_a_quick_plan_covers_what_was_covered_and_is_no_worse(
    scene: Scene, moved_m: float, objective: Objective
) -> None:
    scene = under(scene, objective=objective)
    start = solve(scene).aims
    later = jittered(scene, moved_m, 1)
    before, plan = optimise.quality_at(later, start), quick(later, start)
    check_permitted(later, plan)
    # Where not all can be covered, another target of the same weight may be the one that is left out.
    assert len(plan.uncovered) <= len(before.uncovered)
    assert rank(plan) <= rank(before)


@pytest.mark.parametrize("visibility", ["cone", "image"])
def test_a_quick_plan_is_nearly_as_good_as_a_cold_one(visibility: Visibility) -> None:
    gaps = []
    for seed in range(6):
        scene = room_scene(4, 0, 8, seed, PlannerSettings(visibility=visibility))
        later = jittered(scene, 0.1, seed)
        warm, cold = quick(later, solve(scene).aims), solve(later)
        assert len(warm.uncovered) <= len(cold.uncovered)
        gaps.append((warm.objective_m or 0.0) / (cold.objective_m or 1.0) - 1.0)
    assert sum(gaps) / len(gaps) <= 0.02


def test_a_quick_plan_that_would_leave_a_target_unseen_looks_everywhere() -> None:
    scene = Scene((head("h", 2.5, 1.5),), targets((4.5, 2.5)), PlannerSettings(visibility="image"))
    away: dict[str, Aim] = {"h": HeadAim(-2.5, -0.4)}
    assert optimise.quality_at(scene, away).uncovered == ("t0",)
    assert quick(scene, away).uncovered == ()


TWO_ROOMS = Scene(
    (drone("a", 0.5), drone("b", 0.5)), targets((0.6, 0.6), (1.2, 0.8), (3.8, 2.2), (4.4, 2.5)), PlannerSettings()
)


def test_a_proposal_is_followed_only_if_it_is_clearly_better() -> None:
    """A quick plan follows what was found elsewhere for more than 2.5 %, not for less."""
    followed, passed_over = 0, 0
    for seed in range(12):
        scene = room_scene(3, 0, 7, seed, PlannerSettings(visibility="image"))
        best, start = solve(scene), solve(replace(scene, targets=room_scene(3, 0, 7, seed + 100).targets)).aims
        alone, offered = quick(scene, start), quick(scene, start, (best.aims,))
        assert alone.uncovered == best.uncovered == ()
        missing = (alone.objective_m or 0.0) / (best.objective_m or 1.0) - 1.0
        if missing > 0.03:
            assert (offered.objective_m or 0.0) <= (best.objective_m or 0.0) * (1.0 + 1e-6)
            followed += 1
        elif missing < 0.02:
            assert offered.aims == alone.aims
            passed_over += 1
    assert followed >= 3
    assert passed_over >= 2


def test_a_proposal_that_is_not_permitted_or_not_whole_is_passed_over() -> None:
    best = solve(TWO_ROOMS)
    together: dict[str, Aim] = {"a": DroneAim((2.5, 1.5, 2.5)), "b": DroneAim((2.6, 1.5, 2.5))}
    for useless in (together, {"a": DroneAim((1.0, 1.0, 2.0))}, {}):
        assert quick(TWO_ROOMS, best.aims, (useless,)).aims == quick(TWO_ROOMS, best.aims).aims


HEADS = Scene(
    (head("a", 0.5, 0.5), head("b", 4.5, 2.5)),
    targets((1.0, 1.0), (2.0, 2.0), (3.5, 2.0)),
    PlannerSettings(visibility="image", margin_rad=0.02),
)


def test_nobody_moves_for_less_than_the_gain() -> None:
    best = solve(HEADS)
    for by in (0.002, 0.01, 0.03):
        start = shifted(best.aims, by)
        here = optimise.quality_at(HEADS, start)
        if here.uncovered:
            continue
        missing = 1.0 - (best.objective_m or 0.0) / (here.objective_m or 1.0)
        for gain, moves in ((missing * 1.5, False), (missing * 0.5, True)):
            plan = solve(under(HEADS, gain=gain), start)
            assert (dict(plan.aims) != start) == moves


def test_motion_must_bring_its_cost_by_how_long_it_takes() -> None:
    best = solve(HEADS)
    start = shifted(best.aims, 0.03)
    here = optimise.quality_at(HEADS, start)
    assert here.uncovered == ()
    missing = 1.0 - (best.objective_m or 0.0) / (here.objective_m or 1.0)
    assert missing > 0.0

    def moves(cost_per_s: float, speed: float) -> bool:
        motion = Motion(cost_per_s, {"a": speed, "b": speed})
        plan = optimise.plan(HEADS, start=start, motion=motion, now=lambda: 0.0)
        return dict(plan.aims) != start

    # A head turns 0.03 rad: at 1 rad/s that is 0.03 s.
    assert moves(0.1 * missing / 0.06, 1.0)
    assert not moves(10.0 * missing / 0.03, 1.0)
    assert moves(10.0 * missing / 0.03, 1000.0)  # the same cost a second, but it is there at once


def test_a_camera_whose_move_hardly_matters_stays_exactly() -> None:
    best = solve(HEADS)
    start = dict(best.aims)
    a = best.aims["a"]
    assert isinstance(a, HeadAim)
    start["a"] = HeadAim(2.5, -0.2)
    b = best.aims["b"]
    assert isinstance(b, HeadAim)
    start["b"] = HeadAim(b.pan_rad + 1e-4, b.tilt_rad)
    plan = solve(under(HEADS, gain=0.02), start)
    assert plan.aims["b"] is start["b"]
    assert plan.aims["a"] != start["a"]


def test_coverage_moves_whatever_the_gain_and_the_cost() -> None:
    start: dict[str, Aim] = {"a": HeadAim(2.5, -0.2), "b": HeadAim(0.0, -0.2)}
    assert optimise.quality_at(HEADS, start).uncovered
    motion = Motion(1e6, {"a": 0.1, "b": 0.1})
    plan = optimise.plan(under(HEADS, gain=0.9), start=start, motion=motion, now=lambda: 0.0)
    assert plan.uncovered == ()


def test_a_start_that_is_not_permitted_is_no_start() -> None:
    together: dict[str, Aim] = {"a": DroneAim((2.5, 1.5, 2.5)), "b": DroneAim((2.6, 1.5, 2.5))}
    plan = solve(under(TWO_ROOMS, gain=0.99), together)
    check_permitted(under(TWO_ROOMS, min_separation_m=0.5), plan)
    assert at(TWO_ROOMS, plan.aims).score.uncovered == 0.0
