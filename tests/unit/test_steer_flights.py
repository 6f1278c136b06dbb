"""Whole flights: whatever plan follows, drones keep apart and out of keep-out boxes, and all arrive that can."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.messages import DroneAim, DroneCommand, RigPose
from camrig.rig import Box, CameraSpec, DroneMount, DroneSpec, Rig, Space
from camrig.steer import SteerState, steer
from tests.simulated_flights import LENS, SETTINGS, TICK_S, Scenario, Seen, fly, scenario, sequence_exists

SEPARATION_M = 0.8
APART_SLACK_M = 0.02
"""Steering's own centimetre for the drift of hovering, and what two drones drift while they fly."""
DRIFT_SLACK_M = 0.01
BOX: Box = ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5))
FLIGHTS, PLANS = 2500, 4


def random_scenario(seed: int, plans: int, *, troubles: bool) -> tuple[Scenario, np.random.Generator]:
    rng = np.random.default_rng(seed)
    count, keep_outs = int(rng.integers(2, 7)), int(rng.integers(0, 4))
    return scenario(rng, count, keep_outs, plans, troubles=troubles), rng


def assert_safe(seen: Seen) -> None:
    assert seen.separation_m >= -APART_SLACK_M
    assert seen.box_m >= -DRIFT_SLACK_M
    assert seen.keep_out_m >= -DRIFT_SLACK_M
    assert seen.told_m >= 0.0
    assert set(seen.late) <= set(seen.held)


def assert_all_arrive_that_can(drawn: Scenario, seen: Seen) -> None:
    assert not seen.late or not sequence_exists(drawn)


