"""What a head's worker does: it alone talks to the head, but for a stop, which any thread may order."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig.errors import NotEnabledError
from camrig.interfaces import Head, LearnsItsAngles
from camrig.messages import AxisReading, HeadAim
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.link_counts import counted
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.standing_aim import StandingAim

HEAD_TIMEOUT_S = 0.3
READINGS_KEPT = 64


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
    _loans: int = 0
    _taken_back: int = 0
    """How many of its loans ended with a stop written by this job."""

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
        loans = self._loans  # read first: one that is made meanwhile ends with the next opening
        self.head.open()
        if loans != self._taken_back:
            self.head.stop()  # who had it may have died and left it turning
            self._taken_back = loans
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
        return {"polls": self.polls, "answers": self.answers, **counted(self.head)}

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

    def lend(self) -> None:
        """Note that another program has it: it is stopped when it is opened after that; any thread."""
        self._loans += 1

    def stop(self) -> None:
        """End motion now and stay still until ``resume``; any thread."""
        self._wanted.clear()
        self._enabled = False
        self._order = None
        self.commands.clear()
        self.head.stop()
