"""What a head's calibration comes to: what its driver and the rig's file need, how well it points, its verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from camrig.calibrate.head import HeadCalibration
from camrig.calibrate.head_model import PAN, TILT
from camrig.calibrate.head_timing import AxisTiming
from camrig.geometry.arrays import Array
from camrig.geometry.pose import invert
from camrig.messages import AxisFindings, HeadFindings, HeadGrade, Verdict, worst

AXES = ("pan", "tilt")
_AMBER_RAD, _RED_RAD = math.radians(0.1), math.radians(0.3)
"""Pointing errors: 0.1 deg is 1.7 mm a metre."""
_NOISY_PX = 0.5
_SHORT_RAD = math.radians(25.0)
_UNEVEN = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class HeadResult:
    """A head calibrated; ``age_s`` with its sigma is that of HeadFindings, ``settles_s`` how long pictures still moved
    after the head reported that it stood.
    """

    calibration: HeadCalibration
    timings: tuple[AxisTiming | None, AxisTiming | None]
    age_s: tuple[float, float] | None
    grade: HeadGrade
    moving_s: float
    settles_s: tuple[float, ...]
    speed_sigma: float | None = None
    driven_by: HeadFindings | None = None
    """What its driver was given before, where its file could not drive it: ``findings`` are on top of that."""

    @property
    def start_s(self) -> tuple[float, float] | None:
        """Dead time from command to motion and its sigma, the mean of both axes; None without turns."""
        known = [timing for timing in self.timings if timing is not None]
        if not known:
            return None
        return (
            float(np.mean([timing.start_s for timing in known])),
            float(np.hypot.reduce([timing.start_sigma_s for timing in known])) / len(known),
        )

    def findings(self) -> HeadFindings:
        """Return what the driver needs."""
        pan, tilt = (self._axis(k) for k in (PAN, TILT))
        start = self.start_s
        return HeadFindings(
            pan=pan,
            tilt=tilt,
            grade=self.grade,
            report_age_s=None if self.age_s is None else self.age_s[0],
            start_s=None if start is None else start[0],
            speed_sigma=self.speed_sigma,
        )

    def _axis(self, k: int) -> AxisFindings:
        axis, timing = self.calibration.fit.model.axes[k], self.timings[k]
        drive, speeds = self.speeds_rad_s(k)
        return AxisFindings(
            factor=axis.factor,
            offset_rad=axis.pivot_rad + axis.offset_rad - axis.factor * axis.pivot_rad,
            play_rad=max(0.0, axis.play_rad),
            sine_rad=axis.sine_rad,
            cosine_rad=axis.cosine_rad,
            drive=drive,
            speeds_rad_s=speeds,
            acceleration_rad_s2=None if timing is None else abs(axis.factor) * timing.acceleration_rad_s2,
        )

    def speeds_rad_s(self, k: int) -> tuple[Literal[-1, 1], dict[int, float]]:
        """Return which way positive steps truly turn an axis, and its true speed by step, both directions' mean."""
        timing, factor = self.timings[k], self.calibration.fit.model.axes[k].factor
        if timing is None:
            return 1, {}
        signed = {step: factor * speed * math.copysign(1.0, step) for step, speed in timing.speed_rad_s.items()}
        drive: Literal[-1, 1] = 1 if sum(signed.values()) > 0.0 else -1
        by_step: dict[int, list[float]] = {}
        for step, speed in signed.items():
            by_step.setdefault(abs(step), []).append(abs(speed))
        return drive, {step: float(np.mean(both)) for step, both in sorted(by_step.items())}

    @property
    def repeat_rad(self) -> Array:
        """Return one sigma (2,) of where the optics rest when sent to one aim from one side again and again."""
        groups: dict[tuple[float, ...], list[Array]] = {}
        fit = self.calibration.fit
        for shot, off in zip(self.calibration.shots, fit.off_rad, strict=True):
            if shot.aim_rad is not None and np.isfinite(off).all():
                at = fit.model.angles_rad(shot.reported_rad[None], shot.travel[None])[0] + off
                key = tuple(np.round([*shot.aim_rad, *shot.travel], 4).tolist())
                groups.setdefault(key, []).append(at)
        several = [np.array(group) for group in groups.values() if len(group) > 1]
        if not several:
            return np.full(2, np.nan)
        squares = sum(np.square(group - group.mean(axis=0)).sum(axis=0) for group in several)
        return np.asarray(np.sqrt(squares / sum(len(group) - 1 for group in several)))

    @property
    def pointing_rad(self) -> float:
        """One sigma of where the optics will look against where they are sent: model, repeatability, both axes."""
        repeat = self.repeat_rad
        known = float(np.sum(repeat**2)) if np.isfinite(repeat).all() else 0.0
        return math.sqrt(max(self.calibration.pointing_rad**2, known))

    @property
    def working_m(self) -> float:
        """The median distance of the tags."""
        fit = self.calibration.fit
        angles_rad = fit.model.angles_rad(fit.views.reported_rad, fit.views.travel)
        camera = fit.model.T_world_camera(*angles_rad.mean(axis=0))
        return float(np.median([np.linalg.norm((invert(camera) @ T)[:3, 3]) for T in fit.T_world_tag.values()]))

    @property
    def settle_s(self) -> float:
        """How long after the head reports that it stands pictures may still move, of nine in ten stops."""
        late = 0.0 if self.age_s is None else self.age_s[0]
        return max(0.0, float(np.percentile(self.settles_s, 90)) + late) if self.settles_s else 0.0

    def spans_rad(self) -> Array:
        """Return (2,) how far each axis was truly turned."""
        fit = self.calibration.fit
        shown = np.unique(fit.views.shot)
        angles = fit.model.angles_rad(fit.views.reported_rad, fit.views.travel)[shown]
        return np.asarray(np.ptp(angles, axis=0))

    def reasons(self) -> tuple[tuple[Verdict, str], ...]:
        """Return what speaks against it, worst first; nothing where it is good."""
        return tuple(sorted(self._reasons(), key=lambda reason: list(Verdict).index(reason[0]), reverse=True))

    @property
    def verdict(self) -> Verdict:
        """Green, amber or red: the worst reason's."""
        return worst(verdict for verdict, _ in self._reasons())

    def _reasons(self) -> Iterator[tuple[Verdict, str]]:
        if self.grade == "open loop":
            yield Verdict.AMBER, "it tells nothing of its angles: only its time model is found; keep anchors in view"
            yield from _odd_speeds(self.timings)
            return
        error_rad = self.pointing_rad
        about = f"it points within {math.degrees(error_rad):.2f} deg (one sigma)"
        if not error_rad <= _RED_RAD:
            yield Verdict.RED, f"{about}: loose mounting, a slipping gear, or tags that moved; look at the residuals"
        elif error_rad > _AMBER_RAD:
            yield Verdict.AMBER, f"{about}: keep anchors in its camera's view"
        fit = self.calibration.fit
        if fit.noise_px > _NOISY_PX:
            yield (
                Verdict.AMBER,
                f"corners miss by {fit.noise_px:.1f} px: its lens's calibration, or tags that are not flat",
            )
        for name in self.calibration.loose:
            yield Verdict.AMBER, f"tag {name} did not keep its place and was left out"
        if self.calibration.unshown:
            yield (
                Verdict.AMBER,
                f"the motion did not show {', '.join(self.calibration.unshown)}: the file's values stay",
            )
        for name, span in zip(AXES, self.spans_rad(), strict=True):
            if span < _SHORT_RAD:
                yield (
                    Verdict.AMBER,
                    f"{name} was turned over only {math.degrees(span):.0f} deg: more tags, or wider limits",
                )
        if self.grade != "absolute":
            yield Verdict.AMBER, "it takes no positions, and is steered by its speeds"
        yield from _odd_speeds(self.timings)

    def sigma_of(self, name: str) -> float:
        """Return one sigma of an unknown, NaN of one that was not free."""
        return self.calibration.fit.sigma.get(name, math.nan)


def _odd_speeds(timings: Sequence[AxisTiming | None]) -> Iterator[tuple[Verdict, str]]:
    for name, timing in zip(AXES, timings, strict=True):
        if timing is None:
            continue
        steps = sorted({abs(step) for step in timing.speed_rad_s})
        both = [
            (abs(timing.speed_rad_s[step]), abs(timing.speed_rad_s[-step]))
            for step in steps
            if {step, -step} <= timing.speed_rad_s.keys()
        ]
        sigma = max(timing.speed_sigma_rad_s.values())
        if any(abs(a - b) > max(_UNEVEN * (a + b), 5.0 * sigma) for a, b in both):
            yield Verdict.AMBER, f"{name} is not as fast one way as the other: weight on it, or a cable that pulls"
        means = [0.5 * (a + b) for a, b in both]
        if any(fast <= slow for slow, fast in pairwise(means)):
            yield Verdict.AMBER, f"{name}'s speed does not grow with every step; those that do not are left out"
