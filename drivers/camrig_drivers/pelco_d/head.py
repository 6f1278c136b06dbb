"""A pan-tilt head that takes absolute positions and reports them, over Pelco-D."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from camrig.clock import Clock
from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.interfaces import Guard
from camrig.messages import AxisReading
from camrig.rig import HeadSpec, Interval
from camrig_drivers.pelco_d.bus import Answer, Bus, Link, Miss
from camrig_drivers.pelco_d.codec import FULL_TURN_RAW, Axis, Extended, encode
from camrig_drivers.pelco_d.commands import STOP, query_position, set_position
from camrig_drivers.pelco_d.section import AxisSection, PelcoDSection

_log = logging.getLogger(__name__)

_TRIES_AT_OPEN = 3
_MISSES_TO_LOSE = 6
"""Unanswered queries in a row after which the head counts as gone: three polls of both axes."""
_RESEND_S = 2.0
"""A target is sent again after this long even if unchanged: the frame may have been lost, and nothing says so."""
_GUARD_STOPS = 3
"""A frame cut off in its middle swallows up to one whole frame after it."""
_LIMIT_SLACK_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class AxisScale:
    """One axis of one head: between its raw hundredths of a degree and our radians, within its limits."""

    name: Literal["pan", "tilt"]
    section: AxisSection
    limits_rad: Interval
    readback_sigma_deg: float

    def raw(self, angle_rad: float) -> int:
        """Return 0..35999 for an angle; raises InputError outside the limits (or for NaN)."""
        low_rad, high_rad = self.limits_rad
        if not low_rad - _LIMIT_SLACK_RAD <= angle_rad <= high_rad + _LIMIT_SLACK_RAD:
            allowed = f"{math.degrees(low_rad):.2f}..{math.degrees(high_rad):.2f}"
            raise InputError(f"{self.name} {math.degrees(angle_rad):.2f} deg is outside {allowed} deg")
        raw_deg = (math.degrees(angle_rad) - self.section.offset_deg) / (self.section.sign * self.section.scale)
        return round(100.0 * raw_deg) % FULL_TURN_RAW

    def angle_rad(self, raw: int) -> float:
        """Return the angle of a raw report, of all that look alike the one nearest to the middle of the limits."""
        raw_deg = math.remainder(raw / 100.0, 360.0)
        angle_deg = self.section.sign * self.section.scale * raw_deg + self.section.offset_deg
        middle_deg = math.degrees(0.5 * (self.limits_rad[0] + self.limits_rad[1]))
        return math.radians(middle_deg + math.remainder(angle_deg - middle_deg, 360.0 * self.section.scale))

    @property
    def sigma_rad(self) -> float:
        """One sigma of a report: its last digit and the play are uniform, so their width over sqrt(12) counts."""
        digit_deg = 0.01 * self.section.scale / math.sqrt(12.0)
        play_deg = self.section.backlash_deg / math.sqrt(12.0)
        return math.radians(math.hypot(digit_deg, play_deg, self.readback_sigma_deg))


@dataclass(frozen=True, slots=True)
class _Sent:
    """The last target sent to an axis, under which permit, and when."""

    raw: int
    permit: object
    stamp_s: float


class PelcoDHead:
    """``camrig.interfaces.Head``. One worker thread uses it; ``stop`` may be called from any."""

    def __init__(self, spec: HeadSpec, section: PelcoDSection, bus: Bus, clock: Clock) -> None:
        self._spec = spec
        self._section = section
        self._bus = bus
        self._clock = clock
        sigma_deg = section.readback_sigma_deg
        self._axes = {
            Axis.PAN: AxisScale("pan", section.axes.pan, spec.pan_limits_rad, sigma_deg),
            Axis.TILT: AxisScale("tilt", section.axes.tilt, spec.tilt_limits_rad, sigma_deg),
        }
        self._link: Link | None = None
        self._permit: object | None = None
        self._unstopped = False
        """Whether a motion may have been sent since the last stop that was written."""
        self._sent: dict[Axis, _Sent] = {}
        self._misses = 0

    def open(self) -> None:
        """Open the line and ask for both axes; moves nothing. A head that a lost link may have left moving is stopped
        first, and one that does not answer may still hear: it is stopped too before LinkLost is raised.
        """
        if self._link is not None:
            return
        link = self._bus.attach(self._section.address)
        try:
            if self._unstopped:
                self._stop(link)
            for axis in self._axes:
                self._first_answer(link, axis)
        except BaseException:
            self._stop(link)
            link.close()
            raise
        self._misses = 0
        self._link = link

    def enable(self) -> None:
        self._permit = self._opened().permit

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        link, permit = self._opened(), self._permit
        if permit is None or permit is not link.permit:
            raise NotEnabledError(f"head {self._spec.id} is not enabled; enable it before moving it")
        for axis, raw in self._targets(pan_rad, tilt_rad).items():
            if self._is_on_its_way(axis, raw, permit):
                continue
            self._unstopped = True
            if not link.move(set_position(axis, raw), permit):
                raise NotEnabledError(f"head {self._spec.id} was stopped before it was sent to its {axis.name.lower()}")
            self._sent[axis] = _Sent(raw, permit, self._clock.now_s())

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        link = self._opened()
        deadline_s = self._clock.now_s() + timeout_s
        readings: list[AxisReading] = []
        for axis, scale in self._axes.items():
            if readings and self._clock.now_s() >= deadline_s:
                break
            answer = link.ask(query_position(axis))
            if isinstance(answer, Answer):
                self._misses = 0
                readings.append(self._reading(scale, answer))
            else:
                self._missed(answer)
        return tuple(readings)

    def stop(self) -> None:
        self._permit = None
        if (link := self._link) is not None:
            self._stop(link)

    def guard(self) -> Guard:
        return Guard(self._opened().port.fd, encode(self._section.address, STOP) * _GUARD_STOPS)

    def close(self) -> None:
        if (link := self._link) is None:
            return
        if self._permit is not None or self._unstopped:
            self.stop()
        self._link = None
        link.close()

    def _stop(self, link: Link) -> None:
        with suppress(LinkLost):
            link.stop()
            self._unstopped = False

    def _opened(self) -> Link:
        if self._link is None:
            raise LinkLost(f"head {self._spec.id} is not open; open it first")
        return self._link

    def _targets(self, pan_rad: float, tilt_rad: float) -> dict[Axis, int]:
        """Return both raw targets, or refuse both."""
        try:
            return {Axis.PAN: self._axes[Axis.PAN].raw(pan_rad), Axis.TILT: self._axes[Axis.TILT].raw(tilt_rad)}
        except InputError as error:
            raise InputError(f"head {self._spec.id} is not moved: {error}") from error

    def _is_on_its_way(self, axis: Axis, raw: int, permit: object) -> bool:
        sent = self._sent.get(axis)
        if sent is None or sent.permit is not permit or sent.raw != raw:
            return False
        return self._clock.now_s() - sent.stamp_s < _RESEND_S

    def _reading(self, scale: AxisScale, answer: Answer) -> AxisReading:
        assert isinstance(answer.reply, Extended)
        if answer.reply.degraded:
            _log.debug("head %s: a %s reply had lost its first bytes", self._spec.id, scale.name)
        return AxisReading(
            head_id=self._spec.id,
            axis=scale.name,
            angle_rad=scale.angle_rad(answer.reply.value),
            stamp_s=answer.stamp_s,
            sigma_rad=scale.sigma_rad,
            stamp_sigma_s=answer.half_window_s / math.sqrt(3.0),  # uniform over the window
        )

    def _first_answer(self, link: Link, axis: Axis) -> None:
        miss = Miss.SILENT
        for _ in range(_TRIES_AT_OPEN):
            answer = link.ask(query_position(axis))
            if isinstance(answer, Answer):
                return
            miss = answer
        raise LinkLost(self._silence(f"does not answer a {axis.name.lower()} query", miss))

    def _missed(self, miss: Miss) -> None:
        self._misses += miss is not Miss.CUT
        if self._misses >= _MISSES_TO_LOSE:
            raise LinkLost(self._silence(f"left {self._misses} queries in a row unanswered", miss))

    def _silence(self, what: str, miss: Miss) -> str:
        section = self._section
        where = f"head {self._spec.id} at address {section.address} on {section.port}, {section.baud} baud"
        return (
            f"{where}, {what} ({miss}); check its power and wiring (A and B swapped?), "
            "its address and baud switches, and that its replies are switched on"
        )
