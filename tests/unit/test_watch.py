"""What the pipeline knows of its devices: readings and links in, who can move and what a lost link costs out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import (
    AxisReading,
    DroneReading,
    Event,
    FlightState,
    HeadAim,
    Level,
    LinkReport,
    LinkStatus,
    PlanStatus,
    RigPlan,
    TargetQuality,
)
from camrig.optimise import PlannerSettings
from camrig.pipeline import Inputs, Settings, State, begin, step
from camrig.pipeline.mission import Knowledge
from camrig.pipeline.watch import REPEAT_S, held_events, knowledge, rig_pose, take_readings, without_repeats
from camrig.rig import CameraSpec, FixedMount, FreeMount, Rig
from tests.simulated_room import LENS, room

NOW_S = 20.0
ROOM = room()
DEVICES = (*ROOM.cameras, *ROOM.heads, *ROOM.drones)
OBEYING = frozenset(ROOM.heads) | frozenset(ROOM.drones)
SKY_M = np.array([2.0, 1.0, 1.5])


def up(*names: str, status: LinkStatus = LinkStatus.UP, reason: str = "") -> Inputs:
    return Inputs(links=tuple(LinkReport(name, status, NOW_S, reason) for name in names))


def axes(head: str, pan_rad: float = 0.1, tilt_rad: float = -0.5) -> tuple[AxisReading, ...]:
    return (
        AxisReading(head, "pan", pan_rad, NOW_S, 1e-3, 0.0),
        AxisReading(head, "tilt", tilt_rad, NOW_S, 1e-3, 0.0),
    )


def drone(flight: FlightState = FlightState.FLYING) -> DroneReading:
    return DroneReading("d1", NOW_S, transform(rotation_z(0.3), SKY_M), np.eye(6) * 1e-4, flight)


def taken(state: State, inputs: Inputs, rig: Rig = ROOM) -> State:
    return take_readings(state, inputs, rig)[0]


def all_up(rig: Rig = ROOM, flight: FlightState = FlightState.FLYING) -> State:
    """Return a state in which every device is up and has told where it is."""
    readings = tuple(reading for head in rig.heads for reading in axes(head))
    inputs = replace(up(*rig.cameras, *rig.heads, *rig.drones), axis_readings=readings, drone_readings=(drone(flight),))
    return taken(begin(NOW_S), inputs, rig)


def known(state: State, enabled: frozenset[str] = OBEYING, rig: Rig = ROOM, now_s: float = NOW_S) -> Knowledge:
    return knowledge(state, (), Inputs(enabled=enabled), rig, now_s)


# --- readings -------------------------------------------------------------------------------------------------


def test_heads_and_drones_are_where_they_last_said() -> None:
    pose = rig_pose(all_up(), NOW_S)
    assert pose.heads["west"] == HeadAim(0.1, -0.5)
    assert pose.drones["d1"].position_m == pytest.approx((2.0, 1.0, 1.5))
    assert pose.drones["d1"].yaw_rad == pytest.approx(0.3)


def test_a_head_of_which_one_axis_is_known_is_nowhere() -> None:
    state = taken(begin(NOW_S), Inputs(axis_readings=axes("west")[:1]))
    assert rig_pose(state, NOW_S).heads == {}


def test_what_was_told_long_ago_is_not_where_it_is() -> None:
    pose = rig_pose(all_up(), NOW_S + 5.0)
    assert pose.heads == {}
    assert pose.drones == {}


@pytest.mark.parametrize("flight", [state for state in FlightState if state is not FlightState.FLYING])
def test_a_drone_that_does_not_fly_is_not_in_the_pose_and_takes_no_part(flight: FlightState) -> None:
    state = all_up(flight=flight)
    assert rig_pose(state, NOW_S).drones == {}
    found = known(state)
    assert "c_sky" not in found.usable | found.movable
    assert not found.complete


@pytest.mark.parametrize("flight", [state for state in FlightState if state is not FlightState.FLYING])
def test_a_drone_that_is_not_on_the_ground_is_kept_clear_of(flight: FlightState) -> None:
    aloft = rig_pose(all_up(flight=flight), NOW_S).aloft
    assert set(aloft) == (set() if flight is FlightState.GROUND else {"d1"})


def test_a_drone_on_the_ground_that_was_sent_up_is_kept_clear_of() -> None:
    grounded = all_up(flight=FlightState.GROUND)
    sent_up = Inputs(enabled=OBEYING, begin=frozenset({"d1"}))
    assert set(knowledge(grounded, (), sent_up, ROOM, NOW_S).pose.aloft) == {"d1"}
    assert knowledge(grounded, (), replace(sent_up, begin=frozenset()), ROOM, NOW_S).pose.aloft == {}


def test_a_flying_drone_that_is_not_heard_of_is_kept_clear_of_where_it_was_last() -> None:
    assert rig_pose(all_up(), NOW_S).aloft == {}
    lost = taken(all_up(), up("d1", status=LinkStatus.LOST))
    for pose in (rig_pose(all_up(), NOW_S + 60.0), rig_pose(lost, NOW_S + 60.0)):
        assert pose.aloft["d1"].position_m == pytest.approx((2.0, 1.0, 1.5))


def test_a_drone_whose_link_is_lost_is_not_taken_to_fly() -> None:
    state = taken(all_up(), up("d1", status=LinkStatus.LOST))
    assert state.flight["d1"] is FlightState.UNKNOWN
    assert "c_sky" not in known(state).movable


# --- who can move ---------------------------------------------------------------------------------------------


def test_with_everything_up_every_camera_takes_part() -> None:
    found = known(all_up())
    assert found.movable == found.usable == frozenset(ROOM.cameras)
    assert found.complete
    assert set(found.aims) == set(ROOM.cameras)


def test_nothing_takes_part_before_its_link_was_up() -> None:
    found = known(begin(NOW_S))
    assert found.movable == found.usable == frozenset()
    assert not found.complete


def test_a_head_that_is_not_enabled_is_counted_but_not_moved() -> None:
    found = known(all_up(), enabled=OBEYING - {"west"})
    assert "c_west" in found.usable
    assert "c_west" not in found.movable
    assert not found.complete


@pytest.mark.parametrize("device", ["c_west", "west"])
def test_a_camera_without_its_link_or_its_heads_takes_no_part(device: str) -> None:
    found = known(taken(all_up(), up(device, status=LinkStatus.LOST)))
    assert frozenset(ROOM.cameras) - found.usable == {"c_west"}
    assert "c_west" not in found.movable
    back = known(taken(taken(all_up(), up(device, status=LinkStatus.LOST)), up(device)))
    assert "c_west" in back.movable


def test_a_head_that_is_up_but_silent_takes_no_part() -> None:
    found = known(taken(begin(NOW_S), up(*DEVICES)))
    assert found.usable == frozenset()


def test_a_bolted_camera_is_counted_and_a_hand_carried_one_is_not() -> None:
    cameras = {
        "wall": CameraSpec("wall", LENS, FixedMount(np.eye(4))),
        "hand": CameraSpec("hand", LENS, FreeMount()),
    }
    rig = Rig("r", ROOM.space, cameras)
    found = known(taken(begin(NOW_S), up("wall", "hand"), rig), rig=rig)
    assert found.usable == {"wall"}
    assert found.movable == frozenset()
    assert found.complete


# --- events ---------------------------------------------------------------------------------------------------


def seen_by(**cameras: tuple[str, ...]) -> State:
    targets = {name: TargetQuality(0.001, seers) for name, seers in cameras.items()}
    plan = RigPlan(1, NOW_S, PlanStatus.OPTIMISED, 0.001, {}, targets, (), 0.1)
    state = all_up()
    return replace(state, mission=replace(state.mission, plan=plan))


@pytest.mark.parametrize("device", ["c_west", "west"])
def test_a_lost_link_says_which_targets_nothing_else_sees(device: str) -> None:
    state = seen_by(robot1=("c_west",), robot2=("c_west", "c_sky"), robot3=("c_east",), robot4=("c_west",))
    _, events = take_readings(state, up(device, status=LinkStatus.LOST, reason="no answer"), ROOM)
    assert [(event.level, event.about) for event in events] == [(Level.WARNING, device)]
    assert events[0].text == "link lost: no answer; robot1, robot4 were seen by it alone"


def test_a_lost_link_that_costs_nothing_says_no_more_than_that() -> None:
    _, events = take_readings(seen_by(robot1=("c_east",)), up("west", status=LinkStatus.LOST, reason="gone"), ROOM)
    assert events[0].text == "link lost: gone"
    _, events = take_readings(all_up(), up("c_west", status=LinkStatus.LOST, reason="gone"), ROOM)
    assert events[0].text == "link lost: gone"


def test_a_link_is_told_of_when_it_changes_and_only_then() -> None:
    state, events = take_readings(begin(NOW_S), up("west"), ROOM)
    assert [(event.level, event.text) for event in events] == [(Level.INFO, "link up")]
    assert take_readings(state, up("west"), ROOM)[1] == ()
    state, events = take_readings(state, up("west", status=LinkStatus.LOST, reason="x"), ROOM)
    assert len(events) == 1
    assert take_readings(state, up("west", status=LinkStatus.LOST, reason="y"), ROOM)[1] == ()


def test_a_link_that_comes_and_goes_is_told_of_every_time() -> None:
    state, told = begin(NOW_S), []
    for k in range(6):
        status = (LinkStatus.LOST, LinkStatus.UP)[k % 2]
        report = LinkReport("west", status, NOW_S + k, "no answer" if status is LinkStatus.LOST else "")
        state, outputs = step(state, Inputs(links=(report,)), ROOM, Settings(PlannerSettings()), NOW_S + k)
        told += [each.text for each in outputs.published.events]
    assert told == ["link lost: no answer", "link up"] * 3


def event(text: str, at_s: float, about: str = "west") -> Event:
    return Event(at_s, Level.WARNING, about, text)


def test_a_lasting_cause_is_told_once_in_a_while() -> None:
    state, told = begin(NOW_S), []
    for k in range(100):
        state, fresh = without_repeats(state, [event("bent", NOW_S + k)])
        told += [each.stamp_s - NOW_S for each in fresh]
    assert told == pytest.approx([0.0, REPEAT_S, 2.0 * REPEAT_S, 3.0 * REPEAT_S])


def test_different_causes_and_things_are_each_told() -> None:
    _, fresh = without_repeats(
        begin(NOW_S), [event("bent", NOW_S), event("blind", NOW_S), event("bent", NOW_S, "east"), event("bent", NOW_S)]
    )
    assert [(each.about, each.text) for each in fresh] == [("west", "bent"), ("west", "blind"), ("east", "bent")]


def test_what_was_told_is_not_remembered_for_ever() -> None:
    state = begin(NOW_S)
    for k in range(1000):
        state, _ = without_repeats(state, [event(f"cause {k}", NOW_S + k)])
    assert len(state.said_s) <= REPEAT_S + 1


def test_what_the_steering_holds_back_is_told_with_the_reason() -> None:
    (held,) = held_events({"d1": "drone d2 is in the way"}, NOW_S)
    assert (held.about, held.text, held.level) == ("d1", "held back: drone d2 is in the way", Level.WARNING)
    assert math.isclose(held.stamp_s, NOW_S)


def test_a_drone_that_an_operator_holds_is_not_moved_though_it_flies() -> None:
    assert known(all_up()).movable - known(all_up(), enabled=frozenset(ROOM.heads)).movable == {"c_sky"}
