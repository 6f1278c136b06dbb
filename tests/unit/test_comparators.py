"""The comparators: inside their limits, repeatable, in time, judged alike, and none better than camrig."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import InputError
from camrig.experiments.scenes import LAB_LENS, PAN_RAD, TILT_RAD, Mode, random_scene
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.messages import DroneAim, HeadAim, RigPlan
from camrig.optimise import HeadPlace, PlannerSettings, Scene, SceneCamera, quality_at
from camrig.optimise.comparators.common import Asked, free_variables, random_rig
from camrig.optimise.comparators.graph import graph_of
from camrig.optimise.comparators.ipopt import load_casadi
from camrig.optimise.configuration import configuration, empty_rows, empty_sums, task_of
from camrig.optimise.kernels.problem import Ints, Problem
from camrig.optimise.kernels.smoothed import smoothed
from camrig.optimise.kernels.swarm import Range, score_of
from camrig.optimise.places import bounds, vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Objective, Quality, Visibility, ZoomStep
from camrig.optimise.solvers import SOLVERS, Solution, Solver, solve

COMPARATORS = SOLVERS[1:]
PTZ: Mode = "ptz"
DRONE: Mode = "drone"


def still() -> float:
    return 0.0


def settings(visibility: Visibility = "cone", objective: Objective = "mean") -> PlannerSettings:
    return PlannerSettings(visibility=visibility, objective=objective)


def worth(plan: RigPlan) -> tuple[int, float]:
    return len(plan.uncovered), math.inf if plan.objective_m is None else plan.objective_m


def check_sound(scene: Scene, plan: RigPlan) -> None:
    """Every camera has a finite aim inside its limits, and the plan says what that aim is really worth."""
    for camera in scene.cameras:
        vector = vector_of(camera, plan.aims[camera.id])
        low, high = bounds(camera.place)
        high[-1] = max(0, len(camera.zoom) - 1)
        assert vector is not None
        assert np.isfinite(vector).all()
        assert (vector >= low - 1e-12).all()
        assert (vector <= high + 1e-12).all()
    judged = quality_at(scene, plan.aims)
    assert judged.uncovered == plan.uncovered
    assert judged.objective_m == pytest.approx(plan.objective_m, rel=1e-12)
    assert all(math.isfinite(each.quality_m) for each in plan.targets.values() if each.quality_m is not None)


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("mode", [PTZ, DRONE])
@pytest.mark.parametrize("name", COMPARATORS)
def test_plans_are_sound_and_the_same_for_a_seed(name: Solver, mode: Mode, visibility: Visibility) -> None:
    scene = random_scene(mode, 3, 4, 5, settings(visibility))
    once, again = (solve(name, scene, seed=3, now=still) for _ in range(2))
    check_sound(scene, once.plan)
    assert once.permitted
    assert again.plan == once.plan


@pytest.mark.parametrize("name", ["slsqp", "ipopt", "swarm"])
def test_the_seed_is_the_start(name: Solver) -> None:
    scene = random_scene(DRONE, 3, 4, 5, settings())
    assert len({repr(solve(name, scene, seed=seed, now=still).plan.aims) for seed in range(3)}) > 1


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("name", ["slsqp", "ipopt", "swarm"])
def test_tags_and_the_worst_target_are_planned_too(name: Solver, visibility: Visibility) -> None:
    scene = random_scene(PTZ, 3, 4, 6, settings(visibility, "worst"), tag_size_m=0.16)
    held = solve("hold", scene, now=still).plan
    plans = [solve(name, scene, seed=seed, now=still).plan for seed in range(3)]
    for plan in plans:
        check_sound(scene, plan)
    # One random start may well end worse than a rig that merely looks at the middle.
    assert min(map(worth, plans)) < worth(held)


@pytest.mark.parametrize(("mode", "seed"), list(itertools.product([PTZ, DRONE], range(3))))
def test_camrig_is_never_worse(mode: Mode, seed: int) -> None:
    for chosen in (settings("cone", "mean"), settings("image", "worst")):
        scene = random_scene(mode, 3, 5, seed, chosen)
        missed, value_m = worth(solve("camrig", scene, now=still).plan)
        for name in COMPARATORS:
            other = worth(solve(name, scene, seed=seed, now=still).plan)
            assert (missed, value_m) <= (other[0], other[1] * (1.0 + 1e-6)), (name, chosen)


class CountedClock:
    """A clock that goes on by a second whenever somebody looks at it."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        self.now_s += 1.0
        return self.now_s


@pytest.mark.parametrize("name", COMPARATORS)
@pytest.mark.parametrize("deadline_s", [0.5, 12.5])
def test_the_deadline_ends_the_search_with_the_best_so_far(name: Solver, deadline_s: float) -> None:
    clock = CountedClock()
    scene = random_scene(DRONE, 4, 8, 2, settings())
    found = solve(name, scene, deadline_s=deadline_s, seed=1, now=clock)
    check_sound(scene, found.plan)
    # After the deadline nobody looks more often than it takes to leave a loop or two, and to tell the time it took.
    assert clock.now_s <= deadline_s + 6.0


