"""The stream of set-points: along a straight path at a set speed, so that the vehicle never flies at its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from camrig.rig import Box
from camrig_drivers.mavlink.box import clamped
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.frames import Vector, yaw_ned_from_enu
from camrig_drivers.mavlink.packets import PositionTarget
from camrig_drivers.mavlink.telemetry import Telemetry

_LEASH_S = 1.5
_MIN_LEASH_M = 0.5
_RUNAWAY_M = 1.5
_MAX_STEP_S = 0.3


@dataclass(frozen=True, slots=True)
class Ramp:
    """A set-point in world metres on its way to ``goal_m``; ``yaw_rad`` (ENU) is given to the autopilot at once."""

    point_m: Vector
    goal_m: Vector
    yaw_rad: float
    speed_m_s: float

    @property
    def leash_m(self) -> float:
        """How far the set-point runs ahead before it waits: a drone held up must not chase it afterwards."""
        return max(_MIN_LEASH_M, _LEASH_S * self.speed_m_s)

    def advanced(self, dt_s: float, position_m: Vector) -> Ramp:
        """Move the set-point on by ``dt_s`` unless the vehicle at ``position_m`` trails too far behind."""
        left_m = math.dist(self.point_m, self.goal_m)
        if left_m == 0.0 or math.dist(self.point_m, position_m) > self.leash_m:
            return self
        step_m = self.speed_m_s * dt_s
        if step_m >= left_m:
            return replace(self, point_m=self.goal_m)
        x, y, z = (a + step_m / left_m * (b - a) for a, b in zip(self.point_m, self.goal_m, strict=True))
        return replace(self, point_m=(x, y, z))


class SetPoints:
    """When to send which set-point; silent until ``hold_here`` has given it a point."""

    def __init__(self, flavour: Flavour, speed_m_s: float, seen: Telemetry) -> None:
        self._period_s = flavour.set_point_period_s
        self._loss_s = flavour.set_point_loss_s
        self._speed_m_s = speed_m_s
        self._seen = seen
        self._ramp: Ramp | None = None
        self._sent_s: float | None = None
        self.next_s = 0.0

    def hold_here(self, now_s: float) -> None:
        """Aim at the present position and heading, at once; where one is stale, at that of the set-point before."""
        seen, ramp = self._seen, self._ramp
        point_m = self._position_m(now_s) or self.point_m() or seen.position_m
        yaw_rad = seen.yaw_rad if ramp is None or seen.yaw_fresh(now_s) else ramp.yaw_rad
        if point_m is not None and yaw_rad is not None:
            self._ramp = Ramp(point_m, point_m, yaw_rad, self._speed_m_s)
            self.next_s = now_s

    def move(self, goal_m: Vector, yaw_rad: float | None = None) -> None:
        """Go on to another goal from where the set-point is now; without ``yaw_rad`` the heading stays."""
        if self._ramp is not None:
            self._ramp = replace(self._ramp, goal_m=goal_m, yaw_rad=self._ramp.yaw_rad if yaw_rad is None else yaw_rad)

    def move_into(self, box_m: Box) -> None:
        """Go to the point of a box that is nearest to the set-point."""
        if self._ramp is not None:
            self.move(clamped(self._ramp.point_m, box_m))

    def point_m(self) -> Vector | None:
        """Return the set-point, in the world."""
        return self._ramp.point_m if self._ramp else None

    def runaway_m(self) -> float:
        """Return how far the vehicle, or its estimate, is from its set-point where that is implausible; 0 elsewhere."""
        ramp, position_m = self._ramp, self._seen.position_m
        if ramp is None or position_m is None:
            return 0.0
        gap_m = math.dist(ramp.point_m, position_m)
        return gap_m if gap_m > ramp.leash_m + _RUNAWAY_M else 0.0

    def due_if(self, streaming: bool, now_s: float, *, follows: bool = False) -> list[PositionTarget] | None:
        """Return the set-point if the stream runs and it is due.

        None, and no stream any more, where it was interrupted for so long that the autopilot's mode has ended.
        ``follows``: the set-point is where the vehicle is, until something else is wanted.
        """
        if not streaming:
            self._sent_s = None
            return []
        if self._sent_s is not None and now_s - self._sent_s > self._loss_s:
            self._sent_s = None
            return None
        if self._ramp is None or now_s < self.next_s:
            return []
        if follows:
            next_s = self.next_s
            self.hold_here(now_s)
            self.next_s = next_s
        return [self._next(self._ramp, now_s)]

    def _next(self, ramp: Ramp, now_s: float) -> PositionTarget:
        """Move the set-point on, only where the vehicle's position is known."""
        position_m = self._position_m(now_s)
        if position_m is not None and self._sent_s is not None:
            ramp = ramp.advanced(min(now_s - self._sent_s, _MAX_STEP_S), position_m)
        self._ramp, self._sent_s = ramp, now_s
        self.next_s = max(self.next_s + self._period_s, now_s + self._period_s / 2.0)
        return PositionTarget(self._seen.frame.local(ramp.point_m), yaw_ned_from_enu(ramp.yaw_rad))

    def _position_m(self, now_s: float) -> Vector | None:
        return self._seen.position_m if self._seen.position_fresh(now_s) else None
