"""What a drone's worker does: it alone talks to the drone, but for a stop, which any thread may order."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.clock import Clock
from camrig.errors import HardwareError, LinkLost, NotEnabledError
from camrig.interfaces import Drone
from camrig.messages import DroneAim, DroneReading, Event, FlightState, Level
from camrig.runtime.link_counts import counted
from camrig.runtime.mailbox import Mailbox

DRONE_TIMEOUT_S = 0.02
READINGS_KEPT = 64


@dataclass
class DroneJob:
    """Serves a drone's link and passes on the newest hover point; arming and landing are operator's orders."""

    name: str
    drone: Drone
    clock: Clock
    refusals: Mailbox[Event] = field(default_factory=lambda: Mailbox(16))
    readings: Mailbox[DroneReading] = field(default_factory=lambda: Mailbox(READINGS_KEPT))
    commands: Mailbox[DroneAim] = field(default_factory=lambda: Mailbox(1))
    orders: Mailbox[Callable[[], None]] = field(default_factory=lambda: Mailbox(4))
    landing: bool = False
    """Whether an operator sent it to land, and nothing else since."""
    flight: FlightState | None = None
    """What it was last heard to do, over every loss of its link; None before it was first heard."""
    _wanted: threading.Event = field(default_factory=threading.Event)

    @property
    def enabled(self) -> bool:
        """Whether the drone was armed by an operator and neither stopped nor sent to land since."""
        return self._wanted.is_set()

    @property
    def follows_plans(self) -> bool:
        """Whether plans may move it now."""
        return self.enabled

    def open(self) -> None:
        self.commands.clear()
        self.orders.clear()
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

    def _go_to(self, aim: DroneAim) -> None:
        try:
            self.drone.go_to(aim.position_m, aim.yaw_rad)
        except NotEnabledError as error:  # a failsafe, a pilot, a refused arming; or stopped a moment ago
            if self._wanted.is_set():
                self._wanted.clear()
                self.refusals.put(Event(self.clock.now_s(), Level.WARNING, self.name, f"left out of plans: {error}"))

    def _obey(self, order: Callable[[], None]) -> None:
        try:
            order()
        except LinkLost:
            raise
        except HardwareError as error:
            self.refusals.put(Event(self.clock.now_s(), Level.WARNING, self.name, str(error)))

    def _arm(self) -> None:
        self.drone.arm()
        if not self._wanted.is_set():  # stopped since it was ordered: the stop has the last word
            self.drone.stop()

    def close(self) -> None:
        self._wanted.clear()  # after a lost link it takes a new order to obey
        self.drone.close()

    def wake(self) -> None:
        """Do nothing: a turn is bounded by its time-out."""

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its link; any thread."""
        return counted(self.drone)

    def arm(self) -> None:
        """Operator's order: arm and climb; any thread."""
        self.landing = False
        self._wanted.set()
        self.orders.put(self._arm)

    def land(self) -> None:
        """Operator's order: land here; any thread."""
        self.landing = True
        self._wanted.clear()
        self.commands.clear()
        self.orders.put(self.drone.land)

    def stop(self) -> None:
        """Hold where it is and take no hover point until ``arm``; any thread."""
        self.landing = False
        self._wanted.clear()
        self.orders.clear()
        self.commands.clear()
        self.drone.stop()