@pytest.mark.parametrize("name", COMPARATORS)
def test_a_deadline_far_away_changes_nothing(name: Solver) -> None:
    scene = random_scene(PTZ, 3, 4, 2, settings())
    assert solve(name, scene, deadline_s=1.0, now=still).plan == solve(name, scene, now=still).plan


def test_building_is_told_apart_from_solving() -> None:
    clock = ManualClock(0.0)
    found = solve("ipopt", random_scene(PTZ, 2, 3, 1), now=clock.now_s)
    assert (found.build_s, found.plan.solve_s) == (0.0, 0.0)
    counting = CountedClock()
    counted = solve("ipopt", random_scene(PTZ, 2, 3, 1), now=counting)
    assert counted.build_s == 1.0
    assert counted.build_s + counted.plan.solve_s == counting.now_s - 1.0


def test_ipopt_without_casadi_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(InputError, match=r"pip install 'camrig\[ipopt\]'"):
        solve("ipopt", random_scene(PTZ, 2, 3, 1), now=still)


def test_ipopt_refuses_what_it_has_no_graph_of() -> None:
    scene = random_scene(PTZ, 2, 3, 1, PlannerSettings(quality="fisher"), tag_size_m=0.16)
    with pytest.raises(InputError, match="'fisher'"):
        solve("ipopt", scene, now=still)
    fisheye = FisheyeLens((1280, 800), (400.0, 400.0), (640.0, 400.0))
    curved = random_scene(PTZ, 2, 3, 1)
    with pytest.raises(InputError, match="fisheye"):
        solve("ipopt", replace(curved, cameras=tuple(replace(c, lens=fisheye) for c in curved.cameras)), now=still)


@pytest.mark.parametrize("name", [name for name in COMPARATORS if name != "ipopt"])
def test_the_others_plan_the_fisher_quality(name: Solver) -> None:
    scene = random_scene(PTZ, 2, 3, 1, PlannerSettings(quality="fisher", visibility="image"), tag_size_m=0.16)
    check_sound(scene, solve(name, scene, now=still).plan)


@pytest.mark.parametrize("name", COMPARATORS)
def test_nothing_to_do_and_nothing_to_move_are_no_trouble(name: Solver) -> None:
    scene = random_scene(PTZ, 2, 3, 1)
    assert solve(name, replace(scene, targets=()), now=still).plan.uncovered == ()
    assert len(solve(name, replace(scene, cameras=()), now=still).plan.uncovered) == 3
    frozen = replace(scene, cameras=tuple(at_rest(camera) for camera in scene.cameras))
    check_sound(frozen, solve(name, frozen, now=still).plan)


def at_rest(camera: SceneCamera) -> SceneCamera:
    assert isinstance(camera.place, HeadPlace)
    return replace(camera, place=replace(camera.place, pan_limits_rad=(0.1, 0.1), tilt_limits_rad=(-1.5, -1.5)))


def test_who_may_not_be_there_is_told_and_swarm_and_greedy_keep_apart() -> None:
    scene = random_scene(DRONE, 3, 5, 1, PlannerSettings(min_separation_m=1.5))
    found: dict[Solver, Solution] = {name: solve(name, scene, seed=2, now=still) for name in COMPARATORS}
    assert found["swarm"].permitted
    assert found["greedy"].permitted
    for each in found.values():
        at = [aim.position_m[:2] for aim in each.plan.aims.values() if isinstance(aim, DroneAim)]
        apart = all(math.dist(a, b) >= 1.5 - 1e-9 for a, b in itertools.combinations(at, 2))
        assert each.permitted == apart


def test_held_heads_look_at_the_middle_of_the_targets() -> None:
    scene = random_scene(PTZ, 1, 4, 3)
    (aim,) = solve("hold", scene, now=still).plan.aims.values()
    (camera,) = scene.cameras
    assert isinstance(aim, HeadAim)
    assert isinstance(camera.place, HeadPlace)
    x, y, z = np.mean([t.position_m for t in scene.targets], axis=0) - camera.place.kinematics.T_world_base[:3, 3]
    assert (aim.pan_rad, aim.tilt_rad) == pytest.approx((math.atan2(y, x), math.atan2(z, math.hypot(x, y))))


# The smooth problem: kernel and graph say the same, and with a sharp visibility what the hard one says.

BENT_LENS = BrownLens((1280, 800), (820.0, 830.0), (630.0, 410.0), (-0.3, 0.1, 2e-3, -1e-3, 0.01, 0.02, 0.01, 0.0))
LONG_LENS = replace(BENT_LENS, focal_px=(1600.0, 1610.0), distortion=(-0.1,) + (0.0,) * 7)


