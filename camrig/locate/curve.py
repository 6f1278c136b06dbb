"""One axis at a stamp between its readings: where it was most probably, and how sure that is. Pure floats.

Motors run evenly until something happens: they start, reach their speed, brake, or stand. So the path is followed from
reading to reading with the axis's rate, and for every interval two hypotheses are weighed by how well they explain its
end: nothing has happened, and the path is the chord; or the axis has changed its rate at an unknown moment, and the
deviation ``d`` at the end grew as a parabola over the last part ``y`` of the interval (it began to change late), or
over its first part ``z`` (it had been changing before, and ended). All moments that need an acceleration which heads
have are equally probable; mean and variance over them are in closed form, and those of both hypotheses are merged by
their moments (as in the interacting multiple model filter: Bar-Shalom, Estimation with Applications, ch. 11.6). Of the
deviation only that part is taken for a change of the rate which is no noise: what stamps, reports and an uncertain rate
make of it bends no path. Where two readings are the same the axis stood.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from camrig.geometry.rotation import wrap_angle
from camrig.messages import AxisReading

ACCELERATION_RAD_S2 = 2.0
"""What an axis may do unseen, beyond its last reading: one sigma is how far that takes it."""
_LEAST_RAD_S2, _MOST_RAD_S2 = math.radians(30.0), math.radians(400.0)
_USUAL_RAD_S2 = math.radians(150.0)
"""Accelerations of pan-tilt heads."""
_GROWN = 0.35
"""One sigma of a changing rate's deviation, of its usual acceleration times the interval squared: 0.5 where it changes
all the time, 0.22 where it begins to at any moment.
"""
_HAPPENS, _HAPPENS_AGAIN = 0.4, 0.8
"""How probable it is that the rate changes in an interval after an even one, and after one in which it did."""
_CALIBRATION = 0.45
"""Of the variance of what happens unseen, measured on random moves: motors vary less than all that may happen."""
_STEPS_BY, _STEP_MOST_RAD = 0.5, math.radians(0.6)
"""How probable it is that a short way from rest was a step, begun and ended, and how long such steps are."""
_SEVERAL_FROM_S, _SEVERAL_BY, _SEVERAL_S = 0.5, 0.5, 1.0
"""In intervals longer than the first more than one thing may happen: a start, a stop and another start. Probable by the
second in one of the third, the longest that is bridged.
"""
_SAME_RAD = 1e-9
"""Readings that differ by less are the same digit."""
_LEAST_NOISE_RAD = math.radians(0.01) / math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class _Rate:
    """An axis's rate at a reading, its variance, and how probable it is that it was changing just before."""

    rad_s: float
    variance: float
    changing: float


