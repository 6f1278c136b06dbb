"""The vehicle logic in simulated time: an undisturbed flight, order by order."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from camrig.messages import FlightState
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.packets import (
    Command,
)
from camrig_drivers.mavlink.phase import Phase
from tests.mavlink_copter import BOTH, SPEC, STEP_S, Flight


@BOTH
def test_opening_asks_and_orders_nothing(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(10.0)
    asked = [said for _, said in flight.said if isinstance(said, Command)]
    assert sorted(said.params[0] for said in asked if said.command == 511) == sorted(
        [1.0, 30.0, 32.0, float(flavour.estimator_message), 245.0]
    )
    assert flight.commands() == []
    assert flight.set_points() == []
    assert flight.vehicle.seen.synchronised
    assert flight.vehicle.upkeep.parameters.complete


@BOTH
def test_take_off_ends_flying_at_the_lowest_height(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.run(3.0)
    assert flight.copter.position_m == pytest.approx((1.0, 1.0, 1.0), abs=0.01)
    assert flight.vehicle.reason == ""


def test_arducopter_gets_mode_arm_take_off_and_no_set_point_before_the_height() -> None:
    flight = Flight(ARDUCOPTER)
    flight.take_off()
    assert [command for command in flight.commands() if command != 178] == [176, 400, 22]
    assert all(stamp_s >= flight.now_s for stamp_s, _ in flight.set_points())


def test_px4_gets_set_points_before_its_mode_and_no_take_off() -> None:
    flight = Flight(PX4)
    flight.take_off()
    first_s = flight.set_points()[0][0]
    asked_s = next(stamp_s for stamp_s, said in flight.said if isinstance(said, Command) and said.command == 176)
    assert asked_s - first_s >= 0.9
    assert set(flight.commands()) == {176, 400}
    gaps_s = [b[0] - a[0] for a, b in pairwise(flight.set_points())]
    assert max(gaps_s) < 0.07


@BOTH
def test_set_point_goes_straight_at_its_speed_and_arrives(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.run(2.0)
    start_s = flight.now_s
    flight.vehicle.go_to((3.0, 2.0, 2.0), 1.2)
    flight.run(6.0)
    points = flight.set_points(start_s)
    for (a_s, a), (b_s, b) in pairwise(points):
        assert math.dist(a, b) <= SPEC.speed_m_s * (b_s - a_s) + 1e-9
        on_line = math.dist((1.0, 1.0, 1.0), b) + math.dist(b, (3.0, 2.0, 2.0))
        assert on_line == pytest.approx(math.sqrt(6.0), abs=0.02)
    assert flight.copter.position_m == pytest.approx((3.0, 2.0, 2.0), abs=1e-6)
    assert flight.copter.yaw_rad == pytest.approx(1.2)


@BOTH
def test_set_point_waits_for_a_drone_that_is_held_up(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.run(2.0)
    held_m = flight.copter.position_m
    flight.vehicle.go_to((4.0, 3.0, 2.0), 0.0)
    for _ in range(300):
        flight.run(STEP_S)
        flight.copter.position_m = held_m
    assert math.dist(flight.set_points()[-1][1], held_m) < 1.5 * SPEC.speed_m_s + 0.2


@BOTH
def test_stop_holds_here_at_once_and_disables(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.go_to((4.0, 3.0, 2.0), 0.0)
    flight.run(2.0)
    stopped_s, here_m = flight.now_s, flight.copter.position_m
    flight.vehicle.stop(flight.now_s)
    flight.vehicle.go_to((4.0, 3.0, 2.0), 0.0)
    flight.run(3.0)
    points = flight.set_points(stopped_s)
    assert points[0][0] == pytest.approx(stopped_s + STEP_S)
    assert all(math.dist(point, here_m) < 0.05 for _, point in points)
    assert flight.vehicle.phase is Phase.HOLDING


@BOTH
def test_resume_after_stop_follows_again_from_where_it_hovers(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.stop(flight.now_s)
    flight.run(1.0)
    since_s = flight.now_s
    flight.vehicle.resume(flight.now_s)
    assert flight.vehicle.phase is Phase.FLYING
    flight.run(1.0)
    assert set(flight.commands(since_s)) <= {178}
    assert math.dist(flight.copter.position_m, (1.0, 1.0, 1.0)) < 0.1


@BOTH
def test_stop_before_lift_off_ends_on_the_ground(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(1.5)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.CLIMBING)
    flight.vehicle.stop(flight.now_s)
    flight.run(5.0)
    assert flight.copter.position_m[2] < 0.1
    flight.copter.armed = False  # DISARM_DELAY
    assert flight.reaches(Phase.PASSIVE, 3.0)


@BOTH
def test_land_is_asked_once_it_is_seen_and_ends_passive(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.copter.deaf = True
    flight.vehicle.land(flight.now_s)
    flight.run(0.5)
    flight.copter.deaf = False
    assert flight.reaches(Phase.DESCENDING, 3.0)
    descending_s = flight.now_s
    assert flight.reaches(Phase.PASSIVE)
    assert flight.commands(descending_s) == []
    assert flight.copter.landed_state == 1
    assert not flight.copter.armed


@BOTH
def test_stop_breaks_a_landing_off(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.land(flight.now_s)
    flight.run(0.2)
    assert flight.vehicle.phase is Phase.DESCENDING
    flight.vehicle.stop(flight.now_s)
    flight.run(3.0)
    assert flight.copter.mode == flavour.brake
    assert flight.copter.position_m[2] > 0.6


@BOTH
def test_release_leaves_it_standing(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.go_to((4.0, 3.0, 2.0), 0.0)
    flight.run(1.0)
    flight.vehicle.release(flight.now_s)
    flight.run(0.1)
    assert flight.vehicle.phase is (Phase.PASSIVE if flavour is PX4 else Phase.HOLDING)
    here_m = flight.copter.position_m
    for _ in range(500):  # nobody talks to it any more
        flight.now_s += STEP_S
        flight.copter.fly(STEP_S, flight.now_s)
    assert math.dist(flight.copter.position_m, here_m) < 0.1
    assert flight.copter.mode == flavour.brake
    assert flight.copter.armed


@BOTH
def test_flight_state_is_what_the_vehicle_says(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.run(1.0)
    flight.vehicle.land(flight.now_s)
    flight.reaches(Phase.PASSIVE)
    flight.run(0.2)
    states = [reading.flight for reading in flight.vehicle.report.readings]
    order = [state for before, state in pairwise(states) if state != before]
    assert order == [FlightState.TAKING_OFF, FlightState.FLYING, FlightState.LANDING, FlightState.GROUND]
