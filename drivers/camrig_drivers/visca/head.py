"""A pan-tilt head that takes absolute positions and reports them, over VISCA."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict

from camrig.clock import Clock
from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.interfaces import Guard
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.visca.axis import AxisScale
from camrig_drivers.visca.codec import (
    INQUIRE_PAN_TILT,
    SOCKETS,
    Acknowledged,
    Completed,
    Error,
    Refused,
    absolute,
    cancel,
    message,
    pan_tilt,
    stop,
    zoom_to,
)
from camrig_drivers.visca.line import Answer, Line, Miss
from camrig_drivers.visca.link import Link
from camrig_drivers.visca.plausible import HASTE, Doubt
from camrig_drivers.visca.section import ViscaSection
from camrig_drivers.visca.sent import Sent

_log = logging.getLogger(__name__)

_TRIES_AT_OPEN = 4
_MISSES_TO_LOSE = 4
"""Unanswered inquiries in a row after which the head counts as gone."""
_TRIES_TO_MOVE = 4
_BUSY_S = 0.1
"""Cameras refuse commands for up to 0.25 s after a preset or a cancel."""


class ViscaHead:
    """``camrig.interfaces.Head``. One worker thread uses it; ``stop`` may be called from any."""

    def __init__(self, spec: HeadSpec, section: ViscaSection, line: Line, clock: Clock) -> None:
        self._spec = spec
        self._section = section
        self._line = line
        self._clock = clock
        sigma_deg = section.readback_sigma_deg
        self._pan = AxisScale("pan", section.axes.pan, spec.pan_limits_rad, sigma_deg)
        self._tilt = AxisScale("tilt", section.axes.tilt, spec.tilt_limits_rad, sigma_deg)
        self._doubt = self._new_doubt()
        self._link: Link | None = None
        self._permit: object | None = None
        self._unstopped = False
        """Whether a motion may have been sent since the last stop that was written."""
        self._sent: Sent | None = None
        self._zoomed: object | None = None
        """The permit under which the zoom was set."""
        self._misses = 0
        self._whereabouts: list[tuple[float, float]] = []
        """The last position that was believed, and every target since."""
        self._tells_targets = False
        self._disbelieved = 0
        self._reply_s = math.nan
        """How long the head takes to begin its answer, smoothed."""

    def open(self) -> None:
        """Open the line and ask for the position; moves nothing. A head that a lost link may have left moving is
        stopped first, and one that does not answer may still hear: it is stopped too before LinkLost is raised.
        """
        if self._link is not None:
            return
        link = Link(self._line, self._section.address)
        try:
            if self._unstopped or link.stop_unheard:
                self._stop(link)
            self._first_positions(link)
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
        counts = self._counts(pan_rad, tilt_rad)
        now_s = self._clock.now_s()
        sent = self._sent
        if sent and sent.permit is permit and sent.counts == counts and now_s < sent.resend_s:
            return
        self._unstopped, section = True, self._section
        if section.zoom is not None and self._zoomed is not permit:
            zoomed = self._tell(link, zoom_to(section.zoom), permit, lasting=True)
            self._zoomed = permit if not isinstance(zoomed, Refused) else None
        speeds = (section.pan_speed, section.tilt_speed)
        outcome = self._tell(link, absolute(*counts, speeds, section.digits), permit)
        if not isinstance(outcome, Refused):
            way_s = self._way_s(pan_rad, tilt_rad)
            self._sent = Sent(counts, permit, now_s, way_s, isinstance(outcome, Acknowledged))
            self._whereabouts.append((pan_rad, tilt_rad))

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        del timeout_s  # an exchange is bounded by the line's own
        link = self._opened()
        answer = link.ask(INQUIRE_PAN_TILT, sum(self._sizes))
        if not isinstance(answer, Answer):
            self._missed(answer)
            return ()
        took_s = 2.0 * answer.half_window_s
        self._reply_s = took_s if math.isnan(self._reply_s) else 0.9 * self._reply_s + 0.1 * took_s
        found = self._believed(answer)
        if found is None:
            self._disbelieved += 1
            return ()
        return tuple(
            AxisReading(
                head_id=self._spec.id,
                axis=scale.name,
                angle_rad=angle_rad,
                stamp_s=answer.stamp_s,
                sigma_rad=scale.sigma_rad,
                stamp_sigma_s=answer.half_window_s / math.sqrt(3.0),  # uniform over the window
                noise_rad=scale.noise_rad,
            )
            for scale, angle_rad in zip((self._pan, self._tilt), found, strict=True)
        )

    def stop(self) -> None:
        self._permit = None
        if (link := self._link) is not None:
            self._stop(link)

    def guard(self) -> Guard:
        link, address = self._opened(), self._section.address
        cancels = [message(address, cancel(socket)) for socket in SOCKETS]
        return Guard(link.transport.fd, link.transport.guard_bytes(message(address, self._stop_body), cancels))

    def close(self) -> None:
        if (link := self._link) is None:
            return
        if self._permit is not None or self._unstopped:
            self.stop()
        self._link = None
        link.close()

    def statistics(self) -> Mapping[str, float]:
        """Return the counts of ``link.LinkStatistics`` since the link was opened; any thread."""
        if (link := self._link) is None:
            return {}
        return {**asdict(link.statistics), "disbelieved": self._disbelieved, "reply_s": self._reply_s}

    # --- inside -----------------------------------------------------------------------------------------

    @property
    def _sizes(self) -> tuple[int, int]:
        return self._section.axes.pan.digits, self._section.axes.tilt.digits

    @property
    def _stop_body(self) -> bytes:
        return stop((self._section.pan_speed, self._section.tilt_speed))

    def _stop(self, link: Link) -> None:
        with suppress(LinkLost):
            link.stop(self._stop_body)
            self._unstopped = False

    def _opened(self) -> Link:
        if self._link is None:
            raise LinkLost(f"head {self._spec.id} is not open; open it first")
        return self._link

    def _counts(self, pan_rad: float, tilt_rad: float) -> tuple[int, int]:
        """Return both targets, or refuse both."""
        try:
            return self._pan.count(pan_rad), self._tilt.count(tilt_rad)
        except InputError as error:
            raise InputError(f"head {self._spec.id} is not moved: {error}") from error

    def _tell(
        self, link: Link, command: bytes, permit: object, *, lasting: bool = False
    ) -> Acknowledged | Completed | Refused | Miss:
        """Give a command, again where the head is busy; return what came of it. Raises NotEnabledError once stopped."""
        for left in reversed(range(_TRIES_TO_MOVE)):
            outcome = link.tell(command, permit, lasting=lasting)
            if permit is not link.permit:
                raise NotEnabledError(f"head {self._spec.id} was stopped before it was moved")
            busy = isinstance(outcome, Refused) and outcome.code in {Error.BUFFER_FULL, Error.NOT_EXECUTABLE}
            if not busy or not left:
                break
            self._clock.sleep_s(_BUSY_S)
        if isinstance(outcome, Refused):
            _log.warning("head %s refuses to move: %s", self._spec.id, outcome)
        return outcome

    def _believed(self, answer: Answer) -> tuple[float, float] | None:
        """Return both angles of an answer; None where they are nonsense, or too far from the last to be true."""
        counts = pan_tilt(answer.content, self._section.digits)
        if counts is None:
            self._missed(Miss.GARBLED)
            return None
        self._misses = 0
        if self._sent is not None and self._is_hearsay(self._sent, counts, answer.stamp_s):
            return None
        angles_rad = self._pan.angle_rad(counts[0]), self._tilt.angle_rad(counts[1])
        moving = self._sent is not None and answer.stamp_s < self._sent.until_s
        if not self._doubt.believes(*angles_rad, answer.stamp_s, moving=moving):
            return None
        self._whereabouts = [angles_rad]
        return angles_rad

    def _is_hearsay(self, sent: Sent, counts: tuple[int, int], stamp_s: float) -> bool:
        """Tell whether a position may be a target instead: some heads report where they are going to.

        One that names its target sooner than it can be there is found out, and from then on believed only at rest.
        """
        too_soon = stamp_s < sent.stamp_s + sent.way_s / HASTE
        if not self._tells_targets and too_soon and sent.names(counts):
            self._tells_targets = True
            _log.warning("head %s reports where it is going to, not where it is: unknown while it moves", self._spec.id)
        return self._tells_targets and stamp_s < sent.until_s

    def _way_s(self, pan_rad: float, tilt_rad: float) -> float:
        """Return how long the way takes at the head's speed, from the farthest place where it may be now."""
        ways_rad = [max(abs(pan_rad - pan), abs(tilt_rad - tilt)) for pan, tilt in self._whereabouts]
        return max(ways_rad, default=0.0) / self._spec.speed_rad_s

    def _new_doubt(self) -> Doubt:
        digit_deg = max(self._section.axes.pan.deg_per_count, self._section.axes.tilt.deg_per_count)
        return Doubt(self._spec.speed_rad_s, math.radians(digit_deg))

    def _first_positions(self, link: Link) -> None:
        """Ask until two positions in a row agree, or raise LinkLost."""
        self._doubt = self._new_doubt()
        last: Refused | Miss = Miss.SILENT
        for _ in range(_TRIES_AT_OPEN):
            self._misses = 0
            answer = link.ask(INQUIRE_PAN_TILT, sum(self._sizes))
            if isinstance(answer, Answer):
                if self._believed(answer) is not None:
                    return
                last = Miss.GARBLED
            else:
                last = answer
        raise LinkLost(self._silence("does not tell its position", last))

    def _missed(self, miss: Refused | Miss) -> None:
        self._misses += miss is not Miss.CUT
        if self._misses >= _MISSES_TO_LOSE:
            raise LinkLost(self._silence(f"left {self._misses} inquiries in a row unanswered", miss))

    def _silence(self, what: str, miss: Refused | Miss) -> str:
        section = self._section
        if section.udp:
            where, advice = section.port, "that VISCA over IP is on, and `header` (Sony: true, PTZOptics: false)"
        else:
            where = f"{section.port}, {section.baud} baud, address {section.address}"
            advice = "its wiring, and its address and baud switches"
        if isinstance(miss, Refused) and miss.code == Error.NOT_EXECUTABLE:
            advice = "whether it is in standby"
        return f"head {self._spec.id} at {where}, {what} ({miss}); check its power, {advice}"