@dataclass(frozen=True, slots=True)
class _Interval:
    """From one reading to the next."""

    turn_rad: float
    lasts_s: float
    noise_a: float
    """Variances of what the stamps' windows, and the step of the reports, make uncertain of both angles."""
    noise_b: float

    @property
    def slope_rad_s(self) -> float:
        return self.turn_rad / self.lasts_s

    @property
    def slope_variance(self) -> float:
        return (self.noise_a + self.noise_b) / self.lasts_s**2

    def stray_rad(self, share: float) -> float:
        """Return how far an axis that speeds up or slows down all the time is from the chord."""
        return min(0.5 * ACCELERATION_RAD_S2 * self.lasts_s**2 * share * (1.0 - share), 0.5 * abs(self.turn_rad))

    def deviation(self, rate: _Rate) -> float:
        """Return how far the end is from where the rate leads."""
        return self.turn_rad - rate.rad_s * self.lasts_s

    def noise(self, rate: _Rate) -> float:
        """Return the variance of the deviation of an axis that runs on evenly."""
        return self.noise_a + self.noise_b + rate.variance * self.lasts_s**2

    def bend(self, rate: _Rate) -> tuple[float, float]:
        """Return the part of the deviation that bends the path, if the rate has changed, and its variance."""
        noise, bent = self.noise(rate), (_GROWN * _USUAL_RAD_S2 * self.lasts_s**2) ** 2
        gain = bent / (bent + noise)
        return gain * self.deviation(rate), gain * noise

    def happened(self, rate: _Rate) -> float:
        """Return how probable it is that the rate has changed in this interval."""
        expected = self.noise(rate)
        prior = _HAPPENS + (_HAPPENS_AGAIN - _HAPPENS) * rate.changing
        even = math.exp(-0.5 * self.deviation(rate) ** 2 / expected) / math.sqrt(math.tau * expected)
        changed = 1.0 / math.hypot(_USUAL_RAD_S2 * self.lasts_s**2, math.sqrt(expected))
        return prior * changed / (prior * changed + (1.0 - prior) * even)

    def stepped(self, rate: _Rate) -> float:
        """Return how probable it is that a resting axis made a short step of its own in this interval."""
        if abs(rate.rad_s) * self.lasts_s > 0.5 * abs(self.turn_rad):
            return 0.0
        return _STEPS_BY * math.exp(-((self.turn_rad / _STEP_MOST_RAD) ** 2))

    @property
    def several(self) -> float:
        """Return how probable it is that more happened in this interval than one change of the rate."""
        longer = (self.lasts_s - _SEVERAL_FROM_S) / (_SEVERAL_S - _SEVERAL_FROM_S)
        return _SEVERAL_BY * min(max(longer, 0.0), 1.0)

    def parts(self, deviation_rad: float) -> tuple[float, float]:
        """Return the least and the greatest part of the interval in which the deviation may have grown."""
        least = math.sqrt(2.0 * abs(deviation_rad) / _MOST_RAD_S2) / self.lasts_s
        most = math.sqrt(2.0 * abs(deviation_rad) / _LEAST_RAD_S2) / self.lasts_s
        return min(max(least, 1e-6), 0.9), min(max(most, 3e-6), 1.0)

    def next_rate(self, rate: _Rate) -> _Rate:
        """Return the rate at the interval's end."""
        gain = rate.variance / (rate.variance + self.slope_variance)
        even = rate.rad_s + gain * (self.slope_rad_s - rate.rad_s), (1.0 - gain) * rate.variance
        happened = self.happened(rate)
        low, high = self.parts(self.deviation(rate))
        late = math.log(high / low) / (high - low), 1.0 / (low * high)
        mean, square = _mixed(0.5 * rate.changing, late, (0.5 * _EARLY_SLOPE, 0.25 * _EARLY_SLOPE_SQUARE))
        bend_rad, variance = self.bend(rate)
        spread = 4.0 * bend_rad**2 * max(0.0, square - mean**2) + variance * min(1.0, (2.0 * mean - 1.0) ** 2)
        reach = _USUAL_RAD_S2 * self.lasts_s  # no head gets further from the mean rate than that
        change = min(max((2.0 * mean - 1.0) * bend_rad / self.lasts_s, -reach), reach)
        uncertain = min(spread / self.lasts_s**2, (0.5 * reach) ** 2) + self.slope_variance
        return _Rate(*_merged(happened, even, (self.slope_rad_s + change, uncertain)), happened)

    def at(self, rate: _Rate, share: float) -> tuple[float, float]:
        """Return how far the axis has come at a share of the interval, and the variance of that."""
        late = _late(share, *self.parts(self.deviation(rate)))
        mean, square = _mixed(0.5 * rate.changing, late, _early(share))
        bend_rad, variance = self.bend(rate)
        changed_rad = share * self.turn_rad + (mean - share) * bend_rad
        spread = bend_rad**2 * max(0.0, square - mean**2) + variance * (mean - share) ** 2
        come_rad, variance = _merged(self.happened(rate), (share * self.turn_rad, 0.0), (changed_rad, spread))
        any_time = share * self.turn_rad, share * (1.0 - share) * self.turn_rad**2
        come_rad, variance = _merged(max(self.stepped(rate), self.several), (come_rad, variance), any_time)
        return come_rad, _CALIBRATION * variance + (1.0 - share) ** 2 * self.noise_a + share**2 * self.noise_b


