"""At scale: reach lists, sparse rows and dirty flags lose nothing that looking at everything would find."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp
from camrig.optimise import FixedPlace, PlannerSettings, Scene, SceneCamera, SceneTarget
from camrig.optimise.configuration import configuration, empty_sums, task_of
from camrig.optimise.kernels.descent import Table, begin, descend
from camrig.optimise.kernels.problem import Ints, Problem
from camrig.optimise.kernels.state import Sums, apply, fused
from camrig.optimise.kernels.table import rows_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Objective, Quality, Visibility
from camrig.optimise.search import table_of
from tests.lenses import LAB, PRISM
from tests.planner_scenes import at, check_permitted, drone, head, room_scene, shown, solve, task, under

PINCUSHION = BrownLens((1280, 800), (600.0, 600.0), (640.0, 400.0), (0.25, 0.0, 0.0, 0.0))
LENSES = {"lab": LAB, "prism": PRISM, "pincushion": PINCUSHION}


@pytest.mark.parametrize("name", LENSES)
@settings(deadline=None, max_examples=40)
@given(
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    direction=st.tuples(*[st.floats(-1.0, 1.0)] * 2),
    range_share=st.floats(0.9, 1.1),
    limit_px=st.sampled_from([0.0, 8.0, 20.0]),
    max_range_m=st.sampled_from([2.0, 6.0, math.inf]),
    size_m=st.sampled_from([0.1, 0.3]),
)
def test_what_a_camera_may_see_is_among_what_it_can_reach(
    name: str,
    turn: tuple[float, float, float],
    direction: tuple[float, float],
    range_share: float,
    limit_px: float,
    max_range_m: float,
    size_m: float,
) -> None:
    """Tags about as far away as the limits allow, square to the line of sight, wherever they are in the picture."""
    lens = LENSES[name]
    R = rotation_exp(np.array(turn))
    ray = np.array([*(np.array(direction) * lens.r_max * 0.7), 1.0])
    ray /= np.linalg.norm(ray)
    limits = [focal * size_m / limit_px for focal in lens.focal_px if limit_px > 0.0] + [max_range_m]
    limit_m = min(min(limits) if math.isfinite(min(limits)) else 5.0, 1e3)
    tags = [
        SceneTarget(f"t{k}", tuple((R @ ray * limit_m * share).tolist()), size_m, tuple((-R @ ray).tolist()))
        for k, share in enumerate((0.5 * range_share, range_share, 2.0 * range_share, 4.0 * range_share))
    ]
    camera = SceneCamera("f", lens, FixedPlace(transform(R, np.zeros(3))))
    wanted = PlannerSettings(visibility="image", min_tag_px=limit_px, max_range_m=max_range_m)
    whole = task(Scene((camera,), tuple(tags), wanted))
    seen = set(np.flatnonzero(shown(whole.problem, 0, whole.problem.low)[0]).tolist())
    assert seen <= set(whole.reachable.tolist())


@settings(deadline=None, max_examples=20)
@given(
    seed=st.integers(0, 1000),
    max_range_m=st.sampled_from([1.5, 3.0, math.inf]),
    limit_px=st.sampled_from([0.0, 30.0, 60.0]),
    tagged=st.booleans(),
)
def test_reach_lists_hold_all_that_any_vector_sees(
    seed: int, max_range_m: float, limit_px: float, tagged: bool
) -> None:
    scene = room_scene(2, 2, 15, seed, tag_size_m=0.1 if tagged else None)
    whole = task(under(scene, visibility="image", max_range_m=max_range_m, min_tag_px=limit_px))
    rng = np.random.default_rng(seed)
    problem = whole.problem
    for i in range(len(scene.cameras)):
        vectors = rng.uniform(problem.low[i], problem.high[i], (300, 6))
        reached = whole.reachable[whole.reach_ends[i] : whole.reach_ends[i + 1]]
        seen = np.flatnonzero(shown(problem, i, vectors).any(axis=0))
        assert set(seen.tolist()) <= set(reached.tolist())
        # The rows over the reach list are those over all targets.
        everything = rows_of(problem, i, vectors, np.arange(len(problem.points)))
        for one, other in zip(rows_of(problem, i, vectors, reached), everything, strict=True):
            np.testing.assert_array_equal(one, other)
        # And it is a list of what is near, not of everything.
        if max_range_m == 1.5:
            far = np.linalg.norm(problem.points - (problem.low[i, :3] + problem.high[i, :3]) / 2.0, axis=1)
            span = np.linalg.norm(problem.high[i, :3] - problem.low[i, :3]) / 2.0
            assert (far[reached] <= 1.5 + span + 1e-9).all()


def test_watchers_are_the_reach_lists_the_other_way_round() -> None:
    whole = task(under(room_scene(3, 2, 20, 4), max_range_m=3.0))
    pairs = {(i, int(j)) for i in range(5) for j in whole.reachable[whole.reach_ends[i] : whole.reach_ends[i + 1]]}
    others = {(int(i), j) for j in range(20) for i in whole.watchers[whole.watch_ends[j] : whole.watch_ends[j + 1]]}
    assert pairs == others
    assert 0 < len(pairs) < 100


def dense_quality(problem: Problem, vectors: Array) -> Array:
    """The fused qualities (m,), every camera looking at every target."""
    count = len(problem.points)
    sums = empty_sums(task_of(problem, worst=False), 0.0)
    for i, u in enumerate(vectors):
        _, targets, worths = rows_of(problem, i, u[None], np.arange(count))
        apply(sums, targets, worths, 0, len(targets), 1)
    return fused(sums)


@pytest.mark.parametrize("quality", ["pixel", "fisher", "perspective"])
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 1000), st.sampled_from([2.0, math.inf]))
def test_sparse_and_dense_evaluation_agree(quality: Quality, seed: int, max_range_m: float) -> None:
    scene = room_scene(3, 2, 12, seed, PlannerSettings(quality, "image", max_range_m=max_range_m), tag_size_m=0.15)
    whole = task(scene)
    vectors = np.random.default_rng(seed).uniform(whole.problem.low, whole.problem.high)
    found = configuration(whole, vectors)
    np.testing.assert_array_equal(found.quality_m, dense_quality(whole.problem, vectors))
    seen = np.array([shown(whole.problem, i, vectors[i][None])[0] for i in range(5)])
    np.testing.assert_array_equal(found.seen(), seen)


def descended(table: Table, sums: Sums, seed: int, *, lazily: bool) -> Ints:
    """Descent from a random start; not lazily: after every sweep everybody is looked at again, until nobody moves."""
    count = len(table.block)
    rng = np.random.default_rng(seed)
    chosen, dirty = np.full(count, -1, dtype=np.int64), np.ones(count, dtype=np.bool_)
    begin(table, sums, chosen, rng.permutation(count), rng.uniform(size=count), dirty)
    while True:
        before = chosen.copy()
        assert descend(table, sums, chosen, dirty, 0, 10**9) == -1
        if lazily or (chosen == before).all():
            return chosen
        dirty[:] = True


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 1000),
    st.sampled_from(["mean", "worst"]),
    st.sampled_from(["cone", "image"]),
    st.sampled_from([0.0, 0.8]),
)
def test_where_dirty_flags_end_nobody_would_move(
    seed: int, objective: Objective, visibility: Visibility, separation_m: float
) -> None:
    """Stronger than equal quality: where descent with flags stops, looking at everybody again moves no one."""
    scene = room_scene(2, 2, 8, seed, PlannerSettings(visibility=visibility, min_separation_m=separation_m))
    whole = task(under(scene, objective=objective))
    table = table_of(whole, scene.cameras)
    reference_m = 0.003
    lazy = descended(table, empty_sums(whole, reference_m), seed, lazily=True)
    thorough = descended(table, empty_sums(whole, reference_m), seed, lazily=False)
    np.testing.assert_array_equal(lazy, thorough)


def test_descent_that_is_interrupted_goes_on_where_it_was() -> None:
    scene = room_scene(3, 2, 10, 5)
    whole = task(scene)
    table = table_of(whole, scene.cameras)
    count = len(table.block)
    ends = []
    for budget in (1, 10**9):
        rng = np.random.default_rng(0)
        sums, chosen, dirty = empty_sums(whole, 0.0), np.full(count, -1, dtype=np.int64), np.ones(count, dtype=np.bool_)
        begin(table, sums, chosen, rng.permutation(count), rng.uniform(size=count), dirty)
        turns, following = 0, 0
        while following >= 0:
            following = descend(table, sums, chosen, dirty, following, budget)
            turns += 1
        ends.append(chosen.tolist())
        assert (turns > count) == (budget == 1)
    assert ends[0] == ends[1]


def test_identical_drones_share_their_candidates_and_heads_do_not() -> None:
    scene = Scene((drone("a"), head("h", 1.0, 1.0), drone("b"), head("g", 1.0, 1.0)), room_scene(0, 0, 5, 0).targets)
    blocks = table_of(task(scene), scene.cameras).block
    assert blocks[0].tolist() == blocks[2].tolist()
    assert blocks[1].tolist() != blocks[3].tolist()


def hall(seed: int) -> Scene:
    """50 heads under the ceiling of a hall of 25 m x 20 m, 500 tags on its floor, seen as far as 6 m."""
    rng = np.random.default_rng(seed)
    heads = [head(f"h{k}", float(x), float(y)) for k, (x, y) in enumerate(rng.uniform((0, 0), (25, 20), (50, 2)))]
    tags = [
        SceneTarget(f"t{k}", (float(x), float(y), 0.0), 0.2)
        for k, (x, y) in enumerate(rng.uniform((0, 0), (25, 20), (500, 2)))
    ]
    return Scene(tuple(heads), tuple(tags), PlannerSettings(visibility="image", max_range_m=6.0, min_tag_px=20.0))


def covered_greedily(scene: Scene) -> int:
    """Coverage first: one camera after another takes the candidate that shows most of what nobody shows yet."""
    whole = task(scene)
    table = table_of(whole, scene.cameras)
    covered = np.zeros(len(scene.targets), dtype=np.bool_)
    for first, end in table.block:
        rows = [table.targets[table.ends[k] : table.ends[k + 1]] for k in range(first, end)]
        covered[max(rows, key=lambda row: int((~covered[row]).sum()))] = True
    return int(covered.sum())


def test_a_hall_of_50_cameras_and_500_targets_is_planned_and_covered_better_than_greedily() -> None:
    scene = hall(0)
    plan = solve(scene)
    check_permitted(scene, plan)
    whole = task(scene)
    assert len(whole.reachable) < 0.35 * 50 * 500  # a list of what is near
    here = at(scene, plan.aims)
    np.testing.assert_array_equal(here.quality_m, dense_quality(whole.problem, here.vectors))
    assert len(scene.targets) - len(plan.uncovered) >= covered_greedily(scene)
    assert plan.objective_m is not None
    assert math.isfinite(plan.objective_m)


def test_an_empty_problem_reaches_nothing() -> None:
    scene = replace(hall(0), targets=())
    whole = task_of(problem_of(scene), worst=False)
    assert (len(whole.reachable), whole.reach_ends.tolist()) == (0, [0] * 51)
