"""Pointing of heads that tell where they are: both axes are asked in turn, and steered by what they answer."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping

from camrig.messages import AxisReading
from camrig_drivers.pelco_d.absolute import AbsolutePointing
from camrig_drivers.pelco_d.codec import Axis, Extended
from camrig_drivers.pelco_d.commands import query_position
from camrig_drivers.pelco_d.section import Grade
from camrig_drivers.pelco_d.steering import DisobeyedError, Parts, Steering, Wire
from camrig_drivers.pelco_d.timing import Answer, Miss
from camrig_drivers.pelco_d.velocity import VelocityPointing

_log = logging.getLogger(__name__)


class ReadBack:
    """``Pointing`` by position replies. Where the optics are follows from the motor's whole travel through the play."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self._steering: Steering = (
            VelocityPointing(parts) if parts.section.grade is Grade.VELOCITY else AbsolutePointing(parts)
        )
        self._aims: dict[Axis, float] = {}
        self._order = deque(parts.axes)

    def begin(self, axis: Axis, answer: Answer) -> None:
        """Take where an axis was when the head was opened: what it reports from now on is judged against that."""
        assert isinstance(answer.reply, Extended)
        motor_rad = self.parts.axes[axis].angle_rad(answer.reply.value)
        self.parts.watches[axis].believes(motor_rad, answer.stamp_s)
        self._steering.begin(axis, motor_rad)

    def aim(self, angles_rad: Mapping[Axis, float], wire: Wire) -> None:
        self._aims = dict(angles_rad)
        self._steering.aim(angles_rad, wire)

    def turn(self, wire: Wire, timeout_s: float) -> tuple[AxisReading, ...]:
        """Ask both axes; the second only if the first left time for it, and then it comes first the next time."""
        deadline_s = self.parts.clock.now_s() + timeout_s
        readings: list[AxisReading] = []
        for axis in tuple(self._order):
            if readings and self.parts.clock.now_s() >= deadline_s:
                break
            self._order.rotate(-1)
            answer = wire.ask(query_position(axis))
            self._steering.tend(wire, blind=isinstance(answer, Miss))
            if isinstance(answer, Miss):
                wire.missed(answer)
                continue
            wire.heard()
            readings += self._heard(axis, answer, wire)
        return tuple(readings)

    def forget(self, at_s: float) -> None:
        del at_s  # it tells where it is
        self._aims.clear()
        self._steering.forget()

    def _heard(self, axis: Axis, answer: Answer, wire: Wire) -> list[AxisReading]:
        assert isinstance(answer.reply, Extended)
        scale = self.parts.axes[axis]
        motor_rad = scale.angle_rad(answer.reply.value)
        angle_rad, unknown_rad = self.parts.plays[axis].follow(motor_rad)
        believed = self.parts.watches[axis].believes(motor_rad, answer.stamp_s)
        try:
            self._steering.observe(axis, motor_rad, answer.stamp_s, wire)
        except DisobeyedError as error:
            self._steer_by_speed(error, wire)
        reading = AxisReading(
            head_id=self.parts.name,
            axis=scale.name,
            angle_rad=angle_rad,
            stamp_s=answer.stamp_s - self.parts.section.report_age_s,
            sigma_rad=scale.sigma_rad(unknown_rad),
            stamp_sigma_s=answer.half_window_s / math.sqrt(3.0),  # uniform over the window
            noise_rad=scale.sigma_rad(0.0),
        )
        return [reading] if believed else []

    def _steer_by_speed(self, error: DisobeyedError, wire: Wire) -> None:
        """Go on with speed bytes where positions are not obeyed and the speeds are known; else raise the error."""
        known = all(scale.section.speeds for scale in self.parts.axes.values())
        if isinstance(self._steering, VelocityPointing) or not known:
            raise error
        _log.warning("%s; it is steered by its speeds from now on", error)
        self._steering.forget()
        self._steering = VelocityPointing(self.parts)
        self._steering.aim(self._aims, wire)
