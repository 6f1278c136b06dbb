"""What counts as seen: range, incidence, tag size in pixels, room about a tag, keep-out boxes in the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry import airspace
from camrig.geometry.lens import BrownLens
from camrig.geometry.pose import transform
from camrig.optimise import FixedPlace, PlannerSettings, Scene, SceneCamera, SceneTarget
from camrig.optimise.kernels.sight import NEAR_M
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Visibility
from tests.planner_scenes import LAB, head, shown, solve, targets, under

PINHOLE = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0))
IMAGE = PlannerSettings(visibility="image")


def seen(target: SceneTarget, settings: PlannerSettings = IMAGE, lens: BrownLens = PINHOLE, **boxes: object) -> bool:
    """Whether a camera at the origin that looks along world z (image x is world x) sees a target."""
    fixed = SceneCamera("f", lens, FixedPlace(np.eye(4)))
    problem = problem_of(replace(Scene((fixed,), (target,), settings), **boxes))  # type: ignore[arg-type]
    return bool(shown(problem, 0, problem.low)[0, 0])


FACING = (0.0, 0.0, -1.0)
"""The normal of a tag that faces that camera."""


def tag(x: float, y: float, z: float, size_m: float = 0.2) -> SceneTarget:
    return SceneTarget("t", (x, y, z), size_m, FACING)


def test_a_target_is_seen_up_to_the_range_along_the_line_of_sight() -> None:
    limited = under(Scene((), (), IMAGE), max_range_m=2.0).settings
    for off_axis in (0.0, 0.5):
        along = np.array([off_axis, 0.0, 1.0]) / math.hypot(off_axis, 1.0)
        for range_m, expected in ((1.999, True), (2.001, False)):
            x, y, z = range_m * along
            assert seen(SceneTarget("t", (x, y, z)), limited) == expected
            assert seen(SceneTarget("t", (x, y, z)))


def test_nothing_counts_nearer_than_a_lens_can_see() -> None:
    assert seen(SceneTarget("t", (0.0, 0.0, NEAR_M * 1.01)))
    assert not seen(SceneTarget("t", (0.0, 0.0, NEAR_M * 0.99)))
    assert not seen(SceneTarget("t", (0.0, 0.0, 0.0)))


@pytest.mark.parametrize("axis", [(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)])
def test_a_tag_is_seen_up_to_the_incidence(axis: tuple[float, float]) -> None:
    limited = PlannerSettings(visibility="image", max_incidence_rad=math.radians(60.0))
    for incidence_deg, expected in ((59.9, True), (60.1, False), (120.0, False), (180.0, False)):
        lean = math.radians(incidence_deg)
        normal = (axis[0] * math.sin(lean), axis[1] * math.sin(lean), -math.cos(lean))
        assert seen(SceneTarget("t", (0.0, 0.0, 2.0), 0.2, normal), limited) == expected
        # A point has no face, and without a limit a tag is seen until it shows its back.
        assert seen(SceneTarget("t", (0.0, 0.0, 2.0), None, normal), limited)
        assert seen(SceneTarget("t", (0.0, 0.0, 2.0), 0.2, normal)) == (incidence_deg < 90.0)


def test_incidence_is_to_the_line_of_sight_not_to_the_optical_axis() -> None:
    limited = PlannerSettings(visibility="image", max_incidence_rad=math.radians(30.0))
    assert not seen(tag(1.4, 0.0, 2.0), limited)  # 35 degrees off the axis, square to the axis
    assert seen(replace(tag(1.4, 0.0, 2.0), normal=(-1.4, 0.0, -2.0)), limited)


def test_a_tag_is_seen_down_to_so_many_pixels_of_its_narrow_side() -> None:
    square = tag(0.0, 0.0, 2.0)  # 80 px
    for limit_px, expected in ((79.9, True), (80.1, False)):
        assert seen(square, replace(IMAGE, min_tag_px=limit_px)) == expected
    lean = math.radians(60.0)
    leaning = SceneTarget("t", (0.0, 0.0, 2.0), 0.2, (math.sin(lean), 0.0, -math.cos(lean)))
    # Its sides across still have 80 px; along the lean it is half as wide, a little more or less by perspective.
    for limit_px, expected in ((39.0, True), (41.0, False)):
        assert seen(leaning, replace(IMAGE, min_tag_px=limit_px)) == expected
    assert seen(SceneTarget("t", (0.0, 0.0, 2.0)), replace(IMAGE, min_tag_px=500.0))  # a point has no size


def test_a_tag_with_a_corner_behind_the_camera_is_not_seen() -> None:
    edge_on = SceneTarget("t", (0.0, 0.0, 0.1), 0.4, (1.0, 0.0, -0.4))
    for visibility in ("cone", "image"):
        assert not seen(edge_on, PlannerSettings(visibility=visibility, min_tag_px=1.0))


def test_all_four_corners_must_be_in_the_image_with_the_room_that_the_target_may_need() -> None:
    edge_m = 2.0 * 640.0 / 800.0  # where the image ends, at the tag's depth
    for x, expected in ((edge_m - 0.101, True), (edge_m - 0.099, False)):
        assert seen(tag(x, 0.0, 2.0)) == expected
        assert seen(SceneTarget("t", (x, 0.0, 2.0)))
    for reach_m, expected in ((0.09, True), (0.11, False)):
        assert seen(replace(tag(edge_m - 0.2, 0.0, 2.0), reach_m=reach_m)) == expected


def test_the_margin_moves_the_corners_edge_and_the_cones() -> None:
    margin_rad = 0.02
    for visibility, edge in (("image", math.atan(640.0 / 800.0)), ("cone", math.atan(640.0 / 800.0))):
        settings = PlannerSettings(visibility=visibility, margin_rad=margin_rad)  # type: ignore[arg-type]
        for off, expected in ((edge - margin_rad - 1e-3, True), (edge - margin_rad + 1e-3, False)):
            assert seen(SceneTarget("t", (math.sin(off), 0.0, math.cos(off))), settings) == expected


@pytest.mark.parametrize("visibility", ["cone", "image"])
def test_nothing_past_r_max_is_seen_though_a_far_corner_would_look_better(visibility: Visibility) -> None:
    """The paper's lens is one-to-one to sqrt(2), but its q_d falls past r = 1: calibrated to 1, it ends there."""
    settings = PlannerSettings(visibility=visibility)
    wide = replace(LAB, size_px=(2600, 2400), centre_px=(1300.0, 1200.0), r_max=1.0)
    for r, expected in ((0.99, True), (1.01, False), (1.3, False)):
        assert seen(SceneTarget("t", (2.0 * r, 0.0, 2.0)), settings, wide) == expected
    assert seen(SceneTarget("t", (2.0 * 1.3, 0.0, 2.0)), settings, replace(wide, r_max=math.sqrt(2.0)))


