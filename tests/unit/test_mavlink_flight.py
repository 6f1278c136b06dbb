"""The vehicle logic in simulated time against a small scripted copter that has the habits of docs and measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.messages import FlightState
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.fitness import inside, unfit
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.frames import Vector, ned_from_world, world_from_ned, yaw_enu_from_ned, yaw_ned_from_enu
from camrig_drivers.mavlink.packets import (
    Attitude,
    Command,
    CommandAck,
    ExtendedState,
    Heard,
    Heartbeat,
    LocalPosition,
    PositionTarget,
    Said,
    StatusText,
    SystemStatus,
)
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.telemetry import Telemetry
from camrig_drivers.mavlink.vehicle import Vehicle

ORIGIN_M = (0.5, 0.2, 0.0)
SPEC = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=0.8)
STEP_S = 0.01
BOTH = pytest.mark.parametrize("flavour", [ARDUCOPTER, PX4], ids=lambda flavour: str(flavour.name))
LOITER, POSCTL = 5, 0x00030000


@dataclass
class Copter:
    """A point that follows set-points at 2 m/s at most, and what an autopilot makes of packets."""

    flavour: Flavour
    position_m: Vector = (1.0, 1.0, 0.0)
    yaw_rad: float = 0.3
    mode: int = 0
    armed: bool = False
    landed_state: int = 1
    accepts_arming: bool = True
    deaf: bool = False
    silent: bool = False
    prearm_ok: bool = True
    climb_to_m: float | None = None
    target_m: Vector | None = None
    booted_s: float = 0.0
    last_set_point_s: float = -1e9
    set_points_since_s: float = 0.0
    armed_s: float = 0.0
    queue: list[Heard] = field(default_factory=list)

    def take(self, said: Said, now_s: float) -> None:
        if self.deaf:
            return
        match said:
            case PositionTarget(position_ned_m=point, yaw_ned_rad=yaw):
                if now_s - self.last_set_point_s > 1.0:
                    self.set_points_since_s = now_s
                self.last_set_point_s = now_s
                if self.mode == self.flavour.ours:
                    self._aim(world_from_ned(point, ORIGIN_M), yaw_enu_from_ned(yaw))
            case Command(command=command, params=params):
                self._command(command, params, now_s)

    def _aim(self, point_m: Vector, yaw_rad: float) -> None:
        if self.landed_state == 1 and self.climb_to_m is not None:
            self.climb_to_m = None  # measured: a set-point before lift-off cancels the take-off, silently
        if self.landed_state != 1 or self.flavour is PX4:
            self.target_m, self.yaw_rad, self.climb_to_m = point_m, yaw_rad, None

    def _command(self, command: int, params: tuple[float, ...], now_s: float) -> None:
        result = 0
        if command == 176:
            mode = int(params[1]) << 16 | int(params[2]) << 24 if self.flavour is PX4 else int(params[1])
            streamed = now_s - self.last_set_point_s < 0.5 and now_s - self.set_points_since_s > 0.5
            if mode != PX4.ours or streamed:  # PX4 accepts all the same
                self.enter(mode)
        elif command == 400:
            result = 0 if self.accepts_arming else 4
            self.armed, self.armed_s = self.armed or self.accepts_arming, now_s
            if result:
                self.queue.append(StatusText(2, "Arm: battery low"))
        elif command == 22:
            fit = self.mode == self.flavour.ours and self.armed and self.landed_state == 1
            result = 0 if fit else 4
            if fit:
                self.climb_to_m = self.position_m[2] + params[6]
        elif command == 21:
            self.enter(self.flavour.land)
        self.queue.append(CommandAck(command, result, (255, 190)))

    def enter(self, mode: int) -> None:
        self.mode, self.climb_to_m, self.target_m = mode, None, self.position_m
        self.queue.append(self.heartbeat())

    def heartbeat(self) -> Heartbeat:
        return Heartbeat(self.flavour.autopilot, 1 | 128 * self.armed, self.mode)

    def fly(self, dt_s: float, now_s: float) -> None:
        if self.flavour is PX4 and self.mode == PX4.ours and now_s - self.last_set_point_s > 1.0 and self.armed:
            self.enter(0x05040000)  # return to launch
        if self.mode == self.flavour.land:
            self.target_m = (*self.position_m[:2], 0.0)
        if self.armed and self.climb_to_m is not None and now_s - self.armed_s > 0.5:
            self.target_m = (*self.position_m[:2], self.climb_to_m)
        if not self.armed or self.target_m is None:
            return
        speed_m_s = 0.5 if self.mode == self.flavour.land else 2.0
        self.position_m = towards(self.position_m, self.target_m, speed_m_s * dt_s)
        if self.position_m[2] > 0.05:
            self.landed_state = 4 if self.mode == self.flavour.land else 2
        elif self.mode == self.flavour.land:
            self.landed_state, self.armed = 1, False

    def telemetry(self, step: int, now_s: float) -> Iterator[Heard]:
        boot_ms = round((now_s - self.booted_s) * 1e3)
        yield from self.queue
        self.queue = []
        if step % 3 == 0:
            yield Attitude(boot_ms, 0.0, 0.0, yaw_ned_from_enu(self.yaw_rad))
            yield LocalPosition(boot_ms, ned_from_world(self.position_m, ORIGIN_M))
        if step % 20 == 0:
            yield ExtendedState(self.landed_state)
            prearm = 0x10000000
            yield SystemStatus(prearm, prearm, prearm if self.prearm_ok else 0)
        if step % 100 == 0:
            yield self.heartbeat()


def towards(a: Vector, b: Vector, step_m: float) -> Vector:
    fraction = min(1.0, step_m / max(math.dist(a, b), 1e-9))
    x, y, z = (p + fraction * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z


class Flight:
    """A vehicle, a copter and a clock that only this moves."""

    def __init__(self, flavour: Flavour, **copter: object) -> None:
        self.copter = Copter(flavour, **copter)  # type: ignore[arg-type]
        self.now_s = 100.0
        self.step = 0
        self.said: list[tuple[float, Said]] = []
        seen = Telemetry(SPEC.id, ORIGIN_M, self.copter.heartbeat(), self.now_s)
        self.vehicle = Vehicle(SPEC, flavour, seen, stream_hz=30.0)

    def run(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time go by, at most ``duration_s``; return whether ``until`` came true."""
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            self.step += 1
            self.copter.fly(STEP_S, self.now_s)
            for packet in [] if self.copter.silent else list(self.copter.telemetry(self.step, self.now_s)):
                self.vehicle.hear(packet, self.now_s)
            for said in self.vehicle.tick(self.now_s):
                self.said.append((self.now_s, said))
                self.copter.take(said, self.now_s)
            if until():
                return True
        return False

    def reaches(self, phase: Phase, within_s: float = 20.0) -> bool:
        return self.run(within_s, lambda: self.vehicle.phase is phase)

    def take_off(self) -> None:
        self.run(1.5)
        self.vehicle.arm(self.now_s)
        assert self.reaches(Phase.FLYING)

    def set_points(self, since_s: float = 0.0) -> list[tuple[float, Vector]]:
        return [
            (stamp_s, world_from_ned(said.position_ned_m, ORIGIN_M))
            for stamp_s, said in self.said
            if isinstance(said, PositionTarget) and stamp_s > since_s
        ]

    def commands(self, since_s: float = 0.0) -> list[int]:
        """Everything asked for but message rates."""
        commands = [said.command for stamp_s, said in self.said if isinstance(said, Command) and stamp_s > since_s]
        return [command for command in commands if command != 511]