def _mixed(weight: float, one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Return mean and mean square of a mixture, ``weight`` being that of the other."""
    return tuple((1.0 - weight) * a + weight * b for a, b in zip(one, other, strict=True))  # type: ignore[return-value]


def _merged(weight: float, one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Return mean and variance of a mixture, ``weight`` being that of the other."""
    mean = (1.0 - weight) * one[0] + weight * other[0]
    apart = weight * (1.0 - weight) * (one[0] - other[0]) ** 2
    return mean, (1.0 - weight) * one[1] + weight * other[1] + apart


_EARLY_SLOPE = 2.0 * math.log(2.0)
"""Mean over z of 2 / (2 - z), the slope at the end of a change that ended after z; and of its square."""
_EARLY_SLOPE_SQUARE = 2.0


def axis_at(readings: Sequence[AxisReading], stamp_s: float) -> tuple[float, float]:
    """Return angle (rad) and variance (rad2) at the stamp, from two or more readings, oldest first.

    The last two are those round the stamp, or the ones nearest to it. Readings share their error (a zero, a step, the
    play), so more of them do not make it smaller.
    """
    before, after = readings[-2:]
    interval = _between(before, after)
    sigma_rad = max(before.sigma_rad, after.sigma_rad)
    outside_s = max(before.stamp_s - stamp_s, stamp_s - after.stamp_s, 0.0)
    if outside_s == 0.0 and abs(interval.turn_rad) < _SAME_RAD:
        return before.angle_rad, sigma_rad**2
    first = _between(readings[0], readings[1])
    rate = _Rate(first.slope_rad_s, first.slope_variance + (0.5 * first.slope_rad_s) ** 2, 0.5)
    for one, next_one in pairwise(readings[:-1]):
        rate = _between(one, next_one).next_rate(rate)
    if outside_s == 0.0:
        share = (stamp_s - before.stamp_s) / interval.lasts_s
        come_rad, variance = interval.at(rate, share)
        if len(readings) == 2:  # nothing tells what was before
            variance += interval.stray_rad(share) ** 2
        low_rad, high_rad = sorted((0.0, interval.turn_rad))
        return before.angle_rad + min(max(come_rad, low_rad), high_rad), variance + sigma_rad**2
    stray = (0.5 * ACCELERATION_RAD_S2 * outside_s**2) ** 2
    if stamp_s < before.stamp_s:
        slope, variance = interval.slope_rad_s, interval.slope_variance + rate.variance
        return before.angle_rad - slope * outside_s, variance * outside_s**2 + stray + sigma_rad**2
    last = interval.next_rate(rate)
    angle_rad = before.angle_rad + interval.turn_rad + last.rad_s * outside_s
    return angle_rad, last.variance * outside_s**2 + interval.noise_b + stray + sigma_rad**2


def _between(before: AxisReading, after: AxisReading) -> _Interval:
    turn_rad = wrap_angle(after.angle_rad - before.angle_rad)
    lasts_s = after.stamp_s - before.stamp_s
    rate_rad_s = turn_rad / lasts_s
    noise = [(rate_rad_s * reading.stamp_sigma_s) ** 2 + _own_noise(reading, turn_rad) for reading in (before, after)]
    return _Interval(turn_rad, lasts_s, noise[0], noise[1])


def _own_noise(reading: AxisReading, turn_rad: float) -> float:
    """Return the variance of what makes a reading differ from its neighbour: at rest both are rounded alike."""
    return max(reading.noise_rad, _LEAST_NOISE_RAD) ** 2 if abs(turn_rad) > _SAME_RAD else 1e-14


def _late(share: float, low: float, high: float) -> tuple[float, float]:
    """Return mean and mean square of the part of the deviation that is there at a share of the interval.

    It grows as ((y - c) / y)^2 with c = 1 - share, from y = c on, and y is uniform from ``low`` to ``high``.
    """
    c = 1.0 - share
    start = max(low, c)
    if start >= high:
        return 0.0, 0.0
    if c == 0.0:
        return 1.0, 1.0

    def once(y: float) -> float:
        return y - 2.0 * c * math.log(y) - c**2 / y

    def twice(y: float) -> float:
        return y - 4.0 * c * math.log(y) - 6.0 * c**2 / y + 2.0 * c**3 / y**2 - c**4 / (3.0 * y**3)

    return (once(high) - once(start)) / (high - low), (twice(high) - twice(start)) / (high - low)


_STEPS = 8


def _early(share: float) -> tuple[float, float]:
    """Return the same of a change that ended after the part ``z`` of the interval, z uniform from 0 to 1."""
    total = square = 0.0
    for step in range(_STEPS):
        z = (step + 0.5) / _STEPS
        grown = (share**2 if share < z else 2.0 * share * z - z**2) / (2.0 * z - z**2)
        total, square = total + grown, square + grown**2
    return total / _STEPS, square / _STEPS