@settings(deadline=None, max_examples=40)
@given(st.integers(2, 6), st.integers(0, 3), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_flights_are_safe_whatever_plan_or_trouble_comes(count: int, keep_outs: int, plans: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert_safe(fly(scenario(rng, count, keep_outs, plans, troubles=True), rng))


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_all_arrive_where_they_could_one_after_the_other(count: int, keep_outs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = scenario(rng, count, keep_outs, 1, troubles=False)
    seen = fly(drawn, rng)
    assert_safe(seen)
    assert_all_arrive_that_can(drawn, seen)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", range(4))
def test_separation_holds_along_the_paths_of_ten_thousand_plans(part: int) -> None:
    for seed in range(part * FLIGHTS // 4, (part + 1) * FLIGHTS // 4):
        drawn, rng = random_scenario(seed, PLANS, troubles=True)
        assert_safe(fly(drawn, rng))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", range(4))
def test_all_arrive_that_can_in_a_thousand_moves(part: int) -> None:
    for seed in range(10_000 + 250 * part, 10_000 + 250 * (part + 1)):
        drawn, rng = random_scenario(seed, 1, troubles=False)
        seen = fly(drawn, rng)
        assert_safe(seen)
        assert_all_arrive_that_can(drawn, seen)


# --- one thing at a time --------------------------------------------------------------------------------------

Point = tuple[float, float, float]


def drone_rig(count: int, keep_out: tuple[Box, ...] = (), box: Box = BOX) -> Rig:
    drones = {f"d{i}": DroneSpec(f"d{i}", box, SEPARATION_M, 0.5) for i in range(count)}
    cameras = {f"c{i}": CameraSpec(f"c{i}", LENS, DroneMount(f"d{i}", np.eye(4))) for i in range(count)}
    return Rig("r", Space(keep_out_m=keep_out), cameras, drones=drones)


def flown(rig: Rig, starts: dict[str, Point], ends: dict[str, Point]) -> Seen:
    places = {name: np.array(place) for name, place in ends.items()}
    drawn = Scenario(rig, {name: np.array(place) for name, place in starts.items()}, ((0.0, places),))
    seen = fly(drawn, np.random.default_rng(1))
    assert_safe(seen)
    return seen


def told(
    rig: Rig,
    ends: dict[str, Point],
    at: dict[str, Point],
    state: SteerState | None = None,
    now_s: float = 0.0,
    aloft: dict[str, Point] | None = None,
) -> tuple[SteerState, dict[str, Point]]:
    goal = {f"c{name[1:]}": DroneAim(place) for name, place in ends.items()}
    drones = {name: DroneAim(place) for name, place in at.items()}
    pose = RigPose(drones=drones, aloft={name: DroneAim(place) for name, place in (aloft or {}).items()})
    state, commands = steer(state or SteerState(), goal, pose, frozenset(goal), rig, SETTINGS, now_s)
    return state, {c.drone_id: c.aim.position_m for c in commands if isinstance(c, DroneCommand)}


def test_two_drones_that_want_each_others_places_pass_round_each_other() -> None:
    here, there = (1.0, 1.5, 1.5), (4.0, 1.5, 1.5)
    assert flown(drone_rig(2), {"d0": here, "d1": there}, {"d0": there, "d1": here}).late == ()


def test_where_there_is_no_room_to_pass_drones_stay_and_say_why() -> None:
    corridor: Box = ((0.0, 0.0, 1.0), (5.0, 0.5, 2.5))
    here, there = (1.0, 0.2, 1.5), (4.0, 0.2, 1.5)
    seen = flown(drone_rig(2, box=corridor), {"d0": here, "d1": there}, {"d0": there, "d1": here})
    assert seen.held == {"d0": "drone d1 is in the way", "d1": "drone d0 is in the way"}


def test_a_drone_flies_round_a_keep_out_box() -> None:
    rig = drone_rig(1, keep_out=(((2.0, 0.0, 0.0), (2.5, 2.0, 3.0)),))
    assert flown(rig, {"d0": (1.0, 1.0, 1.5)}, {"d0": (4.0, 1.0, 1.5)}).late == ()


def test_who_would_end_in_anothers_way_goes_after_it() -> None:
    at, ends = {"d0": (1.0, 1.0, 1.5), "d1": (2.0, 2.0, 1.5)}, {"d0": (4.0, 1.0, 1.5), "d1": (2.5, 1.0, 1.5)}
    state, commands = told(drone_rig(2), ends, at)
    assert set(commands) == {"d0"}
    assert state.held == {"d1": "drone d0 goes first"}
    assert flown(drone_rig(2), at, ends).late == ()


def test_nobody_waits_for_who_can_never_go() -> None:
    rig = drone_rig(2, keep_out=(((2.5, 0.0, 0.0), (3.0, 3.0, 3.0)),))
    at, ends = {"d0": (1.0, 1.0, 1.5), "d1": (1.0, 2.5, 1.5)}, {"d0": (4.0, 1.0, 1.5), "d1": (2.0, 1.2, 1.5)}
    seen = flown(rig, at, ends)
    assert seen.late == ("d0",)
    assert seen.held == {"d0": "a keep-out box is in the way"}


def test_who_is_on_the_way_goes_on_though_another_has_less_to_fly() -> None:
    at, ends = {"d0": (1.0, 1.5, 1.5), "d1": (4.0, 2.6, 1.5)}, {"d0": (4.5, 1.5, 1.5), "d1": (4.0, 2.6, 1.5)}
    state, commands = told(drone_rig(2), ends, at)
    assert set(commands) == {"d0"}
    state, commands = told(drone_rig(2), ends | {"d1": (4.0, 0.5, 1.5)}, at | {"d0": (1.3, 1.5, 1.5)}, state, 0.6)
    assert set(commands) == {"d0"}
    assert state.held == {"d1": "drone d0 is in the way"}


def test_a_drone_that_may_not_be_moved_any_more_flies_on_to_its_set_point() -> None:
    rig, at = drone_rig(2), {"d0": (1.0, 1.5, 1.5), "d1": (2.4, 2.5, 1.5)}
    state, commands = told(rig, {"d0": (4.0, 1.5, 1.5)}, at)
    assert commands == {"d0": (1.5, 1.5, 1.5)}
    # Beside where d0 still is there is room; beside where it flies there is none.
    ends = {"d1": (2.0, 1.6, 1.5)}
    state, commands = told(rig, ends, at, state, 0.1)
    assert commands == {}
    assert state.held == {"d1": "drone d0 is in the way"}
    # It did not come: it was stopped.
    assert set(told(rig, ends, at, state, 2.5)[1]) == {"d1"}


def test_a_drone_that_is_not_heard_of_is_kept_clear_of_where_it_was_and_where_it_flies() -> None:
    rig, at = drone_rig(2), {"d0": (1.0, 1.5, 1.5), "d1": (2.4, 2.5, 1.5)}
    state, _ = told(rig, {"d0": (4.0, 1.5, 1.5)}, at)
    unheard, heard = {"d0": at["d0"]}, {"d1": at["d1"]}
    for place in ((1.0, 2.0, 2.4), (2.0, 1.6, 1.5)):
        after, commands = told(rig, {"d1": place}, heard, state, 60.0, aloft=unheard)
        assert commands == {}
        assert after.held == {"d1": "drone d0 is in the way"}
    # On the ground it is in nobody's way.
    assert set(told(rig, {"d1": (2.0, 1.6, 1.5)}, heard, state, 60.0)[1]) == {"d1"}


def test_a_drone_that_is_told_to_turn_may_fly_on_before_it_does() -> None:
    rig, at = drone_rig(2), {"d0": (1.0, 1.5, 1.5), "d1": (2.35, 1.5, 1.5)}
    state, commands = told(rig, {"d0": (1.5, 1.5, 1.5)}, at)
    assert commands == {"d0": (1.5, 1.5, 1.5)}
    # Straight to the new place d0 would keep clear of d1; round its set-point's corner it would not.
    at["d1"] = (1.9, 2.3, 1.5)
    state, commands = told(rig, {"d0": (1.0, 2.5, 1.5)}, at, state, 0.2)
    assert commands == {}
    assert state.held == {"d0": "drone d1 is in the way"}


def test_a_drone_outside_its_box_comes_in_the_shortest_way_first() -> None:
    state, commands = told(drone_rig(1), {"d0": (4.0, 1.0, 1.5)}, {"d0": (1.0, -0.4, 1.5)})
    assert commands == {"d0": (1.0, 0.0, 1.5)}
    _, commands = told(drone_rig(1), {"d0": (4.0, 1.0, 1.5)}, {"d0": (1.0, 0.0, 1.5)}, state, 1.0)
    assert commands["d0"][0] > 1.3


def test_a_drone_inside_a_keep_out_box_leaves_it_the_way_it_came_in() -> None:
    rig, at = drone_rig(1, keep_out=(((2.0, 0.0, 0.0), (3.0, 3.0, 3.0)),)), {"d0": (2.004, 1.0, 1.5)}
    assert set(told(rig, {"d0": (1.0, 2.0, 1.5)}, at)[1]) == {"d0"}
    state, commands = told(rig, {"d0": (4.0, 1.0, 1.5)}, at)
    assert commands == {}
    assert state.held == {"d0": "a keep-out box is in the way"}


def test_a_small_move_is_made_only_where_it_makes_way() -> None:
    rig = drone_rig(2)
    at, ends = {"d0": (1.0, 1.5, 1.5), "d1": (4.0, 1.5, 1.5)}, {"d0": (0.975, 1.5, 1.5), "d1": (1.775, 1.5, 1.5)}
    assert told(rig, {"d0": ends["d0"]}, at)[1] == {}
    state, commands = told(rig, ends, at)
    assert commands == {}
    assert told(rig, ends, at, state, TICK_S)[1] == {"d0": ends["d0"]}
    assert flown(rig, at, ends).late == ()


def test_the_end_of_a_move_is_told_exactly() -> None:
    rig, end = drone_rig(1), (1.51, 1.5, 1.5)
    state, commands = told(rig, {"d0": end}, {"d0": (1.0, 1.5, 1.5)})
    assert commands == {"d0": (1.5, 1.5, 1.5)}
    assert told(rig, {"d0": end}, {"d0": (1.02, 1.5, 1.5)}, state, TICK_S)[1] == {"d0": end}
    assert math.dist(end, commands["d0"]) < SETTINGS.dead_band_m
