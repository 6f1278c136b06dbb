"""A plan looked at: its cameras' poses and lenses, and the quality of a target at any place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.errors import InputError
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.lens_row import lens_from_row, lens_row
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.messages import Aim, DroneAim, HeadAim, PlanStatus, RigPlan
from camrig.optimise import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    Scene,
    SceneAnchor,
    SceneCamera,
    SceneTarget,
    ZoomStep,
    quality_at,
    quality_map,
    views,
)
from camrig.optimise.scene import Quality

LAB = BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.335814, 0.101432, 0.001, -0.001, 0.0))
HEAD = SceneCamera(
    "head",
    LAB,
    HeadPlace(
        PanTilt(transform(np.eye(3), np.array([1.0, 1.0, 2.8]))),
        transform(R_MOUNT_OPTICAL, np.zeros(3)),
        (-math.pi, math.pi),
        (-math.pi / 2.0, 0.0),
    ),
)
DRONE = SceneCamera(
    "drone", LAB, DronePlace(transform(R_BODY_OPTICAL_DOWN, np.zeros(3)), ((0.0, 0.0, 1.0), (5.0, 3.0, 3.0)))
)
TARGETS = (SceneTarget("a", (1.5, 1.5, 0.2), 0.1), SceneTarget("b", (2.5, 1.0, 0.2), 0.1))
AIMS: dict[str, Aim] = {"head": HeadAim(0.5, -1.0), "drone": DroneAim((2.0, 1.0, 2.5), 0.3)}


def plan_of(aims: dict[str, Aim], mounts: dict[str, tuple[float, float, float]] | None = None) -> RigPlan:
    return RigPlan(0, 0.0, PlanStatus.OPTIMISED, None, aims, {}, (), 0.0, mounts=mounts or {})


@pytest.mark.parametrize("quality", ["pixel", "fisher", "perspective"])
def test_the_map_agrees_with_the_plan_where_the_targets_are(quality: Quality) -> None:
    settings = PlannerSettings(quality=quality, visibility="image", margin_rad=0.01)
    box = ((2.0, 2.0, 0.0), (2.2, 2.2, 1.0))
    scene = Scene((HEAD, DRONE), TARGETS, settings, (box,), (SceneAnchor((1.5, 1.0, 0.0), 0.2),))
    plan = quality_at(scene, AIMS)
    xs, ys = np.array([1.5, 2.5, 90.0]), np.array([1.0, 1.5])
    found = quality_map(scene, plan, xs, ys)
    assert found.shape == (2, 3)
    assert found[1, 0] == pytest.approx(plan.targets["a"].quality_m, rel=1e-9)
    assert found[0, 1] == pytest.approx(plan.targets["b"].quality_m, rel=1e-9)
    assert np.isinf(found[:, 2]).all()


def test_the_map_is_the_same_in_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene((HEAD, DRONE), TARGETS, PlannerSettings(visibility="image"))
    xs, ys = np.linspace(0.0, 3.0, 9), np.linspace(0.0, 2.0, 5)
    whole = quality_map(scene, plan_of(AIMS), xs, ys)
    assert np.isfinite(whole).any()
    monkeypatch.setattr("camrig.optimise.plan_views._PAIRS", 14)
    assert np.array_equal(quality_map(scene, plan_of(AIMS), xs, ys), whole)


def test_views_stand_where_the_plan_puts_the_cameras() -> None:
    assert isinstance(HEAD.place, HeadPlace)
    free = replace(HEAD, place=replace(HEAD.place, mount_m=((0.0, 0.0, 2.8), (5.0, 3.0, 2.8))))
    T_world_camera = transform(R_BODY_OPTICAL_DOWN, np.array([4.0, 2.0, 2.0]))
    bolted = SceneCamera("bolted", LAB, FixedPlace(T_world_camera), alpha_rad=0.4)
    scene = Scene((free, DRONE, bolted), TARGETS)
    head, drone, fixed = views(scene, plan_of(AIMS, {"head": (3.0, 2.0, 2.8)}))
    assert (head.id, drone.id, fixed.id) == ("head", "drone", "bolted")
    expected = PanTilt(transform(np.eye(3), np.array([3.0, 2.0, 2.8])))
    assert head.T_world_camera == pytest.approx(expected.T_world_camera(0.5, -1.0, HEAD.place.T_mount_camera))
    assert drone.T_world_camera[:3, 3] == pytest.approx([2.0, 1.0, 2.5])
    assert drone.T_world_camera[:3, 0] == pytest.approx([math.cos(0.3), math.sin(0.3), 0.0])
    assert fixed.T_world_camera == pytest.approx(T_world_camera)
    assert fixed.alpha_rad == 0.4


def test_a_zoom_lens_is_the_one_at_the_plans_zoom() -> None:
    tele = BrownLens((1280, 800), (8000.0, 8000.0), (640.0, 400.0))
    zoomed = replace(HEAD, zoom=(ZoomStep(0.0, LAB), ZoomStep(100.0, tele)))
    (view,) = views(Scene((zoomed,), TARGETS), plan_of({"head": HeadAim(0.5, -1.0, 50.0)}))
    assert view.lens.focal_px == pytest.approx(((827.7 + 8000.0) / 2.0, (827.9 + 8000.0) / 2.0))
    assert view.alpha_rad == pytest.approx(math.atan(640.0 / math.sqrt(np.prod(view.lens.focal_px))))


def test_a_missing_aim_is_refused() -> None:
    with pytest.raises(InputError, match="no aim for drone"):
        views(Scene((HEAD, DRONE), TARGETS), plan_of({"head": AIMS["head"]}))


@pytest.mark.parametrize("lens", [LAB, FisheyeLens((640, 480), (300.0, 301.0), (320.0, 240.0), (0.1, 0.01, 0.0, 0.0))])
def test_a_row_holds_all_of_a_lens(lens: Lens) -> None:
    assert repr(lens_from_row(lens_row(lens))) == repr(lens)
