"""What a drone's worker does: it alone talks to the drone, but for a stop, which any thread may order."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.clock import Clock
from camrig.errors import HardwareError, LinkLost, NotEnabledError
from camrig.interfaces import Drone, FliesByPoses, TellsItsHealth
from camrig.locate import body_pose, navigates_by
from camrig.messages import (
    BodyPose,
    DroneAim,
    DroneHealth,
    DroneReading,
    Event,
    FlightState,
    Level,
    TagDetections,
)
from camrig.rig import Rig
from camrig.runtime.link_counts import counted
from camrig.runtime.mailbox import Mailbox

DRONE_TIMEOUT_S = 0.02
READINGS_KEPT = 64


@dataclass
class DroneJob:
    """Serves a drone's link and passes on the newest hover point; arming, resuming, landing are operator's orders."""

    name: str
    drone: Drone
    clock: Clock
    refusals: Mailbox[Event] = field(default_factory=lambda: Mailbox(16))
    readings: Mailbox[DroneReading] = field(default_factory=lambda: Mailbox(READINGS_KEPT))
    commands: Mailbox[DroneAim] = field(default_factory=lambda: Mailbox(1))
    orders: Mailbox[Callable[[], None]] = field(default_factory=lambda: Mailbox(4))
    flight: FlightState | None = None
    """What it was last heard to do, over every loss of its link; None before it was first heard."""
    health: DroneHealth | None = None
    """How it was in the last turn, where its driver tells."""
    _wanted: threading.Event = field(default_factory=threading.Event)
    _sent_to_land: bool = False

    @property
    def enabled(self) -> bool:
        """Whether the drone was armed by an operator and neither stopped nor sent to land since."""
        return self._wanted.is_set()

    @property
    def follows_plans(self) -> bool:
        """Whether plans may move it now."""
        return self.enabled and (self.health is None or self.health.obeys)

    @property
    def begins(self) -> bool:
        """Whether it was sent up, or is being taken over, and does not follow plans yet."""
        return self.health is not None and self.health.begins

    @property
    def landing(self) -> bool:
        """Whether an operator sent it to land, and nothing else since, or its driver lands it for a fault."""
        return self._sent_to_land or (self.health is not None and self.health.lands)

    def open(self) -> None:
        self.commands.clear()
        if self.orders.take_all():
            self._wanted.clear()
            self._sent_to_land = False
            self._warn("what was ordered while its link was down is not carried out: order it again")
        self.drone.open()

    def turn(self) -> None:
        for order in self.orders.take_all():
            self._obey(order)
        for aim in self.commands.take_all():
            self._go_to(aim)
        for reading in self.drone.read(DRONE_TIMEOUT_S):
            self.readings.put(reading)
            if reading.flight is not FlightState.UNKNOWN:
                self.flight = reading.flight
        self._look()

    def _look(self) -> None:
        """Take a drone that has ceased to obey out of the plans at once, and say why."""
        before, self.health = self.health, self.drone.health() if isinstance(self.drone, TellsItsHealth) else None
        if self.health is None:
            return
        ended = before is not None and (before.obeys or before.begins) and not (self.health.obeys or self.health.begins)
        if self._wanted.is_set() and ended:
            self._leave(self.health.reason or "it does not obey any more")
        elif self.health.reason and before is not None and self.health.reason != before.reason:
            self._warn(self.health.reason)

    def _leave(self, reason: str) -> None:
        self._wanted.clear()
        self.commands.clear()
        self._warn(f"left out of plans until `camrig resume {self.name}`: {reason}")

    def _warn(self, text: str) -> None:
        self.refusals.put(Event(self.clock.now_s(), Level.WARNING, self.name, text))

    def _go_to(self, aim: DroneAim) -> None:
        try:
            self.drone.go_to(aim.position_m, aim.yaw_rad)
        except NotEnabledError as error:  # a failsafe, a pilot, a refused arming; or stopped a moment ago
            if self._wanted.is_set() and self.health is None:  # whose driver tells is judged by that
                self._leave(str(error))

    def _obey(self, order: Callable[[], None]) -> None:
        try:
            order()
        except LinkLost:
            raise
        except HardwareError as error:
            if not (self.health and self.health.obeys):  # armed while it flies, it flies on
                self._wanted.clear()
            self._warn(str(error))

    def _start(self, order: Callable[[], None]) -> None:
        order()
        self._sent_to_land = False
        if not self._wanted.is_set():  # stopped since it was ordered: the stop has the last word
            self.drone.stop()

    def close(self) -> None:
        self._wanted.clear()  # after a lost link it takes a new order to obey
        self.health = None
        self.drone.close()

    def wake(self) -> None:
        """Do nothing: a turn is bounded by its time-out."""

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its link; any thread."""
        return counted(self.drone)

    def arm(self) -> None:
        """Operator's order on the ground: arm and climb; any thread."""
        self._begin(self.drone.arm)

    def resume(self) -> None:
        """Operator's order in the air: follow plans again, from where it is; any thread."""
        self._begin(self.drone.resume)

    def _begin(self, order: Callable[[], None]) -> None:
        self._wanted.set()
        self.orders.put(lambda: self._start(order))

    def take_pose(self, pose: BodyPose) -> None:
        """Pass on where its camera has seen it; any thread."""
        if isinstance(self.drone, FliesByPoses):
            self.drone.take_pose(pose)

    def land(self) -> None:
        """Operator's order: land here; any thread."""
        self._sent_to_land = True
        self._wanted.clear()
        self.commands.clear()
        self.orders.put(self.drone.land)

    def stop(self) -> None:
        """Hold where it is and take no hover point until ``arm``; any thread."""
        self._sent_to_land = False
        self._wanted.clear()
        self.orders.clear()
        self.commands.clear()
        self.drone.stop()


def pilot(camera: str, rig: Rig, drones: Mapping[str, DroneJob]) -> Callable[[TagDetections], None] | None:
    """Return what is to be done with a camera's detections where its drone navigates by them; None where not."""
    drone = navigates_by(camera, rig)
    if drone is None:
        return None

    def send(detections: TagDetections) -> None:
        if (pose := body_pose(detections, rig)) is not None:
            drones[drone].take_pose(pose)

    return send