def mixed_scene(quality: Quality, visibility: Visibility) -> Scene:
    """A head whose camera is mounted askew and zooms, a drone, and tags that may move, with a margin."""
    askew = PanTilt(transform(np.eye(3), np.array([1.0, 1.0, 2.7])), transform(np.eye(3), np.array([0.02, 0.01, 0.05])))
    place = HeadPlace(askew, transform(R_MOUNT_OPTICAL, np.array([0.03, 0.0, -0.01])), PAN_RAD, TILT_RAD)
    zoom = (ZoomStep(0.0, BENT_LENS), ZoomStep(0.5, LAB_LENS), ZoomStep(1.0, LONG_LENS))
    drones = random_scene(DRONE, 2, 5, 8, tag_size_m=0.2)
    return Scene(
        cameras=(SceneCamera("h", BENT_LENS, place, zoom=zoom), *drones.cameras),
        targets=tuple(replace(target, reach_m=0.05) for target in drones.targets),
        settings=PlannerSettings(quality=quality, visibility=visibility, margin_rad=0.02),
    )


def columns_of(problem: Problem) -> Ints:
    free = free_variables(problem)
    return np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1).astype(np.int64)


@pytest.fixture
def draws() -> Callable[[Problem], list[Array]]:
    return lambda problem: [random_rig(problem, np.random.default_rng(seed)) for seed in range(12)]


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("quality", ["pixel", "perspective"])
def test_the_graph_is_the_kernel(
    quality: Quality, visibility: Visibility, draws: Callable[[Problem], list[Array]]
) -> None:
    casadi = load_casadi()
    problem = problem_of(mixed_scene(quality, visibility))
    free, column = free_variables(problem), columns_of(problem)
    size = int(free.sum())
    graph = graph_of(casadi, problem, draws(problem)[0])
    out = casadi.vertcat(*graph.quality_m, *graph.view)
    inputs = [graph.variables, graph.sharpness, graph.unseen_m]
    evaluate = casadi.Function("evaluate", inputs, [out, casadi.jacobian(out, graph.variables)])
    for vectors in draws(problem):
        found, slopes = (np.array(each) for each in evaluate(vectors[free], 20.0, 0.5))
        value, gradient, view, view_gradient = smoothed(problem, vectors, column, size, 20.0, 0.5)
        assert found[:, 0] == pytest.approx(np.concatenate([value, view]), rel=1e-9)
        assert slopes == pytest.approx(np.vstack([gradient, view_gradient]), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("quality", ["pixel", "perspective", "fisher"])
def test_a_sharp_visibility_is_the_hard_one(
    quality: Quality, visibility: Visibility, draws: Callable[[Problem], list[Array]]
) -> None:
    problem = problem_of(mixed_scene(quality, visibility))
    task, column = task_of(problem, worst=False), columns_of(problem)
    size = int(free_variables(problem).sum())
    compared = 0
    for vectors in draws(problem):
        here = configuration(task, vectors)
        seen, exact = here.seen(), here.quality_m
        covered = seen.any(axis=0)
        value, _, view, _ = smoothed(problem, vectors, column, size, 1e6, math.inf)
        assert value[covered] == pytest.approx(exact[covered], rel=1e-6)
        assert (np.round(np.exp(view)) == seen.sum(axis=0)).all()
        compared += int(covered.sum())
    assert compared > 20


@pytest.mark.parametrize("objective", ["mean", "worst"])
def test_the_swarm_is_judged_by_the_hard_objective(objective: Objective) -> None:
    scene = random_scene(PTZ, 2, 4, 1, settings("cone", objective))
    problem = problem_of(replace(scene, targets=tuple(replace(t, weight=k + 1.0) for k, t in enumerate(scene.targets))))
    task = task_of(problem, worst=objective == "worst")
    camera, variable = (part.astype(np.int64) for part in np.nonzero(free_variables(problem)))
    low, high = problem.low[camera, variable], problem.high[camera, variable]
    span = Range(camera, variable, low, high, np.zeros(len(low), dtype=np.bool_))
    for seed in range(5):
        vectors = random_rig(problem, np.random.default_rng(seed))
        place, room = vectors[camera, variable], (empty_rows(task), empty_sums(task, 0.0), vectors.copy())
        assert score_of(problem, *room, place, span, task.worst) == pytest.approx(configuration(task, vectors).score)


def test_random_rigs_look_at_targets() -> None:
    scene = random_scene(PTZ, 7, 20, 1)
    task = task_of(problem_of(scene), worst=False)
    asked = Asked(scene, task, np.random.default_rng(1), still, math.inf)
    assert configuration(task, random_rig(task.problem, asked.rng)).seen().any(axis=1).all()
