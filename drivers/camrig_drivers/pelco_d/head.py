"""A pan-tilt head over Pelco-D: its life cycle. How it is pointed is its grade's: ``readback`` or ``open_loop``."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict

from camrig.clock import Clock
from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.interfaces import Guard
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d.axis import AxisScale, Play
from camrig_drivers.pelco_d.bus import Bus, Link
from camrig_drivers.pelco_d.codec import Axis, Command, encode
from camrig_drivers.pelco_d.commands import STOP, TOP_SPEED, drive, lens_settings, query_position
from camrig_drivers.pelco_d.open_loop import OpenLoop
from camrig_drivers.pelco_d.readback import ReadBack
from camrig_drivers.pelco_d.section import Grade, PelcoDSection
from camrig_drivers.pelco_d.steering import Parts, Pointing, RunawayError, Wire
from camrig_drivers.pelco_d.timing import Answer, Miss
from camrig_drivers.pelco_d.watch import Watch

_log = logging.getLogger(__name__)

_TRIES_AT_OPEN = 3
_MISSES_TO_LOSE = 6
"""Unanswered queries in a row after which the head counts as gone: three polls of both axes."""
_GUARD_STOPS = 3
"""A frame cut off in its middle swallows up to one whole frame after it."""


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
        self._pointing = self._new_pointing()
        self._permit: object | None = None
        self._unstopped = False
        """Whether a motion may have been sent since the last stop that was written."""
        self._misses = 0
        self._runaway = ""
        """Why it is not opened again: it went where it was not sent."""
        self._stopped_s: float | None = None
        """When a stop came that the pointing has not been told of."""

    def open(self) -> None:
        """Open the line and ask for both axes; moves nothing. A head that a lost link may have left moving is stopped
        first, and one that does not answer may still hear: it is stopped too before LinkLost is raised.
        """
        if self._link is not None:
            return
        link = self._bus.attach(self._section.address)
        self._pointing = self._new_pointing()
        try:
            if self._unstopped:
                self._stop(link)
            self._refuse_runaway()
            if isinstance(self._pointing, ReadBack):
                for axis in self._axes:
                    self._pointing.begin(axis, self._first_answer(link, axis))
        except BaseException:
            self._stop(link)
            link.close()
            raise
        self._misses = 0
        self._link = link

    def enable(self) -> None:
        link = self._opened()
        if self._permit is link.permit:  # it may be on its way
            return
        self._note_stop()
        self._pointing.forget(self._clock.now_s())
        self._permit = link.permit
        for command in lens_settings(self._section.camera, self._section.dialect):
            link.move(command, self._permit)

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        wire = self._motion()
        self._pointing.aim(self._inside(pan_rad, tilt_rad), wire)

    def steps(self) -> Mapping[str, Sequence[int]]:
        return dict.fromkeys(("pan", "tilt"), range(1, TOP_SPEED + 1))

    def turn(self, pan: int, tilt: int) -> float:
        wire = self._motion()
        self._pointing.forget(self._clock.now_s())
        right, down = pan * self._section.axes.pan.drive_sign, tilt * self._section.axes.tilt.drive_sign
        wire.send(drive(right, -down, self._section.dialect) if pan or tilt else STOP)
        return self._clock.now_s() + 70.0 / self._section.baud

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        link = self._opened()
        self._note_stop()
        try:
            return self._pointing.turn(self._wire(link, self._permit), timeout_s)
        except NotEnabledError:  # stopped by another thread while something was still to be sent
            self._note_stop()
            return ()
        except RunawayError as error:
            self._runaway = str(error)
            raise

    def stop(self) -> None:
        self._permit = None
        if (link := self._link) is not None:
            self._stop(link)
        if self._stopped_s is None:  # of several, the first has ended the motion
            self._stopped_s = self._clock.now_s()

    def guard(self) -> Guard:
        return Guard(self._opened().port.fd, encode(self._section.address, STOP) * _GUARD_STOPS)

    def close(self) -> None:
        if (link := self._link) is None:
            return
        if self._permit is not None or self._unstopped:
            self.stop()
        self._link = None
        link.close()

    def correct(self, reading: AxisReading) -> None:
        """Take an angle that something else measured, as anchors in the picture do; only an open-loop head needs it.

        Called by the worker's thread, as ``read`` is.
        """
        if isinstance(self._pointing, OpenLoop):
            axis = Axis.PAN if reading.axis == "pan" else Axis.TILT
            self._pointing.correct(axis, reading.angle_rad, reading.stamp_s, reading.sigma_rad)

    def statistics(self) -> Mapping[str, float]:
        """Return the counts of ``timing.LinkStatistics`` since the link was opened, and how fast the head replies."""
        if (link := self._link) is None:
            return {}
        times = {"reply_s": link.reply_time.mean_s, "timeout_s": link.reply_time.timeout_s}
        return {**asdict(link.statistics), "disbelieved": self._disbelieved(), **times}

    def _disbelieved(self) -> int:
        watches = self._pointing.parts.watches if isinstance(self._pointing, ReadBack) else {}
        return sum(watch.disbelieved for watch in watches.values())

    def _new_pointing(self) -> Pointing:
        """Return the grade's pointing, knowing nothing: what was before a link was lost may not be true any more."""
        watches = {axis: Watch(self._spec.speed_rad_s) for axis in self._axes}
        plays = {axis: Play(scale.play_rad) for axis, scale in self._axes.items()}
        parts = Parts(self._spec.id, self._section, self._axes, watches, plays, self._clock)
        return OpenLoop(parts) if self._section.grade is Grade.OPEN_LOOP else ReadBack(parts)

    def _motion(self) -> Wire:
        link, permit = self._opened(), self._permit
        if permit is None or permit is not link.permit:
            raise NotEnabledError(f"head {self._spec.id} is not enabled; enable it before moving it")
        return self._wire(link, permit)

    def _wire(self, link: Link, permit: object | None) -> Wire:
        def send(command: Command) -> None:
            self._unstopped = self._unstopped or permit is not None
            if permit is None or not link.move(command, permit):
                raise NotEnabledError(f"head {self._spec.id} was stopped before all of its motion was sent")

        return Wire(link.ask, send, self._missed, self._heard)

    def _refuse_runaway(self) -> None:
        if self._runaway:
            raise LinkLost(f"{self._runaway}; it stays stopped until the rig is started or reloaded")

    def _note_stop(self) -> None:
        """Tell the pointing of a stop that came since; by the worker alone."""
        stopped_s, self._stopped_s = self._stopped_s, None
        if stopped_s is not None:
            self._pointing.forget(stopped_s)

    def _stop(self, link: Link) -> None:
        with suppress(LinkLost):
            link.stop()
            self._unstopped = False

    def _opened(self) -> Link:
        if self._link is None:
            raise LinkLost(f"head {self._spec.id} is not open; open it first")
        return self._link

    def _inside(self, pan_rad: float, tilt_rad: float) -> dict[Axis, float]:
        """Return both angles, or refuse both."""
        try:
            self._axes[Axis.PAN].check(pan_rad)
            self._axes[Axis.TILT].check(tilt_rad)
        except InputError as error:
            raise InputError(f"head {self._spec.id} is not moved: {error}") from error
        return {Axis.PAN: pan_rad, Axis.TILT: tilt_rad}

    def _first_answer(self, link: Link, axis: Axis) -> Answer:
        miss = Miss.SILENT
        for _ in range(_TRIES_AT_OPEN):
            answer = link.ask(query_position(axis))
            if isinstance(answer, Answer):
                return answer
            miss = answer
        raise LinkLost(self._silence(f"does not answer a {axis.name.lower()} query", miss))

    def _heard(self) -> None:
        self._misses = 0

    def _missed(self, miss: Miss) -> None:
        self._misses += miss is not Miss.CUT
        if self._misses >= _MISSES_TO_LOSE:
            raise LinkLost(self._silence(f"left {self._misses} queries in a row unanswered", miss))

    def _silence(self, what: str, miss: Miss) -> str:
        section = self._section
        where = f"head {self._spec.id} at address {section.address} on {section.port}, {section.baud} baud"
        advice = (
            "check that no other head has its address, its baud switches, and its wiring"
            if miss is Miss.GARBLED
            else "check its power and wiring (A and B swapped?), its address and baud switches, "
            "and that its replies are switched on"
        )
        return f"{where}, {what} ({miss}); {advice}"
