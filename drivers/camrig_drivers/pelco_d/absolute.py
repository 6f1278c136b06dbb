"""Pointing by positions: a head that is told where to go goes there by itself, or is told again."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig_drivers.pelco_d.codec import Axis
from camrig_drivers.pelco_d.commands import set_position
from camrig_drivers.pelco_d.steering import DisobeyedError, Parts, Wire

_log = logging.getLogger(__name__)

_RESEND_S = 2.0
"""A target asked for again after this long is sent again: the frame may have been lost, and nothing says so."""
_BEGUN_S = 1.0
"""An axis that stands still off its target so long after it was sent has not heard, or was interrupted."""
_TRIES = 3
_REST_RAD = math.radians(0.02)


@dataclass(slots=True)
class _Leg:
    """One axis on its way: the motor's angles still ahead, when the first was sent, from where, how often."""

    target_rad: float
    ahead: list[float]
    start_rad: float | None
    sent_s: float = -math.inf
    tries: int = 0
    moved: bool = False
    arrived: bool = False


@dataclass(slots=True)
class AbsolutePointing:
    """``Steering`` by opcodes 4B and 4D. Two axes are two frames, and on some heads the second ends the first's
    motion; an axis that rests off its target is sent again, one axis at a time, when all rest.
    """

    parts: Parts
    _legs: dict[Axis, _Leg] = field(default_factory=dict)
    _motors: dict[Axis, float] = field(default_factory=dict)
    _at_rest: dict[Axis, bool] = field(default_factory=dict)

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        now_s = self.parts.clock.now_s()
        for axis, angle_rad in angles_rad.items():
            scale, leg, present_rad = self.parts.axes[axis], self._legs.get(axis), self._motors.get(axis)
            same = leg is not None and scale.raw(leg.target_rad) == scale.raw(angle_rad)
            if leg is not None and same and now_s - leg.sent_s < _RESEND_S:
                continue
            if leg is None or not same:
                leg = _Leg(angle_rad, list(scale.way(angle_rad, present_rad)), present_rad)
            self._send(axis, leg, wire)
            self._legs[axis] = leg

    def observe(self, axis: Axis, motor_rad: float, stamp_s: float, wire: Wire) -> None:
        before_rad = self._motors.get(axis, math.inf)
        self._motors[axis] = motor_rad
        self._at_rest[axis] = abs(motor_rad - before_rad) <= _REST_RAD
        leg = self._legs.get(axis)
        if leg is None or leg.arrived:
            return
        leg.start_rad = motor_rad if leg.start_rad is None else leg.start_rad
        leg.moved |= abs(motor_rad - leg.start_rad) > 2.0 * _REST_RAD
        if abs(motor_rad - leg.ahead[0]) <= self.parts.axes[axis].arrival_rad:
            if self._at_rest[axis] or len(leg.ahead) == 1:  # one that turned on its way could not be followed
                self._reached(axis, leg, wire)
        elif all(self._is_idle(other, stamp_s) for other in self._legs):
            self._again(axis, leg, wire)

    def begin(self, axis: Axis, motor_rad: float) -> None:
        self._motors[axis] = motor_rad

    def tend(self, wire: Wire, *, blind: bool) -> None:
        """Do nothing: the head finds its target without us."""

    def forget(self) -> None:
        self._legs.clear()
        self._at_rest.clear()
        for watch in self.parts.watches.values():
            watch.stood()

    def _reached(self, axis: Axis, leg: _Leg, wire: Wire) -> None:
        if len(leg.ahead) == 1:
            leg.arrived = True
            self.parts.watches[axis].stood()
            return
        del leg.ahead[0]
        leg.tries = 0
        self._send(axis, leg, wire)

    def _is_idle(self, axis: Axis, stamp_s: float) -> bool:
        leg = self._legs[axis]
        return leg.arrived or (self._at_rest.get(axis, False) and stamp_s - leg.sent_s > _BEGUN_S)

    def _again(self, axis: Axis, leg: _Leg, wire: Wire) -> None:
        if leg.tries < _TRIES:
            leg.tries += 1
            self._send(axis, leg, wire)
            return
        name, section = self.parts.name, self.parts.section
        if not leg.moved:
            raise DisobeyedError(
                f"head {name} at address {section.address} on {section.port} answers, and its {axis.name.lower()} "
                f"does not move when it is sent to a position ({_TRIES + 1} times); check that it takes positions, or "
                "give it grade: velocity and its speeds"
            )
        _log.warning("head %s: its %s stays off its target: a limit of its own?", name, axis.name.lower())
        leg.arrived = True
        self.parts.watches[axis].stood()

    def _send(self, axis: Axis, leg: _Leg, wire: Wire) -> None:
        wire.send(set_position(axis, self.parts.axes[axis].raw_unchecked(leg.ahead[0])))
        leg.sent_s = self.parts.clock.now_s() + self.parts.frame_s
        self.parts.watches[axis].told(leg.ahead[0], leg.sent_s)
        if not self._at_rest.get(axis, False):
            self.parts.plays[axis].loosen()
