"""One motor axis in closed form: acceleration-limited moves between limits, and the play of its gear.

The motion is a list of pieces of constant acceleration, so where the axis is, or was, follows exactly for any stamp
without a time step; a command cuts the list at its own stamp and plans anew from there. A jog is a move to the
limit ahead at the jog's speed: whatever is planned can always still stop inside the limits. Angles are of any one
unit, speeds and accelerations of the same per second.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

Phase = tuple[float, float]
"""(acceleration, duration in seconds)."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Constant acceleration from ``start_s`` on, in one direction of travel; ``load`` is behind the gear's play."""

    start_s: float
    position: float
    speed: float
    acceleration: float
    load: float

    def position_at(self, stamp_s: float) -> float:
        """Return the motor's angle."""
        if self.at_rest:
            return self.position
        dt_s = stamp_s - self.start_s
        return self.position + (self.speed + 0.5 * self.acceleration * dt_s) * dt_s

    def speed_at(self, stamp_s: float) -> float:
        """Return the motor's signed speed."""
        return self.speed if self.acceleration == 0.0 else self.speed + self.acceleration * (stamp_s - self.start_s)

    @property
    def at_rest(self) -> bool:
        """Whether the motor stands still all through this piece."""
        return self.speed == 0.0 and self.acceleration == 0.0


def follow(load: float, motor: float, play: float) -> float:
    """Return where a load comes to rest that a motor drags along with ``play`` in total between its two flanks."""
    return min(max(load, motor - play / 2.0), motor + play / 2.0)


def phases(distance: float, speed: float, cruise: float, acceleration: float) -> list[Phase]:
    """Return the time-optimal phases that come to rest after a signed ``distance``, which may be infinite.

    ``speed`` is signed, ``cruise`` and ``acceleration`` are positive. No phase changes its direction of travel.
    """
    direction = 1.0 if distance >= _stopping_distance(speed, acceleration) else -1.0
    ahead, forward = direction * distance, direction * speed
    planned: list[Phase] = []
    if forward < 0.0:
        planned.append((direction * acceleration, -forward / acceleration))
        ahead, forward = ahead + forward**2 / (2.0 * acceleration), 0.0
    peak = cruise if forward > cruise else min(cruise, max(forward, _peak(ahead, forward, acceleration)))
    coast = ahead - (abs(peak**2 - forward**2) + peak**2) / (2.0 * acceleration)
    planned.append((math.copysign(acceleration, peak - forward) * direction, abs(peak - forward) / acceleration))
    planned.append((0.0, max(0.0, coast) / peak if peak > 0.0 else 0.0))
    planned.append((-direction * acceleration, peak / acceleration))
    return [phase for phase in planned if phase[1] > 0.0]


def _stopping_distance(speed: float, acceleration: float) -> float:
    return speed * abs(speed) / (2.0 * acceleration)


def _peak(ahead: float, forward: float, acceleration: float) -> float:
    """Return the speed of a triangle that starts at ``forward`` and ends at rest after ``ahead``."""
    return math.sqrt(max(0.0, acceleration * ahead + forward**2 / 2.0))


