"""What can go wrong with a drone in the air that we command, and what is done about it, before its autopilot does.

A fault is acted on in the tick that finds it. HOLD keeps it where it is and takes it from the plans until an operator's
``resume``; LAND brings it down where it is. Where it cannot be told any more where the drone is, holding is worth no
more than the estimator's drift: after a second it is landed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from camrig.rig import DroneSpec
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.telemetry import Telemetry

STALE_S = 0.5
"""Without a position, or a pose from outside, for so long: hold."""
LOST_S = 1.5
"""For so long: land."""
SICK_S = 0.5
"""An estimator that says for so long, from message to message, that it does not know: land."""
LOW_S = 2.0
"""A battery that is low for so long, not for a burst of thrust: land."""
MAX_RATIO = 1.0
"""Innovation test ratio from which an estimator disbelieves its sensors."""
FRESH_ESTIMATOR_S = 3.0
OUTSIDE_M = 1.0
"""So far outside of its box something else flies the drone than its set-points."""
DISAGREES_S = 1.0
"""An estimator takes a moment to follow poses that have jumped."""
HASTE_M_S = 0.5
HASTE_S = 0.3
DEAF_S = 0.3
"""A gap between two looks in which this computer stood still: what was not heard in it may have been said. That excuses
a silence once, until something newer is heard: a computer that stands still again and again must not be deaf for ever.
"""
UNTOLD_S = 5.0
"""An autopilot that has not said for so long how it is (battery, fence): hold."""


class Action(IntEnum):
    """What is done about a fault; the graver, the greater."""

    HOLD = 1
    LAND = 2


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong."""

    name: str
    action: Action
    text: str


@dataclass(frozen=True, slots=True)
class Needs:
    """What a flight depends on besides the rig: the least battery charge to go on with, 0 to 1, and poses from us."""

    battery: float = 0.2
    vision: bool = False


