"""What a running rig's planner owes to motion: room around what moves, and only places that are reached in time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from camrig import optimise
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.messages import Aim, DroneAim, HeadAim, PlanRequest, PlanTarget
from camrig.optimise import PlannerSettings
from camrig.rig import CameraSpec, DroneMount, DroneSpec, HeadMount, HeadSpec, Rig, Space

LENS = BrownLens((1280, 720), (1000.0, 1000.0), (640.0, 360.0))
SETTINGS = PlannerSettings(visibility="image", reach_s=1.5)


def _rig() -> Rig:
    head = HeadSpec(
        "h", PanTilt(transform(np.eye(3), np.array([3.0, 2.0, 2.8]))), (-3.0, 3.0), (-1.57, 0.0), math.radians(30.0)
    )
    drone = DroneSpec("d", ((0.0, 0.0, 1.2), (6.0, 4.0, 2.5)), 0.8, 0.5)
    optical, down = transform(R_MOUNT_OPTICAL, np.zeros(3)), transform(R_BODY_OPTICAL_DOWN, np.zeros(3))
    cameras = {
        "ch": CameraSpec("ch", LENS, HeadMount("h", optical)),
        "cd": CameraSpec("cd", LENS, DroneMount("d", down)),
    }
    return Rig("r", Space(((0.0, 0.0), (6.0, 4.0))), cameras, {"h": head}, {"d": drone})


def _plan(target: PlanTarget, aims: dict[str, Aim], clock: Callable[[], float] = lambda: 0.0) -> dict[str, Aim]:
    request = PlanRequest(1, 0.0, (target,), aims, tuple(aims), 5.0)
    return dict(optimise.plan_for(_rig(), request, SETTINGS, clock).aims)


def test_a_drone_is_sent_no_further_than_it_flies_while_the_plan_holds() -> None:
    aims = _plan(PlanTarget("t", (5.5, 3.5, 0.2), 0.2), {"cd": DroneAim((1.0, 1.0, 1.5))})
    place = aims["cd"]
    assert isinstance(place, DroneAim)
    assert max(abs(place.position_m[0] - 1.0), abs(place.position_m[1] - 1.0)) <= 0.5 * 1.5 + 1e-9


def test_a_head_turns_no_further_than_it_can_while_the_plan_holds() -> None:
    aims = _plan(PlanTarget("t", (0.5, 2.0, 0.2), 0.2), {"ch": HeadAim(0.0, -0.8)})
    aim = aims["ch"]
    assert isinstance(aim, HeadAim)
    assert abs(aim.pan_rad) <= math.radians(45.0) + 1e-9


@pytest.mark.parametrize("reach_m", [0.0, 0.3])
def test_what_may_move_gets_room_in_the_picture(reach_m: float) -> None:
    target = PlanTarget("t", (1.2, 1.0, 0.2), 0.2, reach_m=reach_m)
    place = _plan(target, {"cd": DroneAim((1.0, 1.0, 1.5))})["cd"]
    assert isinstance(place, DroneAim)
    depth_m = place.position_m[2] - 0.2
    for axis, half_px, centre in ((0, 640.0, 1.2), (1, 360.0, 1.0)):
        outermost_m = abs(centre - place.position_m[axis]) + 0.1 + reach_m
        assert outermost_m <= half_px / 1000.0 * depth_m + 0.005


def test_more_room_costs_quality_but_is_not_free_to_ignore() -> None:
    still = PlanTarget("t", (1.2, 1.0, 0.2), 0.2)
    aims: dict[str, Aim] = {"cd": DroneAim((1.0, 1.0, 1.5))}
    heights = []
    for reach_m in (0.0, 0.35):
        place = _plan(replace(still, reach_m=reach_m), aims)["cd"]
        assert isinstance(place, DroneAim)
        heights.append(place.position_m[2])
    assert heights[1] > heights[0] + 0.1


def test_a_camera_that_may_not_move_counts_where_it_is() -> None:
    aim = HeadAim(0.1, -0.8)
    target = PlanTarget("t", (4.9, 2.2, 0.2), 0.2)
    request = PlanRequest(1, 0.0, (target,), {"ch": aim}, ("ch",), 5.0, fixed=("ch",))
    assert optimise.plan_for(_rig(), request, SETTINGS, lambda: 0.0).aims == {"ch": aim}
