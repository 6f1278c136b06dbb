"""The vehicle logic in simulated time: failsafes, pilots, refusals, reboots, and everything at random."""

from __future__ import annotations

import math
from typing import Any

import pytest

from camrig_drivers.mavlink.fitness import unfit
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.packets import (
    Command,
    CommandAck,
    StatusText,
)
from camrig_drivers.mavlink.phase import Phase
from tests.mavlink_copter import BOTH, LOITER, STEP_S, Flight


@BOTH
def test_vehicle_found_in_the_air_is_left_alone_until_armed(flavour: Flavour) -> None:
    flight = Flight(flavour, position_m=(2.0, 2.0, 1.5), armed=True, landed_state=2, mode=LOITER)
    flight.run(5.0)
    flight.vehicle.stop(flight.now_s)
    flight.run(1.0)
    assert flight.commands() == []
    assert flight.set_points() == []
    flight.vehicle.arm(flight.now_s)
    assert flight.commands() == []
    flight.vehicle.resume(flight.now_s)
    assert flight.reaches(Phase.FLYING)
    flight.run(2.0)
    assert set(flight.commands()) - {178} == {176}
    assert flight.copter.position_m == pytest.approx((2.0, 2.0, 1.5), abs=0.01)


@BOTH
@pytest.mark.parametrize("stage", [Phase.ARMING, Phase.CLIMBING, Phase.FLYING, Phase.HOLDING])
def test_mode_taken_away_ends_every_set_point(flavour: Flavour, stage: Phase) -> None:
    flight = Flight(flavour, accepts_arming=stage is not Phase.ARMING)
    flight.run(1.5)
    flight.copter.deaf = stage is Phase.ARMING and flavour is ARDUCOPTER
    flight.vehicle.arm(flight.now_s)
    if stage is Phase.ARMING:
        flight.copter.deaf = False
        flight.copter.accepts_arming = True
    assert flight.reaches(Phase.FLYING if stage is Phase.HOLDING else stage)
    if stage is Phase.HOLDING:
        flight.vehicle.stop(flight.now_s)
        flight.run(0.1)
    flight.copter.enter(LOITER)
    flight.run(STEP_S)
    taken_s = flight.now_s
    flight.copter.enter(flavour.ours)  # whoever took it gives it back
    flight.run(5.0)
    assert flight.vehicle.phase is Phase.PASSIVE
    assert flight.set_points(taken_s) == []
    assert flight.commands(taken_s) == []
    assert "mode" in flight.vehicle.reason


def test_px4_set_points_that_we_interrupted_are_not_resumed() -> None:
    flight = Flight(PX4)
    flight.take_off()
    flight.now_s += 1.2  # our thread hung; PX4 is in its failsafe now, and would come back by itself
    flight.run(STEP_S)
    since_s = flight.now_s
    flight.run(2.0)
    assert flight.set_points(since_s) == []
    assert flight.vehicle.phase is Phase.PASSIVE


@BOTH
def test_reboot_in_flight_lets_go_and_asks_for_the_streams_again(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    since_s = flight.now_s
    flight.copter.booted_s = flight.now_s - 1.0
    flight.run(1.0)
    assert flight.vehicle.phase is Phase.PASSIVE
    assert flight.vehicle.reason == "it has rebooted"
    asked = [said for stamp_s, said in flight.said if stamp_s > since_s and isinstance(said, Command)]
    assert len([said for said in asked if said.command == 511]) >= 4


@BOTH
def test_refused_arming_gives_the_reason_and_nothing_more(flavour: Flavour) -> None:
    flight = Flight(flavour, accepts_arming=False)
    flight.run(1.5)
    flight.vehicle.arm(flight.now_s)
    assert flight.run(5.0, lambda: bool(flight.vehicle.reason))
    assert "battery low" in flight.vehicle.reason
    assert flight.reaches(Phase.PASSIVE, 3.0)
    assert flight.copter.position_m[2] == 0.0
    assert 22 not in flight.commands()


@BOTH
def test_refusal_of_another_ground_station_s_command_is_not_ours(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(1.5)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.ARMING)
    flight.vehicle.hear(CommandAck(400, 4, (254, 190)), flight.now_s)
    assert flight.reaches(Phase.FLYING)


def test_px4_that_does_not_take_hold_is_held_by_set_points() -> None:
    flight = Flight(PX4)
    flight.take_off()
    flight.vehicle.release(flight.now_s)
    flight.copter.enter(PX4.ours)
    for _ in range(600):
        flight.copter.queue.clear()
        flight.run(STEP_S)
        flight.copter.mode = PX4.ours
    assert flight.vehicle.phase is Phase.HOLDING
    assert flight.set_points(flight.now_s - 0.1)


def test_mode_that_is_accepted_but_not_taken_ends_the_attempt() -> None:
    flight = Flight(PX4)
    flight.run(1.5)
    flight.copter.set_points_since_s = 1e9  # as if no set-point ever came through; the acks say accepted
    flight.copter.last_set_point_s = 1e9
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.PASSIVE, 10.0)
    assert "does not take mode" in flight.vehicle.reason
    assert 400 not in flight.commands()