WALL = ((-1.0, -1.0, 0.9), (0.2, 1.0, 1.1))


def test_a_box_hides_what_is_behind_it_and_nothing_else() -> None:
    boxes = {"keep_out_m": (WALL,)}
    assert not seen(SceneTarget("t", (0.0, 0.0, 2.0)), IMAGE, PINHOLE, **boxes)
    assert seen(SceneTarget("t", (1.0, 0.0, 2.0)), IMAGE, PINHOLE, **boxes)
    assert seen(SceneTarget("t", (0.0, 0.0, 0.8)), IMAGE, PINHOLE, **boxes)
    assert seen(SceneTarget("t", (0.0, 0.0, 0.9)), IMAGE, PINHOLE, **boxes)  # it lies on the box


COORDINATE = st.floats(-3.0, 3.0)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)


@given(st.tuples(COORDINATE, COORDINATE, st.floats(0.3, 3.0)), POINT, POINT)
def test_boxes_hide_what_the_geometry_says_they_do(
    at: tuple[float, float, float], one: tuple[float, float, float], other: tuple[float, float, float]
) -> None:
    low, high = np.minimum(one, other), np.maximum(one, other)
    box = (tuple(low.tolist()), tuple(high.tolist()))
    target = SceneTarget("t", at)
    hidden = bool(airspace.blocked(np.zeros(3), np.array(at), [box])[()])
    wide = BrownLens((4000, 4000), (300.0, 300.0), (2000.0, 2000.0), r_max=20.0)
    if seen(target, IMAGE, wide):
        assert seen(target, IMAGE, wide, keep_out_m=(box,)) != hidden


def test_a_plan_covers_only_what_is_detectable() -> None:
    camera = head("h", 1.0, 1.0)
    scene = Scene((camera,), targets((1.5, 1.0), (4.5, 2.5), tag_size_m=0.1), PlannerSettings(visibility="image"))
    assert solve(under(scene, max_range_m=3.0)).uncovered == ("t1",)
    assert solve(under(scene, max_incidence_rad=math.radians(40.0))).uncovered == ("t1",)
    assert solve(under(scene, min_tag_px=25.0)).uncovered == ("t1",)


def test_a_tag_on_a_wall_is_seen_from_its_front_only() -> None:
    T = transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.0]))
    camera = SceneCamera("f", PINHOLE, FixedPlace(T))  # along world x
    front = SceneTarget("t", (2.0, 0.0, 1.0), 0.2, (-1.0, 0.0, 0.0))
    back = replace(front, id="b", normal=(1.0, 0.0, 0.0))
    assert solve(Scene((camera,), (front, back), IMAGE)).uncovered == ("b",)
