"""What the grades of pointing share: how they speak, and what they tell when a head does not obey."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from camrig.clock import Clock
from camrig.errors import LinkLost
from camrig.messages import AxisReading
from camrig_drivers.pelco_d.axis import AxisScale, Play
from camrig_drivers.pelco_d.codec import Axis, Command
from camrig_drivers.pelco_d.section import PelcoDSection
from camrig_drivers.pelco_d.timing import Answer, Miss
from camrig_drivers.pelco_d.watch import Watch


class DisobeyedError(LinkLost):
    """The head answers and does not do what it is told; its link is given up, so that a person hears of it."""


class RunawayError(DisobeyedError):
    """The head goes elsewhere than it is driven: it must not be driven again."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One enabled head's line: questions, and motions that raise NotEnabledError once a stop has come."""

    ask: Callable[[Command], Answer | Miss]
    send: Callable[[Command], None]
    missed: Callable[[Miss], None]
    """Told of every question without an answer; raises LinkLost when there were too many."""
    heard: Callable[[], None]


@dataclass(frozen=True, slots=True)
class Parts:
    """One head as all grades see it."""

    name: str
    section: PelcoDSection
    axes: Mapping[Axis, AxisScale]
    watches: Mapping[Axis, Watch]
    plays: Mapping[Axis, Play]
    clock: Clock

    @property
    def frame_s(self) -> float:
        """How long a command is on the wire."""
        return 70.0 / self.section.baud


class Pointing(Protocol):
    """One grade of pointing; used by the head's worker alone."""

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        """Head for these angles, which are within limits."""
        ...

    def turn(self, wire: Wire, timeout_s: float) -> tuple[AxisReading, ...]:
        """Do one round of work and return what is newly known of the head's angles."""
        ...

    def forget(self, at_s: float) -> None:
        """Head nowhere from ``at_s`` on: a stop has come, or the link was opened anew."""
        ...


class Steering(Protocol):
    """How a head that reports its angles is brought to where it shall look."""

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        """Head for these angles of the optics, which are within limits."""
        ...

    def observe(self, axis: Axis, motor_rad: float, stamp_s: float, wire: Wire) -> None:
        """Take what an axis reported and do what follows; raises DisobeyedError."""
        ...

    def begin(self, axis: Axis, motor_rad: float) -> None:
        """Take where an axis was when the head was opened."""
        ...

    def tend(self, wire: Wire, *, blind: bool) -> None:
        """Do what is due after a question: end a motion in time, or at once where the head did not answer."""
        ...

    def forget(self) -> None:
        """Head nowhere."""
        ...
