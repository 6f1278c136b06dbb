"""Every fault in flight has its named action, taken by us and in time; nothing is flown again without an operator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.packets import Command, Estimator
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import VehicleSettings
from tests.mavlink_copter import BOTH, HEALTHY, LOITER, STEP_S, Copter, Flight

FAR_M = (4.5, 2.5, 2.0)
HOLD, LAND = Phase.HOLDING, Phase.DESCENDING


@dataclass(frozen=True)
class Case:
    """What happens, what is done about it within ``within_s``, and what is said."""

    happens: Callable[[Copter], None]
    ends: Phase
    within_s: float
    says: str


def setting(**values: object) -> Callable[[Copter], None]:
    def set_all(copter: Copter) -> None:
        for name, value in values.items():
            setattr(copter, name, value)

    return set_all


CASES = {
    "no position": Case(setting(blind=True), HOLD, 0.6, "no position from the autopilot for 0.5 s: it holds"),
    "no position for long": Case(setting(blind=True), LAND, 1.7, "no position from the autopilot for 1.5 s: it lands"),
    "battery": Case(setting(battery=0.15), LAND, 2.4, "battery at 15 %: it lands"),
    "estimator": Case(setting(estimator=HEALTHY & ~32), LAND, 0.9, "its estimator has no height: it lands"),
    "estimator stands": Case(setting(estimator=HEALTHY | 128), LAND, 0.9, "assumes that it stands still"),
    "jump": Case(setting(bias_m=(1.0, 0.0, 0.0)), HOLD, 0.1, "m: it holds"),
    "jump out of the room": Case(setting(bias_m=(0.0, 0.0, -489.0)), LAND, 0.1, "outside its box: it lands"),
}


def flown(flavour: Flavour, settings: VehicleSettings | None = None) -> Flight:
    flight = Flight(flavour, settings)
    flight.take_off()
    flight.vehicle.go_to(FAR_M, 0.0)
    flight.run(1.0)
    return flight


@BOTH
@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_fault_is_acted_on(flavour: Flavour, case: Case) -> None:
    flight = flown(flavour)
    case.happens(flight.copter)
    highest_m = flight.copter.position_m[2]
    assert flight.reaches(case.ends, case.within_s), flight.vehicle.phase
    assert case.says in flight.vehicle.reason
    here_m, since_s = flight.copter.position_m, flight.now_s
    flight.vehicle.go_to(FAR_M, 0.0)
    flight.run(1.0)
    assert math.dist(flight.copter.position_m[:2], here_m[:2]) < 0.35  # it brakes
    assert flight.copter.position_m[2] < highest_m + 0.15
    assert not {176, 400, 22} & set(flight.commands(since_s))


@BOTH
def test_what_holds_after_a_fault_goes_on_only_when_an_operator_says_so(flavour: Flavour) -> None:
    flight = flown(flavour)
    flight.copter.blind = True
    assert flight.reaches(HOLD, 0.7)
    flight.copter.blind = False
    here_m = flight.copter.position_m
    flight.run(5.0)
    assert flight.vehicle.phase is HOLD
    assert math.dist(flight.copter.position_m, here_m) < 0.1
    flight.vehicle.resume(flight.now_s)
    flight.vehicle.go_to(FAR_M, 0.0)
    flight.run(8.0)
    assert math.dist(flight.copter.position_m, FAR_M) < 0.05


@BOTH
@pytest.mark.parametrize("away_m", [(-2.2, 0.0, 0.0), (0.0, 0.0, 4.0)], ids=["sideways", "too high"])
def test_a_climb_that_leaves_its_box_is_landed(flavour: Flavour, away_m: tuple[float, float, float]) -> None:
    """By and by, so that no jump tells."""
    flight = Flight(flavour)
    flight.run(2.0)
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.CLIMBING)
    flight.copter.climb_to_m = flight.copter.target_m = None
    for share in range(100):
        x, y, z = (share / 100.0 * away for away in away_m)
        flight.copter.bias_m = (x, y, z)
        flight.copter.target_m = None
        flight.copter.landed_state = 1
        flight.advance(STEP_S)
    assert flight.vehicle.phase in {Phase.LANDING, LAND, Phase.PASSIVE}
    assert "outside its box: it lands" in flight.vehicle.reason


@BOTH
def test_positions_that_come_often_but_late_are_not_flown_by(flavour: Flavour) -> None:
    """A radio or an access point that queues: many positions a second, each older than the one before."""
    flight = flown(flavour)
    for _ in range(200):
        flight.delay_s += 0.5 * STEP_S
        flight.advance(STEP_S)
    assert flight.vehicle.phase is HOLD
    assert "no position from the autopilot for 0.5 s: it holds" in flight.vehicle.reason


@BOTH
def test_silence_stops_the_stream_and_asks_for_a_landing_until_it_is_heard(flavour: Flavour) -> None:
    """Both ways. When the link is back PX4 would follow a stream at once: there is none, and it lands."""
    flight = flown(flavour)
    flight.copter.silent = flight.copter.deaf = True
    flight.run(2.5)
    assert flight.vehicle.phase is Phase.LANDING
    assert flight.set_points(flight.now_s - 0.9) == []
    where_m = flight.copter.position_m
    flight.copter.silent = flight.copter.deaf = False
    assert flight.reaches(LAND, 1.5)
    assert flight.reaches(Phase.PASSIVE, 12.0)
    assert math.dist(flight.copter.position_m[:2], where_m[:2]) < 0.2


@BOTH
def test_low_battery_for_a_moment_of_thrust_is_no_fault(flavour: Flavour) -> None:
    flight = flown(flavour)
    flight.copter.battery = 0.1
    flight.run(1.0)
    flight.copter.battery = 0.5
    flight.run(3.0)
    assert flight.vehicle.phase is Phase.FLYING


def test_one_bad_word_of_the_estimator_is_no_fault_however_long_the_next_one_takes() -> None:
    flight = flown(ARDUCOPTER)
    watch, seen = flight.vehicle.watch, flight.vehicle.seen
    since_s = flight.now_s
    seen.hear(Estimator(HEALTHY, 1.7), since_s)
    for step in range(30):
        assert "estimator" not in {fault.name for fault in watch.faults(seen, since_s + 0.025 * step)}
    seen.hear(Estimator(HEALTHY, 1.7), since_s + 0.8)
    assert "estimator" in {fault.name for fault in watch.faults(seen, since_s + 0.8)}


@BOTH
def test_speed_beyond_reason_is_held(flavour: Flavour) -> None:
    """Measured: ArduCopter acked DO_CHANGE_SPEED and flew at 2.9 m/s."""
    flight = flown(flavour)
    flight.copter.reported_m_s = (2.9, 0.0, 0.0)
    flight.run(0.4)
    assert flight.vehicle.phase is HOLD
    assert "it flies at 2.9 m/s" in flight.vehicle.reason


@BOTH
def test_fence_breach_is_held(flavour: Flavour) -> None:
    flight = flown(flavour)
    flight.copter.fence_ok = False
    flight.run(0.3)
    assert flight.vehicle.phase is HOLD


@BOTH
def test_mode_taken_by_somebody_else_is_theirs_until_resume(flavour: Flavour) -> None:
    flight = flown(flavour)
    flight.copter.enter(LOITER)
    flight.run(STEP_S)
    taken_s = flight.now_s
    flight.run(1.0)
    flight.copter.enter(flavour.ours)  # and gives it back: PX4 would follow a stream at once
    flight.run(2.0)
    assert flight.vehicle.phase is Phase.PASSIVE
    assert flight.set_points(taken_s) == []
    assert flight.commands(taken_s) == []
    flight.vehicle.resume(flight.now_s)
    assert flight.reaches(Phase.FLYING, 3.0)


def test_arducopter_is_told_its_speed_at_each_entry_of_guided() -> None:
    flight = flown(ARDUCOPTER)
    speed_m_s = flight.vehicle.spec.speed_m_s
    assert flight.copter.speeds == [(1, speed_m_s), (2, speed_m_s), (3, speed_m_s)]
    flight.copter.enter(LOITER)
    flight.run(0.5)
    flight.vehicle.resume(flight.now_s)
    assert flight.reaches(Phase.FLYING, 3.0)
    flight.run(0.5)
    assert len(flight.copter.speeds) == 6


def test_px4_is_not_asked_about_its_gimbal_for_ever() -> None:
    """It never answers without a gimbal module: three times each, then it is said."""
    flight = Flight(PX4, VehicleSettings(gimbal=True))
    flight.take_off()
    flight.run(10.0)
    gimbal = [said.command for _, said in flight.said if isinstance(said, Command) and said.command in {1000, 1001}]
    assert gimbal == [1001] * 3 + [1000] * 3
    assert flight.vehicle.errands.refused == {1001: "not answered", 1000: "not answered"}


def test_arducopter_points_its_gimbal_down_when_taken_over_and_not_before() -> None:
    flight = Flight(ARDUCOPTER, VehicleSettings(gimbal=True))
    flight.run(3.0)
    assert flight.commands() == []
    flight.vehicle.arm(flight.now_s)
    flight.run(0.5)
    (pointed,) = [said for _, said in flight.said if isinstance(said, Command) and said.command == 1000]
    assert pointed.params[:2] == (-90.0, 0.0)
    assert all(map(math.isnan, pointed.params[2:4]))


@BOTH
def test_height_that_has_wandered_is_levelled_on_the_ground(flavour: Flavour) -> None:
    """Measured: after a landing PX4 read 0.73 m. The climb to 1 m is a metre all the same."""
    flight = Flight(flavour, bias_m=(0.0, 0.0, 0.73))
    flight.take_off()
    flight.run(3.0)
    assert flight.copter.position_m[2] == pytest.approx(1.0, abs=0.05)
    flight.vehicle.go_to((2.0, 1.0, 2.0), 0.0)
    flight.run(5.0)
    assert flight.copter.position_m == pytest.approx((2.0, 1.0, 2.0), abs=0.05)


def test_a_computer_that_stood_still_does_not_take_that_for_silence() -> None:
    """ArduCopter keeps its target meanwhile; PX4 has lost the stream, which is another test."""
    flight = flown(ARDUCOPTER)
    for _ in range(200):
        flight.advance(STEP_S, hangs=True)
    flight.copter.blind = True
    flight.advance(STEP_S)
    assert flight.vehicle.phase is Phase.FLYING
    assert flight.reaches(HOLD, 0.6)
