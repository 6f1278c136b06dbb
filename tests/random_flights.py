"""Two drones flown at random by the steering and the driver's vehicle logic, with faults, in simulated time.

Each step both copters fly, speak and are spoken to; eight times a second the steering sends the drones on. What is
checked is where the copters truly are, what they were told, and when a fault was acted on.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from camrig.geometry.airspace import flight_box
from camrig.geometry.lens import BrownLens
from camrig.messages import DroneAim, DroneCommand, DroneReading
from camrig.pipeline.state import Inputs, begin
from camrig.pipeline.watch import rig_pose, take_readings
from camrig.rig import CameraSpec, DroneMount, DroneSpec, Rig, Space
from camrig.steer import SteerSettings, SteerState, steer, take_off_obstacle
from camrig_drivers.mavlink.fitness import unfit
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4
from camrig_drivers.mavlink.frames import Vector, world_from_ned
from camrig_drivers.mavlink.packets import Command, PositionTarget
from camrig_drivers.mavlink.phase import Phase
from tests.mavlink_copter import HEALTHY, LOITER, ORIGIN_M, UPKEEP, Copter, Flight

DT_S = 0.04
STEER_EVERY = 3
LENS = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0))
ROOM = ((0.0, 0.0, 1.0), (6.0, 4.0, 2.5))
STARTS: tuple[Vector, Vector] = ((1.5, 2.0, 0.0), (4.5, 2.0, 0.0))
SEPARATION_M = 0.8
SETTINGS = SteerSettings()

BOX_SLACK_M = 0.2
"""How far a copter may swing over the edge of its box."""
NEAR_SLACK_M = 0.1
CLIMB_SLACK_M = 0.25
SPEED_SLACK = 1.6
"""A copter that follows its set-point at 1 / s lags by the way of a second, and makes up for 1.5 s of it at most."""
ACTED_S = 1.0
RESTING = {Phase.HOLDING, Phase.LANDING, Phase.DESCENDING, Phase.PASSIVE, Phase.BRAKING}
BEGINNING = {Phase.ENTERING, Phase.ARMING, Phase.CLIMBING}


@dataclass(frozen=True, slots=True)
class Fault:
    """What happens to a copter or its link, and after how long it counts as detected; ``ends`` undoes it."""

    happens: Callable[[Copter], None]
    ends: Callable[[Copter], None]
    detected_s: float


def _set(**values: object) -> Callable[[Copter], None]:
    def apply(copter: Copter) -> None:
        for name, value in values.items():
            setattr(copter, name, value)

    return apply


def _reboot(copter: Copter) -> None:
    copter.booted_s = copter.now_s
    copter.enter(0)  # ArduPilot's STABILIZE; nothing of PX4's either


def _nothing(copter: Copter) -> None:
    del copter


FAULTS: Mapping[str, Fault] = {
    "no position": Fault(_set(blind=True), _set(blind=False), 0.5),
    "link": Fault(_set(silent=True, deaf=True), _set(silent=False, deaf=False), 0.5),
    "downlink": Fault(_set(silent=True), _set(silent=False), 0.5),
    "battery": Fault(_set(battery=0.1), _nothing, 2.4),
    "estimator": Fault(_set(estimator=HEALTHY & ~24), _set(estimator=HEALTHY), 0.8),
    "jump": Fault(lambda copter: setattr(copter, "bias_m", (0.7, -0.6, 0.4)), _nothing, 0.1),
    "489 m": Fault(lambda copter: setattr(copter, "bias_m", (0.0, 0.0, -489.0)), _nothing, 0.1),
    "fence": Fault(_set(fence_ok=False), _set(fence_ok=True), 0.3),
    "haste": Fault(_set(reported_m_s=(2.9, 0.0, 0.0)), _set(reported_m_s=None), 0.5),
    "pilot": Fault(lambda copter: copter.enter(LOITER), _nothing, 0.1),
    "failsafe": Fault(lambda copter: copter.enter(copter.flavour.land), _nothing, 0.1),
    "mode and back": Fault(lambda copter: copter.enter(LOITER), lambda copter: copter.enter(copter.flavour.ours), 0.1),
    "reboot": Fault(_reboot, _nothing, 0.1),
    "hang": Fault(_nothing, _nothing, 1.6),
}
JUMPS = {"jump", "489 m"}
FOLLOWING = {Phase.FLYING, Phase.HOLDING}
ORDERS = ("arm", "resume", "stop", "land", "arm", "resume")


@dataclass
class Member:
    """One drone of the pair, and what is allowed of it."""

    name: str
    spec: DroneSpec
    flight: Flight
    goal_m: Vector
    permitted: bool = False
    """An operator has armed or resumed it, or told it to land, at least once."""
    ill: list[tuple[str, float, float]] = field(default_factory=list)
    """Faults at work: name, since when, until when."""
    owing: dict[str, float] = field(default_factory=dict)
    """Faults that must have been acted on by then."""
    ceiling_m: float = math.inf
    hangs_until_s: float = 0.0
    checked: int = 0
    set_point_m: tuple[float, Vector] | None = None

    @property
    def copter(self) -> Copter:
        return self.flight.copter


class Flights:
    """A pair, its steering, and the invariants; every ``check`` raises AssertionError with what was violated."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        speed_m_s = self.rng.choice([0.3, 0.5, 0.8])
        specs = {f"d{i}": DroneSpec(f"d{i}", ROOM, SEPARATION_M, speed_m_s) for i in range(2)}
        cameras = {f"c{i}": CameraSpec(f"c{i}", LENS, DroneMount(f"d{i}", np.eye(4))) for i in range(2)}
        self.rig = Rig("r", Space(), cameras, drones=specs)
        self.members = [
            Member(name, spec, Flight(self.rng.choice([ARDUCOPTER, PX4]), None, spec, position_m=start), start)
            for (name, spec), start in zip(specs.items(), STARTS, strict=True)
        ]
        for member in self.members:
            member.copter.gain_hz = 1.0
        self.state = SteerState()
        self.known = begin(self.now_s)
        self.steps = 0
        self.acted = 0

    @property
    def now_s(self) -> float:
        return self.members[0].flight.now_s

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / DT_S)):
            for member in self.members:
                self._end_faults(member)
                member.copter.now_s = member.flight.now_s
                member.flight.advance(DT_S, hangs=member.flight.now_s < member.hangs_until_s)
            if self.steps % STEER_EVERY == 0:
                self._steer()
            self.steps += 1
            self._check()

    def order(self, name: str, member: Member) -> None:
        """An operator's order, through the driver's checks."""
        vehicle, now_s = member.flight.vehicle, self.now_s
        if name in {"arm", "resume"}:
            if next(unfit(vehicle, now_s), None) is not None:
                return
            if member.ill:  # an operator does not send up what he sees to be ill
                return
            if name == "arm" and self._obstacle(member):
                return
        member.permitted = True
        {"arm": vehicle.arm, "resume": vehicle.resume, "stop": vehicle.stop, "land": vehicle.land}[name](now_s)
        member.ceiling_m = math.inf if name in {"arm", "resume"} else self._ceiling(member)

    def _obstacle(self, member: Member) -> str:
        aloft_m: dict[str, Vector] = {}
        for other in self.members:
            vehicle = other.flight.vehicle
            needs_room = vehicle.phase in BEGINNING or not vehicle.seen.on_ground
            if other is not member and vehicle.seen.position_m and needs_room:
                aloft_m[other.name] = vehicle.seen.position_m
        return take_off_obstacle(member.name, member.copter.position_m, aloft_m, self.rig)

    def fault(self, name: str, member: Member, duration_s: float) -> None:
        """Let something go wrong; where the drone flies under our command, that must be acted on."""
        fault, now_s = FAULTS[name], self.now_s
        if member.ill or now_s < member.hangs_until_s or (name == "reboot" and not member.copter.armed):
            return
        if name in JUMPS and member.flight.vehicle.phase not in FOLLOWING:
            return  # without set-points of ours an autopilot takes its own resets along
        flying = member.flight.vehicle.phase is Phase.FLYING
        member.copter.now_s = now_s
        fault.happens(member.copter)
        if name == "hang":
            member.hangs_until_s = now_s + 1.5
        # An estimate that has jumped stays wrong; nothing but the operator's eyes can tell.
        member.ill.append((name, now_s, math.inf if name in JUMPS else now_s + duration_s))
        mild = name == "hang" and member.copter.flavour is ARDUCOPTER  # its target stays: nothing is wrong
        if flying and not mild and duration_s > fault.detected_s + ACTED_S:
            member.owing[name] = now_s + fault.detected_s + ACTED_S
            member.ceiling_m = self._ceiling(member)

    def _ceiling(self, member: Member) -> float:
        """Return how high it may come: to the set-point that stands, and where that runs until the fault is found."""
        asked_m = member.set_point_m[1][2] if member.set_point_m else 0.0
        return max(member.copter.position_m[2], asked_m) + 0.5 * member.spec.speed_m_s + CLIMB_SLACK_M

    def _end_faults(self, member: Member) -> None:
        for name, since_s, until_s in [*member.ill]:
            if self.now_s >= until_s:
                member.ill.remove((name, since_s, until_s))
                member.copter.now_s = self.now_s
                FAULTS[name].ends(member.copter)

    def _steer(self) -> None:
        now_s, goals = self.now_s, {}
        readings: list[DroneReading] = []
        for i, member in enumerate(self.members):
            vehicle = member.flight.vehicle
            readings += vehicle.report.readings
            vehicle.report.readings.clear()
            if vehicle.phase is Phase.FLYING:
                goals[f"c{i}"] = DroneAim(member.goal_m)
        sent_up = frozenset(member.name for member in self.members if member.flight.vehicle.phase in BEGINNING)
        self.known, _ = take_readings(self.known, Inputs(drone_readings=tuple(readings)), self.rig)
        pose = rig_pose(self.known, now_s, sent_up)
        self.state, commands = steer(self.state, goals, pose, frozenset(goals), self.rig, SETTINGS, now_s)
        for command in commands:
            assert isinstance(command, DroneCommand)
            member = self.members[int(command.drone_id[1:])]
            if now_s >= member.hangs_until_s:
                member.flight.vehicle.go_to(command.aim.position_m, command.aim.yaw_rad)

    # --- invariants -------------------------------------------------------------------------------------

    def _check(self) -> None:
        for member in self.members:
            self._check_said(member)
            self._check_place(member)
            self._check_acted(member)
        a, b = (member.copter for member in self.members)
        # Drones keep apart by what they say of themselves: one whose estimate has jumped is not where it says.
        lost = any(name in JUMPS for member in self.members for name, _, _ in member.ill)
        if a.landed_state != 1 and b.landed_state != 1 and not lost:
            gap_m = math.dist(a.position_m[:2], b.position_m[:2])
            assert gap_m >= SEPARATION_M - NEAR_SLACK_M, f"{gap_m:.2f} m apart"

    def _check_said(self, member: Member) -> None:
        said = member.flight.said[member.checked :]
        member.checked = len(member.flight.said)
        for stamp_s, packet in said:
            if isinstance(packet, Command) and packet.command not in UPKEEP:
                assert member.permitted, f"command {packet.command} to {member.name}, which nobody armed"
            if isinstance(packet, PositionTarget):
                assert member.permitted, f"a set-point to {member.name}, which nobody armed"
                self._check_set_point(member, stamp_s, world_from_ned(packet.position_ned_m, ORIGIN_M))

    def _check_set_point(self, member: Member, stamp_s: float, point_m: Vector) -> None:
        """Set-points run at the speed, or are put where the drone is."""
        before, estimate_m = member.set_point_m, member.copter.estimate_m
        member.set_point_m = (stamp_s, point_m)
        if before is None or math.dist(point_m, estimate_m) < 0.3:
            return
        run_m = math.dist(before[1], point_m)
        assert run_m <= member.spec.speed_m_s * (stamp_s - before[0]) + 0.02, f"a set-point leaps {run_m:.2f} m"
        if member.flight.vehicle.phase is Phase.FLYING:
            low, high = flight_box(member.spec.box_m)
            assert (low - 1e-6 <= point_m).all() or point_m[2] < low[2]
            assert (np.asarray(point_m) <= high + 1e-6).all(), f"a set-point outside the box: {point_m}"

    def _check_place(self, member: Member) -> None:
        x, y, z = member.copter.position_m
        (low_x, low_y, _), (high_x, high_y, high_z) = ROOM
        slack = BOX_SLACK_M
        inside = low_x - slack <= x <= high_x + slack and low_y - slack <= y <= high_y + slack
        assert inside, f"{member.name} is at ({x:.2f}, {y:.2f}) m"
        assert z <= high_z + slack, f"{member.name} is at {z:.2f} m"
        assert z <= member.ceiling_m, f"{member.name} climbs to {z:.2f} m, unasked"
        speed_m_s = math.hypot(*member.copter.velocity_m_s)
        # Where an estimate jumps, the autopilot itself begins to fly the jump, until it is told to hold.
        jumps = any(name in JUMPS for name, _, _ in member.ill)
        if member.flight.vehicle.phase is Phase.FLYING and not jumps:
            limit_m_s = SPEED_SLACK * max(member.spec.speed_m_s, 0.5 / 1.5)
            assert speed_m_s <= limit_m_s, f"{member.name} flies at {speed_m_s:.2f} m/s"

    def _check_acted(self, member: Member) -> None:
        for name, until_s in [*member.owing.items()]:
            phase = member.flight.vehicle.phase
            if phase in RESTING:
                del member.owing[name]
                self.acted += 1
            else:
                assert self.now_s <= until_s, f"{member.name}: '{name}' is not acted on, it is {phase.name}"
