"""What a running rig gets from the planner: plans that also search, and scans that show the whole floor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from camrig.errors import InputError
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.messages import (
    Aim,
    DroneAim,
    HeadAim,
    LostTarget,
    PlanRequest,
    PlanStatus,
    PlanTarget,
    RigPlan,
    ScanRequest,
)
from camrig.optimise import PlannerSettings, plan_for, quality_at, scan_for
from camrig.optimise.kernels.problem import Flags
from camrig.optimise.places import vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.running import search_place
from camrig.optimise.scene import Scene, scene_of
from camrig.rig import (
    Body,
    BodyTag,
    CameraSpec,
    DroneMount,
    DroneSpec,
    FreeMount,
    HeadMount,
    HeadSpec,
    Rig,
    Space,
    TagKey,
)
from tests.planner_scenes import shown

LENS = BrownLens((1280, 720), (900.0, 900.0), (640.0, 360.0), (-0.3, 0.09, 0.0, 0.0))
SETTINGS = PlannerSettings(visibility="image", margin_rad=0.0175, min_separation_m=0.8, min_tag_px=20.0, gain=0.02)
FLOOR = ((0.0, 0.0), (5.0, 3.0))
BOX = ((0.3, 0.3, 1.2), (4.7, 2.7, 2.4))
KEEP_OUT = (((2.2, 1.2, 0.0), (2.6, 1.6, 0.8)),)


def rig(keep_out: bool = False) -> Rig:
    places = {"north": (1.0, 2.9), "south": (4.0, 0.1), "west": (0.1, 1.0)}
    level = transform(R_MOUNT_OPTICAL, np.zeros(3))
    heads = {
        name: HeadSpec(name, PanTilt(transform(np.eye(3), np.array([x, y, 2.6]))), (-3.0, 3.0), (-1.57, 0.1), 0.7)
        for name, (x, y) in places.items()
    }
    cameras = {name: CameraSpec(name, LENS, HeadMount(name, level)) for name in heads}
    cameras["sky"] = CameraSpec("sky", LENS, DroneMount("d1", transform(R_BODY_OPTICAL_DOWN, np.zeros(3))))
    cameras["hand"] = CameraSpec("hand", LENS, FreeMount())
    bodies = {
        f"r{i}": Body(f"r{i}", (BodyTag(TagKey("tag36h11", i), 0.12, transform(np.eye(3), np.array([0.0, 0.0, 0.1]))),))
        for i in range(3)
    }
    space = Space(FLOOR, KEEP_OUT if keep_out else ())
    return Rig("lab", space, cameras, heads, {"d1": DroneSpec("d1", BOX, 0.8, 0.5)}, bodies)


AIMS: Mapping[str, Aim] = {
    "north": HeadAim(-1.0, -0.8),
    "south": HeadAim(2.0, -0.8),
    "west": HeadAim(0.0, -0.8),
    "sky": DroneAim((2.5, 1.5, 2.0), 0.4),
}
TRACKED = tuple(PlanTarget(f"r{i}", (1.5 + i, 1.0 + 0.4 * i, 0.1), 0.12) for i in range(2))


def request(
    request_id: int = 1, lost: tuple[LostTarget, ...] = (), targets: tuple[PlanTarget, ...] = TRACKED
) -> PlanRequest:
    return PlanRequest(request_id, 7.0, targets, AIMS, tuple(AIMS), 5.0, lost)


def answer(asked: PlanRequest, of: Rig | None = None) -> RigPlan:
    return plan_for(of or rig(), asked, SETTINGS, lambda: 0.0)


def seen_from(scene: Scene, name: str, aim: Aim) -> Flags:
    """Which targets (m,) a camera sees from an aim."""
    index = [camera.id for camera in scene.cameras].index(name)
    vector = vector_of(scene.cameras[index], aim)
    assert vector is not None
    return np.asarray(shown(problem_of(scene), index, vector[None])[0])


def test_the_answer_is_the_requests() -> None:
    plan = answer(request(41))
    assert (plan.request_id, plan.stamp_s, plan.status) == (41, 7.0, PlanStatus.OPTIMISED)
    assert set(plan.aims) == set(AIMS)
    assert set(plan.targets) == {"r0", "r1"}


def test_a_drone_keeps_its_yaw_and_a_hand_carried_camera_takes_no_part() -> None:
    asked = PlanRequest(1, 0.0, TRACKED, AIMS, (*AIMS, "hand"), 5.0)
    sky = answer(asked).aims["sky"]
    assert isinstance(sky, DroneAim)
    assert sky.yaw_rad == 0.4
    assert "hand" not in answer(asked).aims


def test_a_camera_that_is_not_available_is_not_planned() -> None:
    asked = PlanRequest(1, 0.0, TRACKED, AIMS, ("north", "west"), 5.0)
    assert set(answer(asked).aims) == {"north", "west"}


def test_a_camera_the_rig_does_not_have_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="attic"):
        answer(PlanRequest(1, 0.0, TRACKED, AIMS, ("attic",), 5.0))


def test_a_following_request_from_the_planned_aims_moves_nothing() -> None:
    first = answer(request(1))
    again = answer(PlanRequest(2, 8.0, TRACKED, first.aims, tuple(AIMS), 5.0))
    assert all(again.aims[name] is aim for name, aim in first.aims.items())


def test_a_lost_target_is_looked_for_and_no_tracked_one_is_given_up() -> None:
    lost = LostTarget("r2", (4.4, 2.6, 0.1), 0.2, 0.12)
    found = answer(request(1, (lost,)))
    assert found.uncovered == ()
    assert set(found.targets) == {"r0", "r1"}
    camera = found.searching["r2"]
    there = PlanTarget("there", search_place(lost, rig(), 1), 0.12)
    assert seen_from(scene_of(rig(), request(targets=(there,)), SETTINGS), camera, found.aims[camera]).all()
    without = answer(request(1))
    assert without.objective_m is not None
    assert found.objective_m is not None
    assert found.objective_m >= without.objective_m * 0.999


def test_the_only_camera_stays_with_the_target_it_has() -> None:
    lost = LostTarget("r2", (4.8, 0.2, 0.1), 0.1, 0.12)
    near = PlanTarget("r0", (0.3, 2.8, 0.1), 0.12)
    asked = PlanRequest(1, 0.0, (near,), AIMS, ("west",), 5.0, (lost,))
    found = answer(asked)
    assert (found.searching, found.status, found.uncovered) == ({}, PlanStatus.PARTIAL, ("r2",))
    assert found.targets["r0"].seen_by == ("west",)


def test_with_nothing_tracked_everything_searches() -> None:
    lost = tuple(LostTarget(f"r{i}", (2.5, 1.5, 0.1), 3.0, 0.12) for i in range(3))
    found = answer(request(3, lost, ()))
    assert set(found.searching) == {"r0", "r1", "r2"}
    assert found.objective_m is None


def test_a_search_starts_where_the_target_is_thought_to_be_and_spreads_over_the_floor() -> None:
    here = (1.0, 1.0, 0.1)
    near = LostTarget("r", here, 0.1, 0.12)
    assert {search_place(near, rig(), k) for k in range(20)} == {here}
    far = LostTarget("r", here, 3.0, 0.12)
    places = [search_place(far, rig(), k) for k in range(200)]
    assert places[0] == places[1] == here
    assert len(set(places)) > 10
    assert all(0.0 <= x <= 5.0 and 0.0 <= y <= 3.0 for x, y, _ in places)
    cells = [(x, y) for x in np.arange(0.25, 5.0, 0.5) for y in np.arange(0.25, 3.0, 0.5)]
    assert max(min(math.dist(cell, place[:2]) for place in places) for cell in cells) < 1.1


@pytest.mark.parametrize("keep_out", [False, True])
def test_a_scan_shows_the_floor_in_few_stops(keep_out: bool) -> None:
    room = rig(keep_out)
    scan = scan_for(room, ScanRequest(5, 2.0, AIMS, tuple(AIMS), 30.0), SETTINGS, lambda: 0.0)
    assert (scan.request_id, scan.stamp_s) == (5, 2.0)
    assert 1 <= len(scan.stops) <= 3
    assert scan.covered > 0.97
    rng = np.random.default_rng(3)
    places = rng.uniform((0.1, 0.1), (4.9, 2.9), (60, 2))
    seen = np.zeros(len(places), dtype=bool)
    scene = scene_of(
        room,
        request(targets=tuple(PlanTarget(str(i), (float(x), float(y), 0.1), 0.12) for i, (x, y) in enumerate(places))),
        SETTINGS,
    )
    for stop in scan.stops:
        for camera, aim in stop.items():
            seen |= seen_from(scene, camera, aim)
    inside = ((places > (2.15, 1.15)) & (places < (2.65, 1.65))).all(axis=1)
    assert seen[~inside].mean() > 0.95


def test_a_scan_of_one_camera_goes_to_the_nearest_stop_first() -> None:
    scan = scan_for(rig(), ScanRequest(1, 0.0, AIMS, ("west",), 30.0), SETTINGS, lambda: 0.0)
    aims = [stop["west"] for stop in scan.stops]
    assert len(aims) >= 2
    travel = [max(abs(a.pan_rad - 0.0), abs(a.tilt_rad + 0.8)) for a in aims if isinstance(a, HeadAim)]
    assert travel[0] == min(travel)


def test_a_scan_without_cameras_has_no_stops() -> None:
    scan = scan_for(rig(), ScanRequest(1, 0.0, {}, (), 30.0), SETTINGS, lambda: 0.0)
    assert (scan.stops, scan.covered) == ((), 0.0)


@pytest.mark.parametrize("quality", ["pixel", "fisher"])
def test_a_plan_promises_a_covariance_whatever_it_was_made_by(quality: Literal["pixel", "fisher"]) -> None:
    found = plan_for(rig(), request(), replace(SETTINGS, quality=quality), lambda: 0.0)
    scene = scene_of(rig(), replace(request(), aims=found.aims), replace(SETTINGS, quality="fisher"))
    by_fisher = quality_at(scene, found.aims).targets
    for name, promised in found.targets.items():
        assert promised.covariance_m2 is not None
        sigma_m = math.sqrt(float(np.trace(promised.covariance_m2)))
        assert sigma_m == pytest.approx(by_fisher[name].quality_m, rel=1e-9)
        assert 1e-5 < sigma_m < 0.05


def test_nothing_is_promised_of_a_target_that_nobody_sees() -> None:
    behind = PlanTarget("r0", (4.9, 2.9, 2.7), 0.12)
    found = answer(PlanRequest(1, 0.0, (behind, TRACKED[1]), AIMS, ("west",), 5.0))
    assert found.targets["r0"].covariance_m2 is None
    assert found.targets["r1"].covariance_m2 is not None
