"""What turns at known steps of speed tell of a head's time: speeds, acceleration, dead time, the age of its reports.

The motion is that of a motor which takes up a speed, and ends, with one acceleration (as driver models have it): a turn
told to begin at 0 and to end at T is a trapezoid that begins ``start_s`` late and ends ``stop_s`` late.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from camrig.calibrate.head_fit import off_model_rad
from camrig.calibrate.head_model import HeadModel, HeadShot, views_of
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens

_STOOD_RAD = math.radians(0.15)
"""A step of which a turn came no further turns nothing."""
_READING_RAD = math.radians(0.01)
_FIRST = (0.1, 0.02, 1.0 / math.radians(150.0))
_EVEN_S = 0.1
"""A turn goes evenly from so long after it has its speed."""
_TAKEN_UP_RAD = math.radians(2.0)
_LEAST_RAD_S, _MOST_RAD_S = math.radians(1.0), math.radians(15.0)
"""Turns slower than this tell little of time; pictures of faster ones are smeared."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One turn of one axis at a signed ``step``, told and ended at stamps by which the head had heard it.

    ``stamps_s`` (n,), ``stamp_sigma_s`` (n,) and ``reported_rad`` (n,) are the axis's reports from before to after.
    """

    axis: int
    step: int
    told_s: float
    ended_s: float
    stamps_s: Array
    stamp_sigma_s: Array
    reported_rad: Array


@dataclass(frozen=True, slots=True, eq=False)
class AxisTiming:
    """``speed_rad_s`` by signed step, positive where reports grow; times and ``acceleration_rad_s2`` with their sigma;
    ``at_rest_rad`` is where each of the ``runs`` began. Angles as reported.
    """

    runs: tuple[Run, ...]
    speed_rad_s: Mapping[int, float]
    speed_sigma_rad_s: Mapping[int, float]
    start_s: float
    start_sigma_s: float
    stop_s: float
    acceleration_rad_s2: float
    acceleration_sigma_rad_s2: float
    at_rest_rad: Array
    residual_rad: Array
    """(all reports,) what the model leaves of them."""

    def reported_at(self, run: int, stamp_s: float) -> tuple[float, float]:
        """Return the smooth course of a run's reports and its speed at a stamp."""
        each = self.runs[run]
        way, speed = _course(
            np.array([stamp_s]), each, self.speed_rad_s[each.step], self.start_s, self.stop_s, self.acceleration_rad_s2
        )
        return float(self.at_rest_rad[run] + way[0]), float(speed[0])


def axis_timing(runs: Sequence[Run]) -> AxisTiming | None:
    """Fit all runs of one axis together; None where fewer than two speeds turned it."""
    moving = [run for run in runs if abs(run.reported_rad[-1] - run.reported_rad[0]) > _STOOD_RAD]
    steps = sorted({run.step for run in moving})
    if len({abs(step) for step in steps}) < 2:
        return None
    rest = np.array([_rested(run) for run in moving])
    first = [_first_speed(run, rest[k]) for k, run in enumerate(moving)]
    speeds = [float(np.mean([v for v, run in zip(first, moving, strict=True) if run.step == step])) for step in steps]
    place = [steps.index(run.step) for run in moving]

    def residuals(x: Array) -> Array:
        start_s, stop_s, inverse = x[:3]
        parts = []
        for k, run in enumerate(moving):
            speed = x[3 + place[k]]
            way, now = _course(run.stamps_s, run, speed, start_s, stop_s, 1.0 / max(inverse, 1e-4))
            sigma = np.hypot(_READING_RAD, now * run.stamp_sigma_s)
            parts.append((rest[k] + way - run.reported_rad) / sigma)
        return np.concatenate(parts)

    found = least_squares(residuals, [*_FIRST, *speeds], loss="soft_l1", x_scale=[0.05, 0.05, 0.2, *np.abs(speeds)])
    left = residuals(found.x)
    variance = float(np.median(np.abs(left)) / 0.6745) ** 2
    slopes: Array = np.asarray(found.jac, float)
    covariance = np.linalg.pinv(slopes.T @ slopes) * max(variance, 1e-6)
    sigma = np.sqrt(np.diag(covariance))
    inverse = max(float(found.x[2]), 1e-4)
    return AxisTiming(
        runs=tuple(moving),
        speed_rad_s={step: float(found.x[3 + k]) for k, step in enumerate(steps)},
        speed_sigma_rad_s={step: float(sigma[3 + k]) for k, step in enumerate(steps)},
        start_s=float(found.x[0]),
        start_sigma_s=float(sigma[0]),
        stop_s=float(found.x[1]),
        acceleration_rad_s2=1.0 / inverse,
        acceleration_sigma_rad_s2=float(sigma[2]) / inverse**2,
        at_rest_rad=rest,
        residual_rad=left * _READING_RAD,
    )