class Watch:
    """Looks at one drone that we command."""

    def __init__(self, spec: DroneSpec, needs: Needs) -> None:
        self._spec = spec
        self._needs = needs
        self._since_s: dict[str, float] = {}
        self._looked_s = float("-inf")
        self._excused_s: dict[str, float] = {}
        self._lowest_m: float | None = None
        self.seen_from_outside_s = float("-inf")
        """When the last pose that was sent from outside was seen."""
        self._outside_m: Vector | None = None

    def see_from_outside(self, position_m: Vector, stamp_s: float) -> None:
        """Take the place at which its anchors put it, which is sent to its estimator."""
        self._outside_m, self.seen_from_outside_s = position_m, stamp_s

    def disagreement_m(self, seen: Telemetry, now_s: float) -> float:
        """Return how far its own estimate is from where its anchors put it; 0 where one of them is not fresh."""
        fresh = seen.position_fresh(now_s) and now_s - self.seen_from_outside_s <= STALE_S
        if not fresh or self._outside_m is None or seen.position_m is None:
            return 0.0
        return math.dist(self._outside_m, seen.position_m)

    def begin(self) -> None:
        """Forget for how long anything has lasted: a flight begins."""
        self._since_s.clear()
        self._excused_s.clear()

    def settle(self, height_m: float | None) -> None:
        """Learn at which height it begins to fly or to hold, be it below its box; None: it does not yet."""
        self._lowest_m = height_m

    def gravest(self, seen: Telemetry, now_s: float) -> Fault | None:
        """Return the fault that asks for most."""
        return max(self.faults(seen, now_s), key=lambda fault: fault.action, default=None)

    def faults(self, seen: Telemetry, now_s: float) -> Iterator[Fault]:
        """Yield all that is wrong now; to be asked at every tick, for some of it must last a while."""
        deaf = now_s - self._looked_s > DEAF_S
        self._looked_s = now_s
        age_s = self._silence_s("position", seen.position_s, now_s, deaf=deaf)
        yield from self._stale("position", age_s, "no position from the autopilot")
        if self._needs.vision:
            age_s = self._silence_s("vision", self.seen_from_outside_s, now_s, deaf=deaf)
            yield from self._stale("vision", age_s, "its camera has given it no pose by anchors")
            yield from self._anchored(seen, now_s)
        yield from self._estimate(seen, now_s)
        yield from self._astray(seen)
        if self._lowest_m is not None:
            yield from self._haste(seen, now_s)
        yield from self._exhausted(seen, now_s, deaf=deaf)

    def _exhausted(self, seen: Telemetry, now_s: float, *, deaf: bool) -> Iterator[Fault]:
        age_s = self._silence_s("system", seen.system_s, now_s, deaf=deaf)
        if age_s > UNTOLD_S:
            yield Fault("system", Action.HOLD, f"it has not told its battery and fence for {age_s:.0f} s")
        battery = seen.system.battery if seen.system else None
        low = battery is not None and battery < self._needs.battery
        if self._lasts("battery", LOW_S, now_s, holds=low):
            yield Fault("battery", Action.LAND, f"battery at {100.0 * (battery or 0.0):.0f} %")
        if seen.system is not None and seen.system.fence_breached:
            yield Fault("fence", Action.HOLD, "it says that it has left its own fence")

    def _estimate(self, seen: Telemetry, now_s: float) -> Iterator[Fault]:
        trouble = estimator_trouble(seen, now_s)
        if self._lasts("estimator", SICK_S, seen.estimator_s, holds=bool(trouble)):
            yield Fault("estimator", Action.LAND, trouble)
        if seen.jump_m:
            yield Fault("jump", Action.HOLD, f"its position jumped by {seen.jump_m:.1f} m")

    def _astray(self, seen: Telemetry) -> Iterator[Fault]:
        """Yield a fault outside the box; below it, only where it sinks from where it was."""
        if seen.position_m is None:
            return
        if self._lowest_m is not None:
            self._lowest_m = min(self._spec.box_m[0][2], max(self._lowest_m, seen.position_m[2]))
        outside_m = self._outside_box_m(seen.position_m)
        if outside_m > OUTSIDE_M:
            yield Fault("box", Action.LAND, f"it is {outside_m:.1f} m outside its box")

    def _anchored(self, seen: Telemetry, now_s: float) -> Iterator[Fault]:
        """Yield what its anchors tell: an estimator that does not take their poses may believe itself in its box."""
        outside_m = self._outside_box_m(self._outside_m) if self._outside_m else 0.0
        if self._lasts("outside by anchors", HASTE_S, now_s, holds=outside_m > OUTSIDE_M):
            yield Fault("box", Action.LAND, f"by its anchors it is {outside_m:.1f} m outside its box")
        gap_m = self.disagreement_m(seen, now_s)
        if self._lasts("disagreement", DISAGREES_S, now_s, holds=gap_m > OUTSIDE_M):
            yield Fault("disagreement", Action.LAND, f"its estimate is {gap_m:.1f} m from where its anchors put it")

    def _outside_box_m(self, position_m: Vector) -> float:
        (low_x, low_y, _), high = self._spec.box_m
        low = (low_x, low_y, -math.inf if self._lowest_m is None else self._lowest_m)
        return max(max(a - value, value - b) for a, b, value in zip(low, high, position_m, strict=True))

    def _haste(self, seen: Telemetry, now_s: float) -> Iterator[Fault]:
        speed_m_s = math.hypot(*seen.velocity_m_s)
        fast = speed_m_s > 2.0 * self._spec.speed_m_s + HASTE_M_S
        if self._lasts("haste", HASTE_S, now_s, holds=fast):
            yield Fault(
                "haste", Action.HOLD, f"it flies at {speed_m_s:.1f} m/s, {self._spec.speed_m_s:g} m/s is allowed"
            )

    def _silence_s(self, name: str, heard_s: float, now_s: float, *, deaf: bool) -> float:
        """Return for how long nothing was heard while we listened."""
        excused_s = self._excused_s.get(name, -math.inf)
        if deaf and heard_s > excused_s:
            self._excused_s[name] = excused_s = now_s
        return now_s - max(heard_s, excused_s)

    def _stale(self, name: str, age_s: float, text: str) -> Iterator[Fault]:
        if age_s > STALE_S:
            action = Action.LAND if age_s > LOST_S else Action.HOLD
            yield Fault(name, action, f"{text} for {age_s:.1f} s")

    def _lasts(self, name: str, duration_s: float, now_s: float, *, holds: bool) -> bool:
        if not holds:
            self._since_s.pop(name, None)
            return False
        return now_s - self._since_s.setdefault(name, now_s) >= duration_s


def runaway(gap_m: float, *, holds: bool) -> Fault:
    """Return the fault of a drone that is so far from its set-point; one that was told to hold does not obey."""
    text = f"it is implausibly far from its set-point, {gap_m:.1f} m"
    return Fault("runaway", Action.LAND if holds else Action.HOLD, text)


def estimator_trouble(seen: Telemetry, now_s: float) -> str:
    """Return what is wrong with the autopilot's estimator by its own word; empty where it says nothing of the kind."""
    if seen.estimator is None or now_s - seen.estimator_s > FRESH_ESTIMATOR_S:
        return ""
    if seen.estimator.lacks:
        return f"its estimator has no {', no '.join(seen.estimator.lacks)}"
    if seen.estimator.worst_ratio > MAX_RATIO:
        return f"its estimator disbelieves its sensors (test ratio {seen.estimator.worst_ratio:.1f})"
    return ""