@BOTH
@pytest.mark.parametrize(
    ("jump_m", "phase", "reason"), [(1.2, Phase.HOLDING, "jumped"), (100.0, None, "outside its box")]
)
def test_estimate_that_jumps_stops_the_move(flavour: Flavour, jump_m: float, phase: Phase | None, reason: str) -> None:
    """A jump within reason is held, at the new estimate; one out of the room is landed. Neither is flown back."""
    flight = Flight(flavour)
    flight.take_off()
    flight.run(1.0)
    flight.vehicle.go_to((3.0, 2.0, 2.0), 0.0)
    flight.run(1.0)
    truly_m, since_s = flight.copter.position_m, flight.now_s
    flight.copter.bias_m = (0.0, 0.0, jump_m)
    flight.run(0.5)
    assert phase in {None, flight.vehicle.phase}
    assert reason in flight.vehicle.reason
    if phase is None:
        assert 21 in flight.commands(since_s)
    else:
        assert math.dist(flight.copter.position_m, truly_m) < 0.1


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"position_m": (9.0, 1.0, 0.0)}, "outside its box"),
        ({"position_m": (1.0, 1.0, 489.0)}, "plausible"),
        ({"position_m": (1.0, 1.0, -2.0)}, "plausible"),
        ({"prearm_ok": False}, "pre-arm"),
        ({"armed": True, "landed_state": 0}, "EXTENDED_SYS_STATE"),
    ],
)
def test_unfit_vehicle_is_named(change: dict[str, Any], text: str) -> None:
    flight = Flight(PX4, **change)
    flight.run(2.0)
    assert text in "; ".join(unfit(flight.vehicle, flight.now_s))


def test_fitness_needs_fresh_heartbeat_and_position() -> None:
    flight = Flight(ARDUCOPTER)
    assert "local position" in "; ".join(unfit(flight.vehicle, flight.now_s))
    flight.run(2.0)
    assert list(unfit(flight.vehicle, flight.now_s)) == []
    assert "local position" in "; ".join(unfit(flight.vehicle, flight.now_s + 1.0))
    assert "heartbeat" in "; ".join(unfit(flight.vehicle, flight.now_s + 4.0))


def test_on_the_ground_of_long_ago_is_not_believed_of_a_drone_that_a_pilot_may_have_taken_up() -> None:
    flight = Flight(ARDUCOPTER)
    flight.run(2.0)
    flight.copter.tells_landed, flight.copter.armed = False, True
    flight.run(3.5)
    assert "EXTENDED_SYS_STATE" in "; ".join(unfit(flight.vehicle, flight.now_s))


def test_long_texts_are_joined_from_their_chunks() -> None:
    flight = Flight(PX4)
    for packet in [StatusText(2, "x" * 50, 7, 0), StatusText(2, "y" * 50, 7, 1), StatusText(2, "end\t", 7, 2)]:
        flight.vehicle.hear(packet, flight.now_s)
    assert flight.vehicle.seen.last_warning == "x" * 50 + "y" * 50 + "end"
