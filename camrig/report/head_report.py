"""A head's calibration as a page: residuals, the stops, the play as a loop, speeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from camrig.calibrate.head_result import AXES, HeadResult
from camrig.geometry.arrays import Array
from camrig.report.calibration import CalibrationReport, Drawing, Table

_RISING, _FALLING = "#1f6fb4", "#d98a00"


def head_report(
    head: str,
    result: HeadResult,
    facts: Mapping[str, str],
    axes: Sequence[Sequence[str]],
    changes: Mapping[str, str],
    made: str,
) -> CalibrationReport:
    """Return the page; ``facts``, ``axes`` (a row each: what, pan, tilt) and ``changes`` are said in words."""
    reasons = [text for _, text in result.reasons()] or ["nothing speaks against it"]
    tags = result.calibration.fit.tag_rms_px()
    sections: list[Table | Drawing] = [
        Table(
            "Axes", ("", *AXES), axes, "Scale and offset are against what the driver reported by the file as it was."
        ),
        Drawing(
            "Stops",
            lambda figure: _stops(figure, result),
            (7.0, 3.6),
            "Where the optics looked; the colour is how many tags were seen.",
        ),
    ]
    if result.grade != "open loop":
        sections += [
            Drawing("Play", lambda figure: _play(figure, result), (8.0, 3.4), _PLAY),
            Drawing("What is left of each stop", lambda figure: _left(figure, result), (8.0, 3.6), _LEFT),
        ]
    if any(timing is not None for timing in result.timings):
        sections.append(Drawing("Speeds", lambda figure: _speeds(figure, result), (7.0, 3.4), _SPEEDS))
        sections.append(Drawing("Turns", lambda figure: _turns(figure, result), (8.0, 3.6), _TURNS))
    sections.append(Table("Tags", ("tag", "rms px"), [(name, f"{rms:.3f}") for name, rms in tags.items()]))
    sections.append(Table("What the file gets", ("key", "value"), list(changes.items())))
    return CalibrationReport(f"Head {head}", result.verdict, reasons, facts, sections, made)


_PLAY = (
    "How far the optics are from where the motor says, without the play's share: coming from below and from above. "
    "Their distance is the play."
)
_LEFT = "By how much each stop's pan and tilt are off the fitted head."
_SPEEDS = "True speed by step, both directions."
_TURNS = "Reports of the turns at three steps, and the course fitted to them."


def _angles_deg(result: HeadResult) -> Array:
    views, model = result.calibration.fit.views, result.calibration.fit.model
    return np.degrees(model.angles_rad(views.reported_rad, views.travel))


def _play(figure: Any, result: HeadResult) -> None:
    fit, angles_deg = result.calibration.fit, _angles_deg(result)
    for k, (name, axes) in enumerate(zip(AXES, figure.subplots(1, 2), strict=True)):
        axis = fit.model.axes[k]
        towards = fit.views.travel[:, k] * math.copysign(1.0, axis.factor)
        behind_deg = np.degrees(fit.off_rad[:, k]) - 0.5 * math.degrees(axis.play_rad) * towards
        for side, colour, label in ((1.0, _RISING, "from below"), (-1.0, _FALLING, "from above")):
            own = towards == side
            axes.plot(angles_deg[own, k], behind_deg[own], ".", color=colour, label=label)
            axes.axhline(-0.5 * side * math.degrees(axis.play_rad), color=colour, linewidth=0.8)
        axes.set(
            title=f"{name}: {math.degrees(axis.play_rad):.3f} deg", xlabel=f"{name}, deg", ylabel="optics - motor, deg"
        )
        axes.legend(frameon=False)


def _left(figure: Any, result: HeadResult) -> None:
    off_deg, angles_deg = np.degrees(result.calibration.fit.off_rad), _angles_deg(result)
    for k, (name, axes) in enumerate(zip(AXES, figure.subplots(1, 2), strict=True)):
        axes.plot(angles_deg[:, k], 1e3 * off_deg[:, k], ".", color=_RISING)
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set(title=name, xlabel=f"{name}, deg", ylabel="off, 0.001 deg")


def _stops(figure: Any, result: HeadResult) -> None:
    angles_deg = _angles_deg(result)
    seen = [len(shot.corners_px) for shot in result.calibration.shots]
    axes = figure.subplots()
    dots = axes.scatter(angles_deg[:, 0], angles_deg[:, 1], c=seen, cmap="viridis", s=28)
    axes.set(xlabel="pan, deg", ylabel="tilt, deg")
    figure.colorbar(dots, ax=axes, label="tags")


def _speeds(figure: Any, result: HeadResult) -> None:
    axes = figure.subplots()
    for k, (name, colour) in enumerate(zip(AXES, (_RISING, _FALLING), strict=True)):
        timing, factor = result.timings[k], abs(result.calibration.fit.model.axes[k].factor)
        if timing is not None:
            for sign, mark in ((1, "o"), (-1, "x")):
                points = [
                    (abs(step), factor * math.degrees(abs(v)))
                    for step, v in timing.speed_rad_s.items()
                    if step * sign > 0
                ]
                axes.plot(*np.array(points).T, mark, color=colour, label=f"{name}, {'+' if sign > 0 else '-'}")
    axes.set(xlabel="step", ylabel="deg/s")
    axes.legend(frameon=False)


def _turns(figure: Any, result: HeadResult) -> None:
    for k, (name, axes) in enumerate(zip(AXES, figure.subplots(1, 2), strict=True)):
        timing = result.timings[k]
        if timing is None:
            continue
        order = sorted(range(len(timing.runs)), key=lambda n: timing.runs[n].step)
        for n in (order[-1], order[-len(order) // 4], order[len(order) // 2]):
            run = timing.runs[n]
            since = run.stamps_s - run.told_s
            (line,) = axes.plot(
                since, np.degrees(run.reported_rad - timing.at_rest_rad[n]), ".", label=f"step {run.step}"
            )
            smooth = np.linspace(since[0], since[-1], 200)
            course = [timing.reported_at(n, run.told_s + each)[0] - timing.at_rest_rad[n] for each in smooth]
            axes.plot(smooth, np.degrees(course), color=line.get_color(), linewidth=0.9)
        axes.set(title=name, xlabel="s after the command", ylabel="reported, deg")
        axes.legend(frameon=False)
