"""The stream of set-points: along a straight path at a set speed, so that the vehicle never flies at its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.frames import Vector, ned_from_world, yaw_ned_from_enu
from camrig_drivers.mavlink.packets import PositionTarget

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
    """When to send which set-point; silent until ``hold`` has given it a point."""

    def __init__(self, flavour: Flavour, speed_m_s: float, origin_m: Vector) -> None:
        self._period_s = flavour.set_point_period_s
        self._loss_s = flavour.set_point_loss_s
        self._speed_m_s = speed_m_s
        self._origin_m = origin_m
        self._ramp: Ramp | None = None
        self._sent_s: float | None = None
        self.next_s = 0.0

    def hold(self, point_m: Vector, yaw_rad: float, now_s: float) -> None:
        """Stay at a point, at once."""
        self._ramp = Ramp(point_m, point_m, yaw_rad, self._speed_m_s)
        self.next_s = now_s

    def move(self, goal_m: Vector, yaw_rad: float | None = None) -> None:
        """Go on to another goal from where the set-point is now; without ``yaw_rad`` the heading stays."""
        if self._ramp is not None:
            self._ramp = replace(self._ramp, goal_m=goal_m, yaw_rad=self._ramp.yaw_rad if yaw_rad is None else yaw_rad)

    def point_m(self) -> Vector | None:
        """Return the set-point, in the world."""
        return self._ramp.point_m if self._ramp else None

    def run_away(self, position_m: Vector) -> bool:
        """Whether the vehicle, or its estimate, is implausibly far from its set-point."""
        ramp = self._ramp
        return ramp is not None and math.dist(ramp.point_m, position_m) > ramp.leash_m + _RUNAWAY_M

    def gap_s(self, now_s: float) -> float | None:
        """Return how long the stream has been interrupted, where that is long enough to end the autopilot's mode."""
        if self._sent_s is None or now_s - self._sent_s <= self._loss_s:
            return None
        return now_s - self._sent_s

    def pause(self) -> None:
        """Send nothing; the gap that follows is meant."""
        self._sent_s = None

    def due(self, now_s: float, position_m: Vector | None) -> list[PositionTarget]:
        """Return the set-point if it is due; it moves on only where ``position_m`` is known."""
        if self._ramp is None or now_s < self.next_s:
            return []
        if position_m is not None and self._sent_s is not None:
            self._ramp = self._ramp.advanced(min(now_s - self._sent_s, _MAX_STEP_S), position_m)
        self._sent_s = now_s
        self.next_s = max(self.next_s + self._period_s, now_s + self._period_s / 2.0)
        point_ned_m = ned_from_world(self._ramp.point_m, self._origin_m)
        return [PositionTarget(point_ned_m, yaw_ned_from_enu(self._ramp.yaw_rad))]