def report_age(
    model: HeadModel,
    T_world_tag: Mapping[str, Transform],
    lens: Lens,
    sizes_m: Mapping[str, float],
    timings: Sequence[AxisTiming | None],
    frames: Sequence[tuple[float, Mapping[str, Array]]],
) -> tuple[float, float] | None:
    """Return how long before its stamp a report was so, by the camera's stamps, and its sigma in seconds.

    ``frames`` are stamps and corners by tag; ``timings`` of pan and tilt, whose runs were at the same time or not.
    Pictures of even motion show the head ahead of its reports by its speed times that age. None without such pictures.
    """
    at: list[HeadShot] = []
    speeds: list[Array] = []
    for stamp_s, corners_px in frames:
        course = [_evenly(timing, stamp_s) for timing in timings]
        if corners_px and None not in course:
            reported, speed = np.array(course, float).T
            at.append(HeadShot(reported, np.sign(speed), corners_px, stamp_s))
            speeds.append(speed)
    if not at:
        return None
    views = views_of(at, lens, {name: sizes_m[name] for name in T_world_tag})
    if not len(views.shot):
        return None
    off = off_model_rad(model, T_world_tag, views)
    true_rad_s = np.array(speeds) * [axis.factor for axis in model.axes]
    usable = np.isfinite(off) & (np.abs(true_rad_s) >= _LEAST_RAD_S) & (np.abs(true_rad_s) <= _MOST_RAD_S)
    if usable.sum() < 4:
        return None
    ages, weights = off[usable] / true_rad_s[usable], np.abs(true_rad_s[usable])
    order = np.argsort(ages)
    total = np.cumsum(weights[order])
    middle = float(ages[order][np.searchsorted(total, 0.5 * total[-1])])
    near = np.abs(ages - middle) < 5.0 * np.median(np.abs(ages - middle)) + 1e-4
    age_s = float(np.average(ages[near], weights=weights[near] ** 2))
    spread_s = math.sqrt(float(np.average((ages[near] - age_s) ** 2, weights=weights[near] ** 2)))
    return age_s, spread_s / math.sqrt(near.sum())


def _evenly(timing: AxisTiming | None, stamp_s: float) -> tuple[float, float] | None:
    """Return reported angle and speed where the axis turns evenly then, the play taken up; None elsewhere."""
    if timing is None:
        return None
    for k, run in enumerate(timing.runs):
        ramp_s = abs(timing.speed_rad_s[run.step]) / timing.acceleration_rad_s2
        if run.told_s + timing.start_s + ramp_s + _EVEN_S < stamp_s < run.ended_s - _EVEN_S:
            reported_rad, speed_rad_s = timing.reported_at(k, stamp_s)
            taken_up = abs(reported_rad - timing.at_rest_rad[k]) > _TAKEN_UP_RAD
            return (reported_rad, speed_rad_s) if taken_up else None
    return None


def _course(
    stamps_s: Array, run: Run, speed: float, start_s: float, stop_s: float, acceleration: float
) -> tuple[Array, Array]:
    """Return way and speed (n,) at stamps: the ramp that begins late, less the one that ends it."""
    begun_s = run.told_s + start_s
    ended_s = max(run.ended_s + stop_s, begun_s)
    reached = math.copysign(min(abs(speed), acceleration * (ended_s - begun_s)), speed)
    up = _ramp(stamps_s - begun_s, reached, acceleration)
    down = _ramp(stamps_s - ended_s, reached, acceleration)
    return up[0] - down[0], up[1] - down[1]


def _ramp(since_s: Array, speed: float, acceleration: float) -> tuple[Array, Array]:
    """Return way and speed of what takes up a speed from standstill at 0."""
    ramp_s = abs(speed) / acceleration
    on = np.clip(since_s, 0.0, ramp_s)
    signed = math.copysign(acceleration, speed)
    return 0.5 * signed * on**2 + speed * np.maximum(since_s - ramp_s, 0.0), signed * on


def _rested(run: Run) -> float:
    before = run.reported_rad[run.stamps_s <= run.told_s]
    return float(np.median(before)) if len(before) else float(run.reported_rad[0])


def _first_speed(run: Run, rest_rad: float) -> float:
    lasted_s = max(run.ended_s - run.told_s, 0.05)
    return float(run.reported_rad[-1] - rest_rad) / lasted_s
