"""A head and its camera that do what a test says, in simulated time; for what moves a head and looks through it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from camrig.clock import ManualClock
from camrig.interfaces import Guard
from camrig.messages import AxisReading, TagDetection, TagDetections
from camrig.rig import TagKey

POLL_S = 0.05
OVERSHOT_RAD = math.radians(0.1)
CORNERS_PX = np.array([[300.0, 150.0], [360.0, 150.0], [360.0, 210.0], [300.0, 210.0]])


@dataclass
class ScriptedHead:
    """Overshoots what it is sent to and comes back; one that is stuck stays, one that is dumb tells no tilt.

    A step of speed is 0.01 rad/s.
    """

    clock: ManualClock
    stuck: bool = False
    dumb: bool = False
    at_rad: list[float] = field(default_factory=lambda: [0.0, -0.5])
    turned: list[tuple[int, int]] = field(default_factory=lambda: [(0, 0)])
    been_rad: list[tuple[float, float]] = field(default_factory=list)
    _course: list[tuple[float, float]] = field(default_factory=list)

    def open(self) -> None:
        pass

    def enable(self) -> None:
        pass

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def guard(self) -> Guard:
        return Guard(-1, b"")

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        aim, here = np.array([pan_rad, tilt_rad]), np.array(self.at_rad)
        course = [here + share * (aim - here) for share in (0.25, 0.5, 0.75, 1.0)]
        course.append(aim + OVERSHOT_RAD * np.sign(aim - here))
        self._course = [] if self.stuck else [(float(pan), float(tilt)) for pan, tilt in [*course, aim]]

    def steps(self) -> Mapping[str, Sequence[int]]:
        return dict.fromkeys(("pan", "tilt"), range(1, 64))

    def turn(self, pan: int, tilt: int) -> float:
        self.turned.append((pan, tilt))
        return self.clock.now_s()

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        self.clock.advance(POLL_S)
        if self._course:
            self.at_rad = list(self._course.pop(0))
        if not self.stuck:
            self.at_rad = [at + 0.01 * step * POLL_S for at, step in zip(self.at_rad, self.turned[-1], strict=True)]
        self.been_rad.append((self.at_rad[0], self.at_rad[1]))
        now_s = self.clock.now_s()
        told = ("pan",) if self.dumb else ("pan", "tilt")
        return tuple(AxisReading("pt1", axis, self.at_rad[k], now_s, 0.001, 0.0) for k, axis in enumerate(told))  # type: ignore[arg-type]


@dataclass
class ScriptedEye:
    clock: ManualClock

    def take(self) -> tuple[TagDetections, ...]:
        tag = TagDetection(TagKey("tag36h11", 1), CORNERS_PX, (0.0, 0.0), 0, 60.0)
        return (TagDetections("eye", self.clock.now_s(), 0, (640, 360), (tag,), 0.0),)