class AxisMotion:
    """One axis over time. Stamps of commands never go back; what is asked about them may be any of the last minute."""

    def __init__(
        self,
        start: float,
        *,
        limits: tuple[float, float] | None,
        speed: float,
        acceleration: float,
        start_latency_s: float = 0.0,
        play: float = 0.0,
        history_s: float = 60.0,
    ) -> None:
        """Stand at ``start``; limits of None turn on for ever. ``speed`` is of moves to a position."""
        self.limits = limits
        self._speed = speed
        self._acceleration = acceleration
        self.start_latency_s = start_latency_s
        self._play = play
        self._history_s = history_s
        self._pieces = [Piece(-math.inf, start, 0.0, 0.0, start)]
        self._begins_s = -math.inf
        self.goal: float | None = None
        """Where the last command sent it to a position; None after any other."""

    def go_to(self, target: float, at_s: float, *, past: float = 0.0) -> None:
        """Move to ``target``, which the caller keeps within the limits, and rest there; first go ``past`` it."""
        begin_s = self._begin(at_s)
        self.goal = target
        if past > 0.0 and target != self.motor(begin_s):
            low, high = self.limits or (-math.inf, math.inf)
            beyond = target + math.copysign(past, target - self.motor(begin_s))
            self._plan(min(max(beyond, low), high), self._speed, begin_s)
            begin_s = self._pieces[-1].start_s
        self._plan(target, self._speed, begin_s)

    def home(self, target: float, from_s: float) -> None:
        """Stand until ``from_s``, then move to ``target``; the caller sends no command before that."""
        self._plan(target, self._speed, from_s)

    def jog(self, speed: float, at_s: float, until_s: float = math.inf) -> None:
        """Turn at a signed speed until ``until_s``, a limit, or the next command."""
        if speed == 0.0:
            self.stop(at_s)
            return
        low, high = self.limits or (-math.inf, math.inf)
        self.goal = None
        self._plan(high if speed > 0.0 else low, abs(speed), self._begin(at_s))
        if until_s < math.inf:
            self._brake(until_s)

    def stop(self, at_s: float) -> None:
        """Brake to rest; a start that was still pending never happens."""
        self._forget(at_s)
        self._brake(at_s)
        self._begins_s = at_s
        self.goal = None

    def at_stop(self, stamp_s: float) -> bool:
        """Say whether the motor stands at one of its hard stops."""
        return self.limits is not None and self.at_rest(stamp_s) and self.motor(stamp_s) in self.limits

    def rested_at(self, stamp_s: float) -> float:
        """Return where the motor last stood, at the stamp or before."""
        place = bisect_right(self._pieces, stamp_s, key=lambda piece: piece.start_s) - 1
        while place > 0 and not self._pieces[place].at_rest:
            place -= 1
        return self._pieces[max(place, 0)].position

    def motor(self, stamp_s: float) -> float:
        """Return the motor's angle: what an encoder reads."""
        return self._piece(stamp_s).position_at(stamp_s)

    def speed(self, stamp_s: float) -> float:
        """Return the motor's signed speed."""
        return self._piece(stamp_s).speed_at(stamp_s)

    def load(self, stamp_s: float) -> float:
        """Return the angle behind the gear's play: what the optics see."""
        piece = self._piece(stamp_s)
        return follow(piece.load, piece.position_at(stamp_s), self._play)

    def at_rest(self, stamp_s: float) -> bool:
        """Say whether the motor stands still at the stamp, a pending start included."""
        return self._piece(stamp_s).at_rest

    def _begin(self, at_s: float) -> float:
        """Return when a motion commanded at ``at_s`` begins; one already pending is not put off."""
        self._forget(at_s)
        if self._begins_s <= at_s:
            self._begins_s = at_s + self.start_latency_s if self.at_rest(at_s) else at_s
        return self._begins_s

    def _brake(self, at_s: float) -> None:
        piece = self._piece(at_s)
        reach = _stopping_distance(piece.speed_at(at_s), self._acceleration)
        self._plan(piece.position_at(at_s) + reach, self._speed, at_s)

    def _plan(self, target: float, cruise: float, at_s: float) -> None:
        """Replace everything from ``at_s`` on by a move to ``target``."""
        position, speed, load = self.motor(at_s), self.speed(at_s), self.load(at_s)
        while self._pieces[-1].start_s >= at_s:
            self._pieces.pop()
        for acceleration, duration_s in phases(target - position, speed, cruise, self._acceleration):
            piece = Piece(at_s, position, speed, acceleration, load)
            self._pieces.append(piece)
            at_s += duration_s
            if at_s == math.inf:
                return
            position, speed = piece.position_at(at_s), piece.speed_at(at_s)
            load = follow(load, position, self._play)
        self._pieces.append(Piece(at_s, target, 0.0, 0.0, follow(load, target, self._play)))

    def _forget(self, now_s: float) -> None:
        keep_from = bisect_right(self._pieces, now_s - self._history_s, key=lambda piece: piece.start_s) - 1
        del self._pieces[: max(0, keep_from)]

    def _piece(self, stamp_s: float) -> Piece:
        index = bisect_right(self._pieces, stamp_s, key=lambda piece: piece.start_s) - 1
        if index < 0:
            raise ValueError(f"stamp {stamp_s:.3f} s is older than the {self._history_s:g} s of motion that are kept")
        return self._pieces[index]