@BOTH
def test_opening_asks_for_streams_and_nothing_else(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(10.0)
    asked = [said for _, said in flight.said if isinstance(said, Command)]
    assert len(asked) == len(flight.said) == 4
    assert {(said.command, said.params[0]) for said in asked} == {(511, 30.0), (511, 32.0), (511, 245.0), (511, 1.0)}


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
    assert flight.commands() == [176, 400, 22]
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
def test_arm_after_stop_resumes_where_it_hovers(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.vehicle.stop(flight.now_s)
    flight.run(1.0)
    asked = len(flight.commands())
    flight.vehicle.arm(flight.now_s)
    assert flight.vehicle.phase is Phase.FLYING
    flight.run(1.0)
    assert len(flight.commands()) == asked
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
def test_vehicle_found_in_the_air_is_left_alone_until_armed(flavour: Flavour) -> None:
    flight = Flight(flavour, position_m=(2.0, 2.0, 1.5), armed=True, landed_state=2, mode=LOITER)
    flight.run(5.0)
    flight.vehicle.stop(flight.now_s)
    flight.run(1.0)
    assert flight.commands() == []
    assert flight.set_points() == []
    flight.vehicle.arm(flight.now_s)
    assert flight.reaches(Phase.FLYING)
    flight.run(2.0)
    assert set(flight.commands()) == {176}
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
def test_estimate_that_jumps_stops_the_move(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.take_off()
    flight.run(1.0)
    flight.vehicle.go_to((3.0, 2.0, 2.0), 0.0)
    flight.run(1.0)
    x, y, z = flight.copter.position_m
    flight.copter.position_m = (x, y, z + 100.0)
    flight.run(0.5)
    assert flight.vehicle.phase is Phase.HOLDING
    assert "implausibly" in flight.vehicle.reason
    assert flight.set_points()[-1][1][2] == pytest.approx(z + 100.0, abs=2.0)


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
    states = [reading.flight for reading in flight.vehicle.readings]
    order = [state for before, state in pairwise(states) if state != before]
    assert order == [FlightState.TAKING_OFF, FlightState.FLYING, FlightState.LANDING, FlightState.GROUND]


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
def test_unfit_vehicle_is_named(change: dict[str, object], text: str) -> None:
    flight = Flight(PX4, **change)
    flight.run(2.0)
    assert text in (unfit(SPEC, PX4, flight.vehicle.seen, flight.now_s) or "")


def test_fitness_needs_fresh_heartbeat_and_position() -> None:
    flight = Flight(ARDUCOPTER)
    assert "local position" in (unfit(SPEC, ARDUCOPTER, flight.vehicle.seen, flight.now_s) or "")
    flight.run(2.0)
    assert unfit(SPEC, ARDUCOPTER, flight.vehicle.seen, flight.now_s) is None
    assert "local position" in (unfit(SPEC, ARDUCOPTER, flight.vehicle.seen, flight.now_s + 1.0) or "")
    assert "heartbeat" in (unfit(SPEC, ARDUCOPTER, flight.vehicle.seen, flight.now_s + 4.0) or "")


def test_long_texts_are_joined_from_their_chunks() -> None:
    flight = Flight(PX4)
    for packet in [StatusText(2, "x" * 50, 7, 0), StatusText(2, "y" * 50, 7, 1), StatusText(2, "end\t", 7, 2)]:
        flight.vehicle.hear(packet, flight.now_s)
    assert flight.vehicle.seen.last_warning == "x" * 50 + "y" * 50 + "end"


EVENTS = st.sampled_from(
    [
        "arm",
        "stop",
        "land",
        "go_near",
        "go_far",
        "failsafe",
        "back",
        "deaf",
        "hears",
        "silent",
        "speaks",
        "hang",
        "reboot",
    ]
)


@BOTH
@settings(max_examples=60, deadline=None)
@given(events=st.lists(st.tuples(EVENTS, st.sampled_from([0.03, 0.4, 1.5, 4.0])), max_size=14))
def test_whatever_happens_box_speed_and_permission_hold(flavour: Flavour, events: list[tuple[str, float]]) -> None:
    flight = Flight(flavour)
    flight.run(1.5)
    ordered = False
    for event, wait_s in events:
        ordered = ordered or event in {"arm", "land"}
        before = len(flight.said)
        allowed = flight.vehicle.phase is not Phase.PASSIVE or event in {"arm", "land"}
        disturb(flight, event)
        flight.run(wait_s)
        said = [item for item in flight.said[before:] if getattr(item[1], "command", 0) != 511]
        assert allowed or not said
        assert ordered or not flight.copter.armed
        highest_m = max([0.0, *(point[2] for _, point in flight.set_points())])
        assert highest_m <= SPEC.box_m[1][2] + 0.01
        assert all(inside((x, y, 1.0), SPEC.box_m) for _, (x, y, _) in flight.set_points())


def disturb(flight: Flight, event: str) -> None:
    vehicle, copter, now_s = flight.vehicle, flight.copter, flight.now_s
    if event == "arm" and unfit(SPEC, copter.flavour, vehicle.seen, now_s) is None:
        vehicle.arm(now_s)
    actions: dict[str, Callable[[], None]] = {
        "stop": lambda: vehicle.stop(now_s),
        "land": lambda: vehicle.land(now_s),
        "go_near": lambda: vehicle.go_to((1.5, 1.0, 1.2), 0.0),
        "go_far": lambda: vehicle.go_to((5.0, 3.0, 2.5), 3.0),
        "failsafe": lambda: copter.enter(copter.flavour.land),
        "back": lambda: copter.enter(copter.flavour.ours),
        "deaf": lambda: setattr(copter, "deaf", True),
        "hears": lambda: setattr(copter, "deaf", False),
        "silent": lambda: setattr(copter, "silent", True),
        "speaks": lambda: setattr(copter, "silent", False),
        "hang": lambda: setattr(flight, "now_s", now_s + 1.5),
        "reboot": lambda: setattr(copter, "booted_s", now_s),
    }
    actions.get(event, lambda: None)()
