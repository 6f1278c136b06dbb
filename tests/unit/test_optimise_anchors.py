"""Who must see an anchor sees one in every plan; where nobody can, a sentence says so. Drones keep out of boxes."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from camrig import optimise
from camrig.errors import InputError
from camrig.messages import Aim, DroneAim, RigPlan
from camrig.optimise import PlannerSettings, Scene, SceneAnchor
from camrig.optimise.configuration import permitted
from camrig.optimise.kernels.table import anchored
from camrig.optimise.scene import Objective, Quality, Visibility
from tests.planner_scenes import BOX, XY, at, drone, head, scenes, solve, targets, task, under


def anchor(x: float, y: float) -> SceneAnchor:
    return SceneAnchor((x, y, 0.0), 0.2)


def needy(name: str, *, yaw_free: bool = False) -> optimise.SceneCamera:
    return replace(drone(name, yaw_free=yaw_free), needs_anchor=True)


def in_view(scene: Scene, plan: RigPlan) -> list[bool]:
    """Whether each camera sees an anchor from where the plan puts it."""
    here = at(scene, plan.aims)
    problem = task(scene).problem
    return [bool(anchored(problem, i, here.vectors[i])) for i in range(len(scene.cameras))]


@settings(deadline=None, max_examples=15)
@given(
    spots=st.lists(XY, min_size=1, max_size=4),
    anchors=st.lists(XY, min_size=1, max_size=3),
    visibility=st.sampled_from(["cone", "image"]),
    quality=st.sampled_from(["pixel", "fisher"]),
    objective=st.sampled_from(["mean", "worst"]),
    yaw_free=st.booleans(),
)
def test_a_drone_that_must_see_an_anchor_always_has_one_in_view(
    spots: list[tuple[float, float]],
    anchors: list[tuple[float, float]],
    visibility: Visibility,
    quality: Quality,
    objective: Objective,
    yaw_free: bool,
) -> None:
    scene = Scene(
        (needy("a", yaw_free=yaw_free), needy("b"), drone("free")),
        targets(*spots, tag_size_m=0.15),
        PlannerSettings(quality, visibility, objective, min_separation_m=0.6),
        anchors=tuple(anchor(x, y) for x, y in anchors),
    )
    plan = solve(scene)
    assert in_view(scene, plan)[:2] == [True, True]
    moved = replace(scene, targets=tuple(replace(t, position_m=(2.5, 1.5, 0.0)) for t in scene.targets))
    for fast in (False, True):
        again = optimise.plan(moved, start=plan.aims, quick=fast, now=lambda: 0.0)
        assert in_view(moved, again)[:2] == [True, True]


def test_an_anchor_costs_coverage_where_it_must() -> None:
    """The target is out of reach from wherever the anchor is seen: the anchor comes first."""
    scene = Scene((needy("d"),), targets((4.9, 2.9)), anchors=(anchor(0.0, 0.0),))
    plan = solve(scene)
    assert plan.uncovered == ("t0",)
    assert in_view(scene, plan) == [True]
    assert solve(replace(scene, cameras=(drone("d"),))).uncovered == ()


@pytest.mark.parametrize("anchors", [(), (anchor(40.0, 40.0),)])
def test_where_no_anchor_can_be_seen_a_sentence_names_the_cameras(anchors: tuple[SceneAnchor, ...]) -> None:
    scene = Scene((needy("d1"), drone("d2")), targets((1.0, 1.0)), anchors=anchors)
    with pytest.raises(InputError, match=r"d1 see an anchor; .*more anchors") as refused:
        solve(scene)
    assert "d2" not in str(refused.value)


def test_a_start_without_an_anchor_in_view_is_left() -> None:
    scene = Scene((needy("d"),), targets((1.0, 1.0)), PlannerSettings(gain=0.99), anchors=(anchor(1.5, 1.0),))
    lost: dict[str, Aim] = {"d": DroneAim((4.9, 2.9, 1.0))}
    assert in_view(scene, solve(scene, lost)) == [True]


def test_a_head_may_be_asked_to_see_an_anchor_too() -> None:
    scene = Scene((head("h", 2.5, 1.5),), targets((4.5, 1.5)), anchors=(anchor(3.2, 1.5),))
    asked = replace(scene, cameras=(replace(scene.cameras[0], needs_anchor=True),))
    plan = solve(asked)
    assert plan.uncovered == ()
    assert in_view(asked, plan) == [True]


def test_a_head_turns_to_its_anchor_though_no_target_is_near_it() -> None:
    asked = replace(head("h", 2.5, 1.5, z=1.5), needs_anchor=True)
    scene = Scene((asked,), targets((4.8, 1.5)), PlannerSettings(visibility="image"), anchors=(anchor(0.2, 1.5),))
    plan = solve(scene)
    assert plan.uncovered == ("t0",)
    assert in_view(scene, plan) == [True]


def test_an_anchor_behind_a_box_is_not_in_view() -> None:
    table = ((0.0, 0.0, 0.4), (5.0, 3.0, 0.6))
    scene = Scene((needy("d"),), targets((1.0, 1.0)), anchors=(anchor(1.2, 1.0),))
    assert in_view(scene, solve(scene)) == [True]
    with pytest.raises(InputError, match="see an anchor"):
        solve(replace(scene, keep_out_m=(table,)))


LOW, HIGH = st.tuples(st.floats(0.0, 4.0), st.floats(0.0, 2.0)), st.tuples(st.floats(0.5, 1.5), st.floats(0.5, 1.5))


@settings(deadline=None, max_examples=40)
@given(
    scene=scenes(),
    boxes=st.lists(st.tuples(LOW, HIGH, st.floats(0.8, 2.6)), min_size=1, max_size=3),
    visibility=st.sampled_from(["cone", "image"]),
)
def test_no_drone_enters_a_keep_out_box_however_good_it_is_there(
    scene: Scene,
    boxes: list[tuple[tuple[float, float], tuple[float, float], float]],
    visibility: Visibility,
) -> None:
    keep_out = tuple(((x, y, 0.0), (x + wide, y + deep, top)) for (x, y), (wide, deep), top in boxes)
    scene = replace(under(scene, visibility=visibility), keep_out_m=keep_out)
    try:
        plan = solve(scene)
    except InputError:
        reject()  # the boxes may leave no room
    places = [aim.position_m for aim in plan.aims.values() if isinstance(aim, DroneAim)]
    assert not any(
        all(a < value < b for a, value, b in zip(low, place, high, strict=True))
        for low, high in keep_out
        for place in places
    )
    assert all(math.dist(a[:2], b[:2]) >= 0.8 - 1e-6 for a, b in combinations(places, 2))
    assert permitted(task(scene).problem, at(scene, plan.aims).vectors)


def test_drones_with_no_place_outside_the_boxes_are_refused() -> None:
    low, high = BOX
    everything = (tuple(np.subtract(low, 1.0).tolist()), tuple(np.add(high, 1.0).tolist()))
    with pytest.raises(InputError, match="keep-out boxes"):
        solve(Scene((drone("d"),), targets((1.0, 1.0)), keep_out_m=(everything,)))
