"""What could hurt somebody at the edges: below the box, a raised floor, a pilot's hand, a computer that stumbles."""

from __future__ import annotations

import pytest

from camrig.messages import FlightState
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.fitness import unfit
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.packets import Command, Heartbeat, PositionTarget
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import MavlinkSection, VehicleSettings, check
from tests.mavlink_copter import BOTH, STEP_S, Flight

HIGH = DroneSpec("d1", ((0.0, 0.0, 2.2), (5.0, 3.0, 3.0)), min_separation_m=0.8, speed_m_s=0.8)


def stopped_below_its_box(flavour: Flavour) -> Flight:
    flight = Flight(flavour, spec=HIGH)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.run(20.0, lambda: flight.copter.position_m[2] > 0.5)
    flight.vehicle.stop(flight.now_s)
    return flight


@BOTH
def test_a_stop_far_below_the_box_holds_there_and_does_not_land(flavour: Flavour) -> None:
    flight = stopped_below_its_box(flavour)
    flight.run(5.0)
    assert flight.vehicle.phase is Phase.HOLDING
    assert flight.vehicle.reason == ""
    assert 0.3 < flight.copter.position_m[2] < 0.9


@BOTH
def test_what_was_stopped_below_its_box_can_be_resumed_and_rises_into_it(flavour: Flavour) -> None:
    flight = stopped_below_its_box(flavour)
    flight.run(2.0)
    flight.vehicle.resume(flight.now_s)
    flight.run(8.0)
    assert flight.vehicle.phase is Phase.FLYING
    assert flight.copter.position_m[2] == pytest.approx(2.2, abs=0.05)


@BOTH
def test_what_holds_below_its_box_is_landed_where_it_sinks_all_the_same(flavour: Flavour) -> None:
    flight = Flight(flavour, spec=HIGH)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.run(20.0, lambda: flight.copter.position_m[2] > 1.7)
    flight.vehicle.stop(flight.now_s)
    flight.run(1.0)
    assert flight.vehicle.phase is Phase.HOLDING
    for _ in range(150):  # by and by, so that no jump tells
        x, y, z = flight.copter.position_m
        flight.copter.position_m = (x, y, z - 0.03)
        flight.run(STEP_S)
    assert "outside its box: it lands" in flight.vehicle.reason


@BOTH
def test_what_is_told_to_hold_and_drifts_away_is_landed(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.stop(flight.now_s)
    for _ in range(300):
        x, y, z = flight.copter.position_m
        flight.copter.position_m = (x + 0.03, y, z)
        flight.run(STEP_S)
    assert "from its set-point" in flight.vehicle.reason
    assert flight.vehicle.phase in {Phase.LANDING, Phase.DESCENDING, Phase.PASSIVE}


@BOTH
def test_over_a_raised_floor_it_climbs_clear_of_it_before_the_first_set_point(flavour: Flavour) -> None:
    """At lift-off a set-point would cancel ArduPilot's take-off, and 0.1 m is no climb."""
    settings = VehicleSettings(floor_m=0.9)
    flight = Flight(flavour, settings, bias_m=(0.0, 0.0, 0.9))
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.FLYING)
    assert flight.vehicle.seen.height_m > 1.3
    if flavour is ARDUCOPTER:
        (take_off,) = [said for _, said in flight.said if isinstance(said, Command) and said.command == 22]
        assert take_off.params[6] == pytest.approx(0.7)
    flight.run(3.0)
    assert flight.vehicle.phase is Phase.FLYING
    assert flight.vehicle.seen.height_m > 1.3


def test_a_floor_too_near_to_the_top_of_the_box_is_a_fault_of_the_section() -> None:
    thin = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 1.5)), min_separation_m=0.8, speed_m_s=0.8)
    section = MavlinkSection(url="udp://127.0.0.1:14550", floor_m=0.9)
    ((name, key, text),) = check({"d1": (thin, section)})
    assert (name, key) == ("d1", "floor_m")
    assert "0.8 m is the most" in text
    flight = Flight(PX4, spec=thin, position_m=(1.0, 1.0, 0.9))
    flight.run(2.0)
    assert "plausible" in "; ".join(unfit(flight.vehicle, flight.now_s))


