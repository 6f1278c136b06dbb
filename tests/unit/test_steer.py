"""Steering: limits whatever the planner says, dead bands, the shorter way, and drones that keep apart on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import PanTilt
from camrig.messages import Aim, DroneAim, DroneCommand, HeadAim, HeadCommand, RigPose
from camrig.rig import Box, CameraSpec, DroneMount, DroneSpec, HeadMount, HeadSpec, Rig, Space
from camrig.steer import SteerSettings, SteerState, steer

LENS = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0))
SETTINGS = SteerSettings()
BOX: Box = ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5))


def head_rig(pan_deg: tuple[float, float] = (-170.0, 170.0), tilt_deg: tuple[float, float] = (-90.0, 10.0)) -> Rig:
    pan = math.radians(pan_deg[0]), math.radians(pan_deg[1])
    tilt = math.radians(tilt_deg[0]), math.radians(tilt_deg[1])
    head = HeadSpec("h", PanTilt(np.eye(4)), pan, tilt, 1.0)
    return Rig("r", Space(), {"c": CameraSpec("c", LENS, HeadMount("h", np.eye(4)))}, heads={"h": head})


def drone_rig(count: int, separation_m: float = 0.8, keep_out: tuple[Box, ...] = ()) -> Rig:
    drones = {f"d{i}": DroneSpec(f"d{i}", BOX, separation_m, 0.5) for i in range(count)}
    cameras = {f"c{i}": CameraSpec(f"c{i}", LENS, DroneMount(f"d{i}", np.eye(4))) for i in range(count)}
    return Rig("r", Space(keep_out_m=keep_out), cameras, drones=drones)


def heads_told(
    rig: Rig, aim: HeadAim, present: HeadAim | None, state: SteerState | None = None, now_s: float = 0.0
) -> tuple[SteerState, list[HeadAim]]:
    pose = RigPose(heads={"h": present} if present else {})
    after, commands = steer(state or SteerState(), {"c": aim}, pose, frozenset({"c"}), rig, SETTINGS, now_s)
    assert all(isinstance(command, HeadCommand) and command.head_id == "h" for command in commands)
    return after, [command.aim for command in commands if isinstance(command, HeadCommand)]


@given(st.floats(-30.0, 30.0), st.floats(-10.0, 10.0), st.floats(-2.9, 2.9))
def test_a_head_is_never_told_to_leave_its_limits(pan_rad: float, tilt_rad: float, present_rad: float) -> None:
    rig = head_rig()
    head = rig.heads["h"]
    _, told = heads_told(rig, HeadAim(pan_rad, tilt_rad), HeadAim(present_rad, 0.0))
    for aim in told:
        assert head.pan_limits_rad[0] <= aim.pan_rad <= head.pan_limits_rad[1]
        assert head.tilt_limits_rad[0] <= aim.tilt_rad <= head.tilt_limits_rad[1]


def test_pan_goes_the_shorter_way_that_the_limits_allow() -> None:
    wide = head_rig(pan_deg=(-270.0, 270.0))
    _, told = heads_told(wide, HeadAim(math.radians(-170.0), -0.5), HeadAim(math.radians(170.0), -0.5))
    assert math.degrees(told[0].pan_rad) == pytest.approx(190.0)
    narrow = head_rig()
    _, told = heads_told(narrow, HeadAim(math.radians(-165.0), -0.5), HeadAim(math.radians(165.0), -0.5))
    assert math.degrees(told[0].pan_rad) == pytest.approx(-165.0)
    _, told = heads_told(narrow, HeadAim(math.radians(185.0), -0.5), HeadAim(0.0, -0.5))
    assert math.degrees(told[0].pan_rad) == pytest.approx(-170.0)


def test_small_moves_are_not_made() -> None:
    present = HeadAim(0.5, -0.5)
    assert heads_told(head_rig(), HeadAim(0.504, -0.496), present)[1] == []
    assert heads_told(head_rig(), HeadAim(0.506, -0.5), present)[1] == [HeadAim(0.506, -0.5)]


def test_a_head_that_moves_off_is_called_back_even_to_where_it_still_is() -> None:
    rig, here = head_rig(), HeadAim(0.5, -0.5)
    state, told = heads_told(rig, HeadAim(1.5, -0.5), here)
    assert told == [HeadAim(1.5, -0.5)]
    _, told = heads_told(rig, here, here, state, now_s=0.1)
    assert told == [here]


def test_a_head_is_told_once_and_again_only_when_it_does_not_come() -> None:
    rig, here, there = head_rig(), HeadAim(0.5, -0.5), HeadAim(1.5, -0.5)
    state, told = heads_told(rig, there, here)
    assert told == [there]
    state, told = heads_told(rig, there, here, state, now_s=1.0)
    assert told == []
    _, arrived = heads_told(rig, there, there, state, now_s=2.5)
    assert arrived == []
    _, stuck = heads_told(rig, there, here, state, now_s=2.5)
    assert stuck == [there]


def test_a_head_of_unknown_pose_is_told_but_a_camera_that_may_not_move_is_not() -> None:
    rig, aim = head_rig(), HeadAim(0.5, -0.5)
    assert heads_told(rig, aim, None)[1] == [aim]
    assert steer(SteerState(), {"c": aim}, RigPose(), frozenset(), rig, SETTINGS, 0.0)[1] == ()


@pytest.mark.parametrize("aim", [HeadAim(math.nan, 0.0), HeadAim(0.0, math.inf)])
def test_an_aim_that_is_no_number_is_not_followed(aim: HeadAim) -> None:
    assert heads_told(head_rig(), aim, HeadAim(0.0, 0.0))[1] == []
    drone = DroneAim((math.nan, 1.0, 1.5))
    pose = RigPose(drones={"d0": DroneAim((1.0, 1.0, 1.5))})
    assert steer(SteerState(), {"c0": drone}, pose, frozenset({"c0"}), drone_rig(1), SETTINGS, 0.0)[1] == ()


def fly(
    rig: Rig, goal: dict[str, Aim], at: dict[str, DroneAim], state: SteerState | None = None, now_s: float = 0.0
) -> tuple[SteerState, dict[str, DroneAim]]:
    state, commands = steer(state or SteerState(), goal, RigPose(drones=at), frozenset(goal), rig, SETTINGS, now_s)
    return state, {command.drone_id: command.aim for command in commands if isinstance(command, DroneCommand)}


def test_a_drones_set_point_leads_by_a_second_of_flight_and_stays_in_its_box() -> None:
    rig, at = drone_rig(1), {"d0": DroneAim((1.0, 1.0, 1.5))}
    _, told = fly(rig, {"c0": DroneAim((4.0, 1.0, 1.5), 0.3)}, at)
    assert told["d0"].position_m == pytest.approx((1.5, 1.0, 1.5))
    assert told["d0"].yaw_rad == 0.3
    _, told = fly(rig, {"c0": DroneAim((1.0, 1.2, -3.0))}, {"d0": DroneAim((1.0, 1.2, 1.2))})
    assert told["d0"].position_m == (1.0, 1.2, 1.0)


def test_a_drone_of_unknown_position_is_not_commanded() -> None:
    state, told = fly(drone_rig(1), {"c0": DroneAim((1.0, 1.0, 1.5))}, {})
    assert told == {}
    assert state.held == {"d0": "its position is unknown"}


def test_a_drone_does_not_fly_through_a_keep_out_box() -> None:
    rig = drone_rig(1, keep_out=(((2.0, 0.0, 0.0), (2.5, 3.0, 2.5)),))
    at = {"d0": DroneAim((1.0, 1.0, 1.5))}
    state, told = fly(rig, {"c0": DroneAim((4.0, 1.0, 1.5))}, at)
    assert told == {}
    assert state.held == {"d0": "a keep-out box is in the way"}
    assert fly(rig, {"c0": DroneAim((1.5, 2.0, 1.5))}, at)[1]


def test_moves_that_would_meet_are_made_one_after_the_other() -> None:
    rig = drone_rig(2)
    at = {"d0": DroneAim((1.0, 1.0, 1.5)), "d1": DroneAim((2.0, 0.2, 1.5))}
    goal: dict[str, Aim] = {"c0": DroneAim((3.0, 1.0, 1.5)), "c1": DroneAim((2.0, 2.8, 1.5))}
    state, told = fly(rig, goal, at)
    assert set(told) == {"d0"}
    assert state.held == {"d1": "drone d0 is in the way"}
    state, told = fly(rig, goal, at | {"d0": DroneAim((3.0, 1.0, 1.5))}, state, 5.0)
    assert "d1" in told
    assert state.held == {}


def test_drones_that_are_too_near_may_part() -> None:
    rig = drone_rig(2)
    at = {"d0": DroneAim((1.0, 1.0, 1.5)), "d1": DroneAim((1.3, 1.0, 1.5))}
    assert set(fly(rig, {"c1": DroneAim((3.0, 1.0, 1.5))}, at)[1]) == {"d1"}
    assert fly(rig, {"c1": DroneAim((1.1, 1.0, 1.5))}, at)[1] == {}


def test_a_set_point_is_told_once_and_again_when_the_drone_does_not_come() -> None:
    rig, at = drone_rig(1), {"d0": DroneAim((1.0, 1.0, 1.5))}
    goal: dict[str, Aim] = {"c0": DroneAim((1.3, 1.0, 1.5))}
    state, told = fly(rig, goal, at)
    assert told == {"d0": DroneAim((1.3, 1.0, 1.5))}
    assert fly(rig, goal, at, state, 1.0)[1] == {}
    assert fly(rig, goal, at, state, 2.5)[1] == told
    assert fly(rig, goal, {"d0": DroneAim((1.29, 1.0, 1.5))}, state, 2.5)[1] == {}
