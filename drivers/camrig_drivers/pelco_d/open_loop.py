"""Pointing without any reply: speed bytes by the clock, and an angle that is reckoned, never measured.

The head is unknown until it has zeroed itself by a preset or its end stops, or anchors in its camera's picture measured
where it looks (``correct``); from then on the sigma of its angles grows with every motion until the next anchor, and
one beyond the section's bound makes it zero itself again before it moves on. Targets keep three sigma from the limits.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig.geometry.rotation import wrap_angle
from camrig.messages import AxisReading
from camrig_drivers.pelco_d.axis import SpeedTable
from camrig_drivers.pelco_d.codec import Axis, Op
from camrig_drivers.pelco_d.commands import STOP, drive, extended
from camrig_drivers.pelco_d.reckoning import Reckoning, TimeModel
from camrig_drivers.pelco_d.section import AxisSection, OpenLoopSection
from camrig_drivers.pelco_d.steering import Parts, Wire

_log = logging.getLogger(__name__)

_PERIOD_S = 0.1
_LEAST_RUN_S = 0.4
_NEAR_RAD = math.radians(0.05)
_SIGMAS = 3.0
_KEPT = 64
"""Readings kept to compare a measurement with, some seconds of them."""
_STAMP_SIGMA_S = 0.0005


@dataclass(slots=True)
class _Run:
    """One axis: its speeds, what it is after, what it was told, and where it is reckoned to be."""

    speeds: SpeedTable
    model: TimeModel
    target_rad: float | None = None
    byte: int = 0
    end_s: float = math.inf
    bound_rad: float | None = None
    """The target for which that end was planned."""
    reckoning: Reckoning | None = None
    past: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_KEPT))


class OpenLoop:
    """``Pointing`` by time."""

    def __init__(self, parts: Parts) -> None:
        assert parts.section.open_loop is not None
        self.parts = parts
        self._section = section = parts.section.open_loop
        self._runs = {
            axis: _Run(SpeedTable(scale.section.speeds), _model(section, scale.section))
            for axis, scale in parts.axes.items()
            if scale.section.speeds
        }
        self._zeroed_s: float | None = None
        """When the zeroing under way will be done."""
        self._sent_s = -math.inf

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        for axis, angle_rad in angles_rad.items():
            self._runs[axis].target_rad = angle_rad
        if self._zeroed_s is None and self._needs_zero():
            self._zero(wire)

    def turn(self, wire: Wire, timeout_s: float) -> tuple[AxisReading, ...]:
        """Wait for what is due next, do it, and tell where the head is reckoned to be; nothing while it is unknown."""
        clock = self.parts.clock
        due_s = min([run.end_s for run in self._runs.values()] + [self._zeroed_s or math.inf])
        wait_s = min(_PERIOD_S, timeout_s, due_s - clock.now_s())
        if wait_s > 0.0:
            clock.sleep_s(wait_s)
        if self._zeroed_s is not None:
            self._end_zero(wire)
        else:
            self._steer(wire)
        if self._sent_s + self.parts.section.refresh_s <= clock.now_s() and any(
            run.byte for run in self._runs.values()
        ):
            self._drive({}, wire)
        return self._readings(clock.now_s())

    def forget(self, at_s: float) -> None:
        """Whatever moved was stopped at ``at_s``."""
        now_s = at_s + self.parts.frame_s
        if self._zeroed_s is not None:  # interrupted on its way to where it would have been known
            self._zeroed_s = None
            self._lose()
        for run in self._runs.values():
            run.target_rad, run.byte, run.end_s = None, 0, math.inf
            if run.reckoning is not None:
                run.reckoning.command(0.0, now_s)

    def correct(self, axis: Axis, angle_rad: float, stamp_s: float, sigma_rad: float) -> None:
        """Take what was measured of an axis at a stamp of the last seconds, if it is surer than what is reckoned.

        Measurements share errors (where the anchors hang, the lens), so more of them in a row do not make it surer.
        """
        run, now_s = self._runs[axis], self.parts.clock.now_s()
        if self._zeroed_s is not None:
            return
        if run.reckoning is None:
            if all(other.byte == 0 for other in self._runs.values()):
                run.reckoning = Reckoning(run.model, angle_rad, sigma_rad**2)
            return
        reckoned_rad = _between(run.past, stamp_s)
        if reckoned_rad is None:
            return
        run.reckoning.settle(now_s)
        variance = run.reckoning.variance
        if sigma_rad**2 < variance:
            run.reckoning.correct(wrap_angle(angle_rad - reckoned_rad), variance / (variance + sigma_rad**2))
            run.past.clear()

    def _needs_zero(self) -> bool:
        if self._section.zero.by == "anchors":  # nowhere to go for it: it stands until one is in view
            return False
        now_s, bound_rad = self.parts.clock.now_s(), math.radians(self._section.rezero_above_deg)
        reckonings = [run.reckoning for run in self._runs.values()]
        return any(reckoning is None or reckoning.sigma_rad(now_s) > bound_rad for reckoning in reckonings)

    def _zero(self, wire: Wire) -> None:
        zero = self._section.zero
        self._lose()
        if zero.preset is not None:
            allow = self.parts.section.special_presets
            wire.send(extended(Op.CALL_PRESET, zero.preset, allow_special=allow))
        else:
            self._drive({axis: self._towards_stop(axis) for axis in self._runs}, wire)
        self._zeroed_s = self.parts.clock.now_s() + zero.travel_s

    def _towards_stop(self, axis: Axis) -> int:
        low_rad, high_rad = self.parts.axes[axis].limits_rad
        speeds = self._runs[axis].speeds
        growing = self._zero_rad(axis) >= 0.5 * (low_rad + high_rad)
        return speeds.byte_for(speeds.fastest_rad_s) * (1 if growing else -1)

    def _zero_rad(self, axis: Axis) -> float:
        zero = self._section.zero
        angle_deg = zero.pan_deg if axis is Axis.PAN else zero.tilt_deg
        assert angle_deg is not None, "checked by the section wherever a zero has a place"
        return math.radians(angle_deg)

    def _end_zero(self, wire: Wire) -> None:
        assert self._zeroed_s is not None
        if self.parts.clock.now_s() < self._zeroed_s:
            return
        if self._section.zero.by == "end_stops":
            self._drive(dict.fromkeys(self._runs, 0), wire)
        self._zeroed_s = None
        variance = math.radians(self._section.zero.sigma_deg) ** 2
        for axis, run in self._runs.items():
            run.reckoning = Reckoning(run.model, self._zero_rad(axis), variance)

    def _lose(self) -> None:
        for run in self._runs.values():
            run.reckoning, run.byte, run.end_s = None, 0, math.inf
            run.past.clear()

    def _steer(self, wire: Wire) -> None:
        """End runs that are due, and begin those that are wanted of axes that stand."""
        now_s = self.parts.clock.now_s()
        wanted: dict[Axis, int] = {}
        for axis, run in self._runs.items():
            if run.reckoning is None or run.target_rad is None:
                continue
            target_rad = self._kept_inside(axis, run.target_rad, run.reckoning.sigma_rad(now_s))
            if run.byte:
                if now_s >= run.end_s or run.bound_rad is None or abs(run.target_rad - run.bound_rad) > _NEAR_RAD:
                    wanted[axis] = 0  # there, or no longer wanted there
            elif run.reckoning.rests(now_s) and abs(target_rad - run.reckoning.at(now_s)) > _NEAR_RAD:
                wanted[axis] = self._byte_for(run, target_rad - run.reckoning.at(now_s))
        if wanted:
            self._drive(wanted, wire)
            for axis, byte in wanted.items():
                self._plan_end(axis, byte)

    def _kept_inside(self, axis: Axis, target_rad: float, sigma_rad: float) -> float:
        low_rad, high_rad = self.parts.axes[axis].limits_rad
        margin_rad = min(_SIGMAS * sigma_rad, 0.5 * (high_rad - low_rad))
        return min(max(target_rad, low_rad + margin_rad), high_rad - margin_rad)

    def _byte_for(self, run: _Run, way_rad: float) -> int:
        """Return the signed byte of the greatest speed that is reached and held for a while on the way."""
        most_rad_s = min(abs(way_rad) / _LEAST_RUN_S, math.sqrt(abs(way_rad) * run.model.acceleration_rad_s2))
        byte = run.speeds.byte_for(max(most_rad_s, run.speeds.slowest_rad_s))
        return int(math.copysign(byte, way_rad))

    def _plan_end(self, axis: Axis, byte: int) -> None:
        run = self._runs[axis]
        run.end_s, run.bound_rad = math.inf, run.target_rad
        if byte == 0 or run.reckoning is None or run.target_rad is None:
            return
        sigma_rad = run.reckoning.sigma_rad(self._sent_s)
        way_rad = self._kept_inside(axis, run.target_rad, sigma_rad) - run.reckoning.angle_rad
        lasts_s = abs(way_rad) / run.speeds.speed_rad_s(abs(byte))
        run.end_s = self._sent_s + run.model.start_s + lasts_s - self.parts.frame_s

    def _drive(self, wanted: Mapping[Axis, int], wire: Wire) -> None:
        bytes_ = {axis: wanted.get(axis, run.byte) for axis, run in self._runs.items()}
        pan, tilt = (bytes_[axis] * self.parts.axes[axis].section.drive_sign for axis in (Axis.PAN, Axis.TILT))
        wire.send(drive(pan, -tilt, self.parts.section.dialect) if pan or tilt else STOP)
        self._sent_s = self.parts.clock.now_s() + self.parts.frame_s
        for axis, run in self._runs.items():
            run.byte = bytes_[axis]
            if run.reckoning is not None:
                speed_rad_s = math.copysign(run.speeds.speed_rad_s(abs(run.byte)), run.byte)
                run.reckoning.command(speed_rad_s if run.byte else 0.0, self._sent_s)

    def _readings(self, now_s: float) -> tuple[AxisReading, ...]:
        readings = []
        for axis, run in self._runs.items():
            if run.reckoning is None:
                continue
            scale = self.parts.axes[axis]
            angle_rad = run.reckoning.at(now_s)
            run.past.append((now_s, angle_rad))
            sigma_rad = math.hypot(run.reckoning.sigma_rad(now_s), scale.play_rad / math.sqrt(12.0))
            readings.append(AxisReading(self.parts.name, scale.name, angle_rad, now_s, sigma_rad, _STAMP_SIGMA_S))
        return tuple(readings)


def _model(section: OpenLoopSection, axis: AxisSection) -> TimeModel:
    acceleration_rad_s2 = math.radians(axis.acceleration_deg_s2)
    return TimeModel(
        section.start_s, section.start_sigma_s, section.stop_sigma_s, acceleration_rad_s2, section.speed_sigma
    )


def _between(past: deque[tuple[float, float]], stamp_s: float) -> float | None:
    """Return what was reckoned for a stamp; None where that is not kept any more, or not yet."""
    for (before_s, before_rad), (after_s, after_rad) in zip(list(past), list(past)[1:], strict=False):
        if before_s <= stamp_s <= after_s:
            share = (stamp_s - before_s) / (after_s - before_s)
            return before_rad + share * (after_rad - before_rad)
    return None
