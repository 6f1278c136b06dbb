"""The mission: scan until the targets are found, then a plan each period, whatever comes late or goes missing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from camrig.geometry.rotation import rotation_z
from camrig.messages import (
    Aim,
    DroneAim,
    Event,
    HeadAim,
    Level,
    PlannerAnswer,
    PlanRequest,
    PlanStatus,
    RigPlan,
    RigPose,
    ScanPlan,
    ScanRequest,
    Target,
    TargetStatus,
)
from camrig.pipeline import Mission, MissionSettings
from camrig.pipeline.mission import (
    ASSEMBLE_S,
    DWELL_S,
    SCAN_DEADLINE_S,
    STOP_TIMEOUT_S,
    Knowledge,
    advance,
    rescan,
)
from camrig.rig import Rig
from tests.simulated_room import room

START_S = 10.0
ROOM = room()
SETTINGS = MissionSettings(period_s=1.0, deadline_s=0.4)
AWAY, IN, DOWN = HeadAim(2.9, 0.0), HeadAim(0.0, -0.8), HeadAim(0.3, -1.2)
HOVER = DroneAim((3.0, 2.0, 1.5))
CAMERAS = frozenset(ROOM.cameras)
HEADS = {"c_west": AWAY, "c_east": AWAY, "c_south": AWAY}
UNSEEN = np.full(3, np.nan)


def target(name: str, status: TargetStatus, sigma_m: float = 0.01) -> Target:
    if status is TargetStatus.UNSEEN:
        nan = np.full((3, 3), np.nan)
        return Target(name, START_S, status, UNSEEN, UNSEEN, np.diag([math.inf] * 3), nan, (), -math.inf)
    place, speed = np.array([2.0, 1.0, 0.0]), np.array([0.2, 0.0, 0.0])
    turned = rotation_z(0.5)
    return Target(name, START_S, status, place, speed, np.eye(3) * sigma_m**2, turned, ("c_west",), START_S)


def targets(status: TargetStatus, **others: TargetStatus) -> tuple[Target, ...]:
    return tuple(target(name, others.get(name, status)) for name in ROOM.targets)


UNKNOWN = targets(TargetStatus.UNSEEN)
FOUND = targets(TargetStatus.TRACKED)


def known(
    seen: tuple[Target, ...] = UNKNOWN,
    aims: Mapping[str, Aim] | None = None,
    movable: frozenset[str] = CAMERAS,
    usable: frozenset[str] = CAMERAS,
) -> Knowledge:
    aims = {**HEADS, "c_sky": HOVER} if aims is None else aims
    return Knowledge(seen, aims, RigPose(), movable, usable, complete=movable == CAMERAS)


def go(
    mission: Mission,
    knowledge: Knowledge,
    now_s: float,
    answer: PlannerAnswer | None = None,
    settings: MissionSettings = SETTINGS,
) -> tuple[Mission, PlanRequest | ScanRequest | None, tuple[Event, ...]]:
    return advance(mission, ROOM, knowledge, answer, settings, now_s)


def scan_plan(request_id: int, *stops: Mapping[str, Aim]) -> ScanPlan:
    return ScanPlan(request_id, START_S, stops, 1.0, 0.1)


def rig_plan(request_id: int, aims: Mapping[str, Aim]) -> RigPlan:
    return RigPlan(request_id, START_S, PlanStatus.OPTIMISED, 0.001, aims, {}, (), 0.1)


def scanning(*stops: Mapping[str, Aim]) -> Mission:
    """Return a mission on its way to the first of these stops since ``START_S``."""
    mission, request, _ = go(Mission(START_S), known(), START_S)
    assert isinstance(request, ScanRequest)
    mission, _, _ = go(mission, known(), START_S, scan_plan(request.request_id, *stops))
    assert mission.stop_index == 0
    return mission


# --- the scan -------------------------------------------------------------------------------------------------


def test_a_scan_is_asked_for_once_with_all_that_moves() -> None:
    mission, request, _ = go(Mission(START_S), known(), START_S)
    assert isinstance(request, ScanRequest)
    assert request.available == tuple(sorted(CAMERAS))
    assert request.aims == {**HEADS, "c_sky": HOVER}
    assert request.deadline_s == SCAN_DEADLINE_S
    assert go(mission, known(), START_S + 5.0)[1] is None


def test_a_scan_waits_a_while_for_devices_that_still_come_up() -> None:
    some = known(movable=frozenset({"c_west"}))
    assert go(Mission(START_S), some, START_S + ASSEMBLE_S - 0.1)[1] is None
    request = go(Mission(START_S), some, START_S + ASSEMBLE_S)[1]
    assert isinstance(request, ScanRequest)
    assert request.available == ("c_west",)
    assert go(Mission(START_S), known(movable=frozenset()), START_S + 60.0)[1] is None


def test_a_scan_goes_on_to_the_next_stop_after_looking_from_where_it_arrived() -> None:
    mission = scanning({"c_west": IN}, {"c_west": DOWN, "c_sky": HOVER})
    assert mission.goal == {"c_west": IN}
    there = known(aims={**HEADS, "c_west": IN, "c_sky": HOVER})
    mission, _, _ = go(mission, known(), START_S + 1.0)
    assert mission.arrived_s is None
    mission, _, _ = go(mission, there, START_S + 2.0)
    assert mission.arrived_s == START_S + 2.0
    mission, _, _ = go(mission, there, START_S + 2.0 + 0.9 * DWELL_S)
    assert mission.stop_index == 0
    mission, _, _ = go(mission, there, START_S + 2.0 + DWELL_S)
    assert mission.stop_index == 1
    assert mission.goal == {"c_west": DOWN, "c_sky": HOVER}
    assert mission.arrived_s is None


def test_a_camera_that_never_arrives_holds_a_stop_up_for_a_bounded_time() -> None:
    mission = scanning({"c_west": IN}, {"c_west": DOWN})
    assert go(mission, known(), START_S + STOP_TIMEOUT_S - 0.1)[0].stop_index == 0
    assert go(mission, known(), START_S + STOP_TIMEOUT_S)[0].stop_index == 1


def test_a_camera_that_may_not_move_is_not_waited_for() -> None:
    mission = scanning({"c_west": IN, "c_east": IN})
    there = known(aims={**HEADS, "c_east": IN}, movable=CAMERAS - {"c_west"})
    assert go(mission, there, START_S + 1.0)[0].arrived_s == START_S + 1.0


def test_a_scan_ends_as_soon_as_every_target_was_seen_even_if_one_is_lost_again() -> None:
    mission, request, events = go(
        scanning({"c_west": IN}), known(targets(TargetStatus.TRACKED, robot3=TargetStatus.LOST)), START_S + 0.5
    )
    assert request is None
    assert not mission.scanning
    assert [(event.level, event.text) for event in events] == [(Level.INFO, "scan ended: every target was found")]


def test_a_scan_that_ends_without_a_target_names_it_and_the_plans_begin() -> None:
    seen = targets(TargetStatus.TRACKED, robot2=TargetStatus.UNSEEN, robot4=TargetStatus.UNSEEN)
    late_s = START_S + STOP_TIMEOUT_S
    mission, _, events = go(scanning({"c_west": IN}), known(seen), late_s)
    assert [event.level for event in events] == [Level.WARNING]
    assert events[0].text == "scan ended without finding robot2, robot4"
    _, request, _ = go(mission, known(seen), late_s + 0.02)
    assert isinstance(request, PlanRequest)
    assert [lost.id for lost in request.lost] == ["robot2", "robot4"]


def test_a_scan_without_stops_ends_at_once() -> None:
    mission, request, _ = go(Mission(START_S), known(), START_S)
    assert request is not None
    assert not go(mission, known(), START_S + 0.1, scan_plan(request.request_id))[0].scanning


def test_an_operator_may_scan_again_and_what_was_asked_before_is_forgotten() -> None:
    mission, request = planning()
    mission = rescan(mission, START_S + 1.0)
    assert mission.scanning
    mission, after, _ = go(mission, known(), START_S + 1.0, rig_plan(request.request_id, {"c_west": DOWN}))
    assert isinstance(after, ScanRequest)
    assert after.request_id > request.request_id
    assert mission.goal == {}


# --- the plans ------------------------------------------------------------------------------------------------


def planning(seen: tuple[Target, ...] = FOUND) -> tuple[Mission, PlanRequest]:
    """Return a mission that has found its targets and asked for its first plan at ``START_S``."""
    mission = Mission(START_S, scanning=False, next_plan_s=START_S)
    mission, request, _ = go(mission, known(seen), START_S)
    assert isinstance(request, PlanRequest)
    return mission, request


def test_a_plan_is_asked_for_each_period_when_the_last_one_has_come() -> None:
    mission, request = planning()
    mission, _, _ = go(mission, known(FOUND), START_S + 0.2, rig_plan(request.request_id, {}))
    mission, early, _ = go(mission, known(FOUND), START_S + 0.98)
    assert early is None
    mission, second, _ = go(mission, known(FOUND), START_S + 1.0)
    assert isinstance(second, PlanRequest)
    assert second.request_id == request.request_id + 1
    assert go(mission, known(FOUND), START_S + 5.0)[1] is None


def test_a_plan_that_comes_late_is_followed_and_the_next_one_asked_for_at_once() -> None:
    mission, request = planning()
    late = rig_plan(request.request_id, {"c_west": DOWN})
    mission, following, _ = go(mission, known(FOUND), START_S + 3.0, late)
    assert mission.plan is late
    assert mission.goal == {"c_west": DOWN}
    assert isinstance(following, PlanRequest)


def test_an_answer_to_another_question_is_not_followed() -> None:
    mission, request = planning()
    after, _, _ = go(mission, known(FOUND), START_S + 0.1, rig_plan(request.request_id - 1, {"c_west": DOWN}))
    assert after == mission
    after, _, _ = go(mission, known(FOUND), START_S + 0.1, scan_plan(request.request_id, {"c_west": DOWN}))
    assert not after.scanning
    assert after.goal == {}


def test_a_plan_keeps_the_goal_of_a_camera_it_leaves_out() -> None:
    mission, request = planning()
    mission = replace(mission, goal={"c_west": IN, "c_east": IN})
    mission, _, _ = go(mission, known(FOUND), START_S + 0.2, rig_plan(request.request_id, {"c_west": DOWN}))
    assert mission.goal == {"c_west": DOWN, "c_east": IN}


def test_tracked_targets_are_planned_for_where_they_will_be_and_the_others_are_searched_for() -> None:
    seen = targets(TargetStatus.TRACKED, robot2=TargetStatus.LOST, robot5=TargetStatus.UNSEEN)
    _, request = planning(seen)
    assert [each.id for each in request.targets] == ["robot1", "robot3", "robot4"]
    x, y, z = request.targets[0].position_m
    assert 2.0 + 0.2 * 0.4 < x < 2.0 + 0.2 * 1.2
    assert (y, z) == pytest.approx((1.0, 0.25))
    assert request.targets[0].normal == pytest.approx((0.0, 0.0, 1.0))
    assert request.targets[0].tag_size_m == 0.2
    assert [each.id for each in request.lost] == ["robot2", "robot5"]
    assert request.deadline_s == SETTINGS.deadline_s


def test_a_target_never_seen_is_searched_for_on_the_whole_floor_and_a_lost_one_where_it_may_be() -> None:
    seen = (target("robot1", TargetStatus.LOST, 0.3), target("robot2", TargetStatus.UNSEEN))
    lost, unseen = planning(seen)[1].lost
    assert lost.position_m == pytest.approx((2.0, 1.0, 0.25))
    assert lost.sigma_m == pytest.approx(0.3 * math.sqrt(2.0))
    assert unseen.position_m == pytest.approx((3.0, 2.0, 0.25))
    assert unseen.sigma_m == pytest.approx(math.hypot(6.0, 4.0) / 2.0)


def test_a_lost_target_is_searched_for_on_the_floor_however_far_its_prediction_went() -> None:
    gone = replace(target("robot1", TargetStatus.LOST, 50.0), position_m=np.array([40.0, -9.0, 0.0]))
    (lost,) = planning((gone,))[1].lost
    assert lost.position_m == pytest.approx((6.0, 0.0, 0.25))
    assert lost.sigma_m == pytest.approx(math.hypot(6.0, 4.0) / 2.0)


def test_a_plan_starts_from_where_heads_go_and_drones_are_and_held_heads_stay() -> None:
    mission = Mission(START_S, scanning=False, goal={"c_west": IN, "c_east": IN, "c_sky": DroneAim((1.0, 1.0, 1.5))})
    _, request, _ = go(mission, known(FOUND, movable=CAMERAS - {"c_east"}), START_S)
    assert isinstance(request, PlanRequest)
    assert request.aims == {"c_west": IN, "c_east": AWAY, "c_south": AWAY, "c_sky": HOVER}
    assert request.fixed == ("c_east",)


def test_a_camera_that_is_down_takes_no_part() -> None:
    mission = Mission(START_S, scanning=False, goal={"c_west": IN})
    up = CAMERAS - {"c_west"}
    _, request, _ = go(mission, known(FOUND, movable=up, usable=up), START_S)
    assert isinstance(request, PlanRequest)
    assert request.available == tuple(sorted(up))
    assert "c_west" not in request.aims


def test_nothing_is_planned_while_nothing_may_move() -> None:
    assert go(Mission(START_S, scanning=False), known(FOUND, movable=frozenset()), START_S)[1] is None


def test_a_rig_that_only_measures_never_asks() -> None:
    mission, request, events = go(Mission(START_S), known(), START_S + 60.0, settings=replace(SETTINGS, aim=False))
    assert not mission.scanning
    assert (request, events) == (None, ())
    fixed = Rig("fixed", ROOM.space, {})
    mission, request, _ = advance(Mission(START_S), fixed, known(), None, SETTINGS, START_S + 60.0)
    assert not mission.scanning
    assert request is None
