"""What the workers do with cameras, heads and drones. Images never cross threads: detections do."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.clock import Clock
from camrig.detect import detect_tags
from camrig.errors import HardwareError, LinkLost, NotEnabledError
from camrig.interfaces import Camera, CountsItsLink, Drone, Head, LearnsItsAngles, TagDetector
from camrig.messages import (
    AxisReading,
    DroneAim,
    DroneReading,
    Event,
    Expected,
    FlightState,
    Frame,
    HeadAim,
    Level,
    Region,
    TagDetections,
)
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.standing_aim import StandingAim

CAMERA_TIMEOUT_S = 0.5
HEAD_TIMEOUT_S = 0.3
DRONE_TIMEOUT_S = 0.02
READINGS_KEPT = 64
WHOLE_EVERY_S = 0.5
"""How often the whole picture is searched even when every target is where it is expected."""


@dataclass
class CameraJob:
    """Dequeues frames and detects the tags in each: where they are expected, and now and then in the whole picture."""

    name: str
    camera: Camera
    make_detector: Callable[[], TagDetector]
    clock: Clock
    detections: Mailbox[TagDetections] = field(default_factory=lambda: Mailbox(4))
    expected: Mailbox[Expected] = field(default_factory=lambda: Mailbox(1))
    notes: Mailbox[Event] = field(default_factory=lambda: Mailbox(4))
    frames: int = 0
    whole_frames: int = 0
    detect_s: float = 0.0
    _detector: TagDetector | None = None
    _whole_s: float = float("-inf")
    _note: str = ""

    def open(self) -> None:
        if self._detector is None:  # one detector per thread, kept for the life of the process
            self._detector = self.make_detector()
        self.camera.open()

    def turn(self) -> None:
        frame = self.camera.read(CAMERA_TIMEOUT_S)
        if frame is None or self._detector is None:
            return
        self._tell(frame)
        found = detect_tags(frame, self._detector, self.clock.now_s, self._regions(frame.stamp_s))
        self._whole_s = found.stamp_s if found.whole else self._whole_s
        self.frames += 1
        self.whole_frames += found.whole
        self.detect_s += found.detect_s
        self.detections.put(found)

    def _tell(self, frame: Frame) -> None:
        if frame.note != self._note:
            level = Level.WARNING if frame.note else Level.INFO
            self.notes.put(Event(frame.stamp_s, level, self.name, frame.note or "no longer so: " + self._note))
            self._note = frame.note

    def _regions(self, stamp_s: float) -> tuple[Region, ...] | None:
        expected = self.expected.newest()
        due = stamp_s >= self._whole_s + WHOLE_EVERY_S
        return None if due or expected is None or not expected.holds_at(stamp_s) else expected.regions

    def close(self) -> None:
        self.camera.close()

    def wake(self) -> None:
        self.camera.wake()

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its link; any thread."""
        return {"frames": self.frames, **_counted(self.camera)}


@dataclass
class HeadJob:
    """Polls a head's position, and sends it where plans, or else an operator, want it while it is enabled."""

    name: str
    head: Head
    guardian: GuardianLink
    auto_enable: bool
    readings: Mailbox[AxisReading] = field(default_factory=lambda: Mailbox(READINGS_KEPT))
    seen: Mailbox[AxisReading] = field(default_factory=lambda: Mailbox(READINGS_KEPT))
    """Its angles as its camera saw them by anchors."""
    commands: Mailbox[HeadAim] = field(default_factory=lambda: Mailbox(1))
    polls: int = 0
    answers: int = 0
    _wanted: threading.Event = field(default_factory=threading.Event)
    _enabled: bool = False
    _order: StandingAim | None = None

    def __post_init__(self) -> None:
        if self.auto_enable:
            self._wanted.set()

    @property
    def enabled(self) -> bool:
        """Whether the head may move now."""
        return self._enabled and self._wanted.is_set()

    @property
    def aimed(self) -> HeadAim | None:
        """Where an operator has aimed it, for as long as plans are to leave it there."""
        return order.aim if (order := self._order) is not None else None

    @property
    def follows_plans(self) -> bool:
        """Whether plans may move the head now."""
        return self.enabled and self._order is None

    @property
    def held(self) -> bool:
        """Whether the head waits for ``resume``: it was stopped, or never enabled."""
        return not self._wanted.is_set()

    def open(self) -> None:
        self.commands.clear()  # nothing commanded before a link was lost is replayed
        self.seen.clear()
        if (order := self._order) is not None:
            order.give_up()
        self.head.open()
        if (guard := self.head.guard()).stop_bytes:
            self.guardian.hold(self.name, guard)

    def turn(self) -> None:
        if self._wanted.is_set() and not self._enabled:
            self.commands.clear()
            self.head.enable()
            self._enabled = True
            if not self._wanted.is_set():  # stopped between the question and the answer: the stop has the last word
                self._enabled = False
                self.head.stop()
        self._learn()
        planned, order = self.commands.take_all(), self._order
        if order is None:
            for aim in planned:
                self._move_to(aim)
        elif order.untold:
            self._tell(order)
        readings = self.head.read(HEAD_TIMEOUT_S)
        self.polls += 1
        self.answers += bool(readings)
        for reading in readings:
            self.readings.put(reading)
        if order is not None and order.due(readings):
            self._tell(order)

    def _learn(self) -> None:
        seen = self.seen.take_all()
        if isinstance(self.head, LearnsItsAngles):
            for reading in seen:
                self.head.correct(reading)

    def _move_to(self, aim: HeadAim) -> bool:
        """Send the head there; tell whether it was sent."""
        try:
            self.head.move_to(aim.pan_rad, aim.tilt_rad)
        except NotEnabledError:  # stopped by another thread between the queue and the wire
            self._enabled = False  # and to be enabled anew, should it have been resumed since
            return False
        return True

    def _tell(self, order: StandingAim) -> None:
        if self._move_to(order.aim):
            order.told()

    @property
    def landing(self) -> bool:
        """Whether it is to be left alone at shutdown: never, a head does not land."""
        return False

    def close(self) -> None:
        self._enabled = False
        self.head.close()
        self.guardian.release(self.name)

    def wake(self) -> None:
        """Do nothing: a turn is one exchange and ends by itself."""

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its link; any thread."""
        return {"polls": self.polls, "answers": self.answers, **_counted(self.head)}

    def resume(self) -> None:
        """Operator's or start-up's order: the head may move, and follows plans; any thread."""
        if self._order is not None:
            self.commands.clear()
            self._order = None
        self._wanted.set()

    def aim(self, aim: HeadAim) -> None:
        """Operator's order: go there, held or not, and let no plan move it before ``resume``; any thread."""
        self._order = StandingAim(aim)
        self._wanted.set()

    def stop(self) -> None:
        """End motion now and stay still until ``resume``; any thread."""
        self._wanted.clear()
        self._enabled = False
        self._order = None
        self.commands.clear()
        self.head.stop()


def _counted(device: object) -> Mapping[str, float]:
    return device.statistics() if isinstance(device, CountsItsLink) else {}


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
        return _counted(self.drone)

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