@BOTH
def test_what_is_sent_up_counts_as_taking_off_before_it_says_so(flavour: Flavour) -> None:
    """Its link may be lost in between; drones under way must keep clear of the place all the same."""
    flight = Flight(flavour)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.CLIMBING)
    flight.vehicle.report.readings.clear()
    assert flight.run(0.1, lambda: bool(flight.vehicle.report.readings))
    assert flight.vehicle.seen.on_ground
    assert flight.vehicle.report.readings[-1].flight is FlightState.TAKING_OFF


def test_arming_is_ordered_once() -> None:
    """A pilot who disarms before its heartbeat tells that it was armed must not see it armed again."""
    flight = Flight(ARDUCOPTER)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.ARMING)
    flight.copter.silent = True
    flight.run(0.1)
    assert flight.copter.armed
    flight.copter.armed = False  # the pilot
    flight.copter.silent = False
    flight.run(12.0)
    assert flight.commands().count(400) == 1
    assert not flight.copter.armed
    assert "it does not arm" in flight.vehicle.reason


@BOTH
def test_a_pilot_who_disarms_on_the_ground_ends_the_take_off_at_the_next_heartbeat(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.CLIMBING)
    flight.vehicle.hear(Heartbeat(flavour.autopilot, 1, flavour.ours), flight.now_s)
    assert flight.vehicle.phase is Phase.PASSIVE
    since_s = flight.now_s
    flight.run(3.0)
    assert flight.commands(since_s) == []
    assert flight.set_points(since_s) == []


@BOTH
def test_a_computer_that_stumbles_again_and_again_hears_silence_all_the_same(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.copter.blind = True
    since_s = flight.now_s
    while flight.vehicle.phase is Phase.FLYING and flight.now_s < since_s + 5.0:
        for _ in range(34):
            flight.advance(STEP_S, hangs=True)
        flight.advance(STEP_S)
    assert flight.now_s < since_s + 1.5
    assert "no position" in flight.vehicle.reason


@BOTH
def test_an_old_word_about_the_battery_passes_no_check(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(2.0)
    assert flight.vehicle.seen.system is not None
    flight.vehicle.seen.system_s -= 3.1
    assert "SYS_STATUS" in "; ".join(unfit(flight.vehicle, flight.now_s))


@BOTH
def test_a_drone_that_no_longer_tells_its_battery_holds(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.copter.mute_status = True
    assert flight.reaches(Phase.HOLDING, 5.5)
    assert "battery and fence for 5 s: it holds" in flight.vehicle.reason


@BOTH
def test_a_hold_does_not_turn_to_a_heading_of_long_ago(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.go_to((2.0, 1.0, 1.5), 1.2)
    flight.run(1.0)
    flight.copter.yaw_rad = 0.2  # what it said last; then no ATTITUDE comes any more
    flight.run(0.05)
    flight.vehicle.seen.yaw_s = flight.now_s - 0.6
    flight.vehicle.seen.yaw_rad = 0.2
    flight.vehicle.stop(flight.now_s)
    (last,) = [said for said in flight.vehicle.tick(flight.now_s) if isinstance(said, PositionTarget)]
    assert last.yaw_ned_rad == pytest.approx(1.5707963 - 1.2)


def test_a_fault_before_lift_off_does_not_claim_that_it_holds() -> None:
    flight = Flight(PX4, battery=0.35)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.ARMING)
    flight.copter.bias_m = (9.0, 0.0, 0.0)
    flight.copter.armed = False
    flight.run(0.05)
    assert flight.vehicle.reason.endswith("outside its box: it stays down")


def test_px4_is_given_up_before_it_may_have_missed_a_set_point() -> None:
    """It counts 1 s between arrivals (COM_OF_LOSS_T), and would resume by itself, unseen, within one heartbeat."""
    flight = Flight(PX4)
    flight.take_off()
    for _ in range(90):
        flight.advance(STEP_S, hangs=True)
    flight.advance(STEP_S)
    assert flight.vehicle.phase is Phase.PASSIVE
    since_s = flight.now_s
    flight.run(8.0)
    assert flight.set_points(since_s) == []
    assert flight.copter.mode == PX4.land
