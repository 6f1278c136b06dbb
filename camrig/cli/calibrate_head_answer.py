"""What ``camrig calibrate head`` answers: one JSON object, or tables for people."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path

import numpy as np
from rich.table import Table

from camrig.calibrate.head_result import AXES, HeadResult
from camrig.cli.console import COLOURS, people, results
from camrig.config.document import KeyPath
from camrig.config.head_changes import pose_keys
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL
from camrig.report.calibration import CalibrationReport
from camrig.report.head_report import head_report


def as_json(
    head: str, camera: str, result: HeadResult, changes: Mapping[KeyPath, object], written: str | None
) -> dict[str, object]:
    """Return every figure with its sigma."""
    fit = result.calibration.fit
    start, age = result.start_s or (None, None), result.age_s or (None, None)
    T_forward = fit.model.T_mount_camera.copy()
    T_forward[:3, :3] = T_forward[:3, :3] @ R_MOUNT_OPTICAL.T
    return {
        "head": head,
        "camera": camera,
        "verdict": result.verdict,
        "reasons": [text for _, text in result.reasons()],
        "grade": result.grade,
        "anchored": result.calibration.anchored,
        "pointing_error_deg": math.degrees(result.pointing_rad),
        "pointing_error_mm": 1e3 * result.pointing_rad * result.working_m,
        "working_m": result.working_m,
        "axes": {name: _axis(result, k) for k, name in enumerate(AXES)},
        "T_world_base": {**pose_keys(fit.model.T_world_base), **_sigmas(result, "base")},
        "T_arm_tilt": {**pose_keys(fit.model.T_arm_tilt), **_sigmas(result, "arm")},
        "T_mount_camera": {**pose_keys(T_forward), **_sigmas(result, "mount")},
        "start_s": start[0],
        "start_sigma_s": start[1],
        "speed_sigma": result.speed_sigma,
        "report_age_s": age[0],
        "report_age_sigma_s": age[1],
        "settle_s": result.settle_s,
        "rms_px": fit.rms_px,
        "noise_px": fit.noise_px,
        "stops": len(result.calibration.shots),
        "tags": {
            name: {"rms_px": rms, "T_world_tag": fit.T_world_tag[name].tolist()}
            for name, rms in fit.tag_rms_px().items()
        },
        "loose_tags": list(result.calibration.loose),
        "not_shown": list(result.calibration.unshown),
        "motion_s": result.moving_s,
        "changes": {".".join(map(str, path)): value for path, value in changes.items()},
        "written": written,
    }


def _axis(result: HeadResult, k: int) -> dict[str, object]:
    """Return one axis: against what the driver reported while it was calibrated."""
    name = AXES[k]
    findings = result.findings()
    axis = findings.pan if k == 0 else findings.tilt
    timing = result.timings[k]
    return {
        "scale": axis.factor,
        "scale_sigma": result.sigma_of(f"{name} factor"),
        "offset_deg": math.degrees(axis.offset_rad),
        "offset_sigma_deg": math.degrees(result.sigma_of(f"{name} offset")),
        "backlash_deg": math.degrees(axis.play_rad),
        "backlash_sigma_deg": math.degrees(result.sigma_of(f"{name} play")),
        "sine_deg": math.degrees(axis.sine_rad),
        "cosine_deg": math.degrees(axis.cosine_rad),
        "repeatability_deg": math.degrees(result.repeat_rad[k]),
        "turned_deg": math.degrees(result.spans_rad()[k]),
        "speeds_deg_s": {str(step): math.degrees(speed) for step, speed in axis.speeds_rad_s.items()},
        "acceleration_deg_s2": None if axis.acceleration_rad_s2 is None else math.degrees(axis.acceleration_rad_s2),
        "start_s": None if timing is None else timing.start_s,
        "stop_s": None if timing is None else timing.stop_s,
    }


def _sigmas(result: HeadResult, pose: str) -> dict[str, float]:
    found = {}
    for name, sigma in result.calibration.fit.sigma.items():
        part, what = name.split()
        if part == pose:
            length = what in ("x", "y", "z")
            found[f"sigma_{what}_{'mm' if length else 'deg'}"] = 1e3 * sigma if length else math.degrees(sigma)
    return found


def print_result(head: str, result: HeadResult, changes: Mapping[KeyPath, object], *, written: bool) -> None:
    """Show people what was found, what is written, and what speaks against it."""
    table = Table("", *AXES, title=f"Head {head}")
    for row in axis_rows(result):
        table.add_row(*row)
    results.print(table)
    for name, text in facts(result):
        results.print(f"{name}: {text}", highlight=False, markup=False, soft_wrap=True)
    colour = COLOURS[result.verdict]
    results.print(f"{result.verdict}", style=colour)
    for _, reason in result.reasons():
        results.print(f"  {reason}", highlight=False, markup=False, soft_wrap=True)
    shown = Table("key", "value", title="written" if written else "would be written (--write)")
    for path, value in changes.items():
        shown.add_row(".".join(map(str, path)), _value(value))
    people.print(shown)


def axis_rows(result: HeadResult) -> Iterator[tuple[str, str, str]]:
    """Yield what was found of both axes, a line each."""
    both = [_axis(result, k) for k in range(2)]

    def numbers(key: str, digits: int, sigma: str | None = None) -> tuple[str, str]:
        cells = []
        for axis in both:
            value, spread = axis[key], axis[sigma] if sigma else math.nan
            if not isinstance(value, float) or not math.isfinite(value):
                cells.append("not found")
            elif isinstance(spread, float) and math.isfinite(spread):
                cells.append(f"{value:.{digits}f} ± {spread:.{digits}f}")
            else:
                cells.append(f"{value:.{digits}f}")
        return cells[0], cells[1]

    yield "turned, deg", *numbers("turned_deg", 0)
    if result.grade != "open loop":
        yield "scale, against the file's", *numbers("scale", 5, "scale_sigma")
        yield "offset, deg", *numbers("offset_deg", 3, "offset_sigma_deg")
        yield "backlash, deg", *numbers("backlash_deg", 3, "backlash_sigma_deg")
        yield "repeatability, deg", *numbers("repeatability_deg", 3)
    if any(axis["sine_deg"] or axis["cosine_deg"] for axis in both):
        yield "bend, sine, deg", *numbers("sine_deg", 3)
        yield "bend, cosine, deg", *numbers("cosine_deg", 3)
    yield "acceleration, deg/s2", *numbers("acceleration_deg_s2", 0)
    for step in sorted({int(step) for axis in both for step in _speeds(axis)}):
        cells = [f"{_speeds(axis)[str(step)]:.2f}" if str(step) in _speeds(axis) else "-" for axis in both]
        yield f"step {step}, deg/s", cells[0], cells[1]


def _speeds(axis: Mapping[str, object]) -> Mapping[str, float]:
    speeds = axis["speeds_deg_s"]
    assert isinstance(speeds, Mapping)
    return speeds


def facts(result: HeadResult) -> Iterator[tuple[str, str]]:
    """Yield what was found of the head as a whole: of what, and that."""
    if result.grade != "open loop":
        yield from _pointing_facts(result)
    if result.start_s is not None:
        yield "dead time", f"{1e3 * result.start_s[0]:.0f} ms from a command to motion"
    if result.speed_sigma is not None:
        yield "speeds", f"each turn within {100.0 * result.speed_sigma:.1f} % of its own (one sigma)"
    fit = result.calibration.fit
    yield "grade", result.grade
    seen = f"{len(result.calibration.shots)} stops, {len(fit.views.shot)} tags in pictures"
    yield "seen", f"{seen}; corners miss by {fit.rms_px:.2f} px (rms); {result.moving_s:.0f} s of motion"


def _pointing_facts(result: HeadResult) -> Iterator[tuple[str, str]]:
    model = result.calibration.fit.model
    off_deg, at_mm = math.degrees(result.pointing_rad), 1e3 * result.pointing_rad * result.working_m
    yield "pointing", f"within {off_deg:.3f} deg (one sigma), {at_mm:.1f} mm at {result.working_m:.1f} m"
    roll_deg = pose_keys(model.T_arm_tilt)["rpy_deg"][0]
    x_mm, y_mm, z_mm = 1e3 * np.array(model.T_mount_camera[:3, 3])
    yield "axes", f"{1e3 * model.T_arm_tilt[0, 3]:.1f} mm apart, {roll_deg:.2f} deg off square"
    yield "camera", f"{x_mm:.1f}, {y_mm:.1f}, {z_mm:.1f} mm from the tilt axis"
    if result.age_s is not None:
        when = "after" if result.age_s[0] < 0.0 else "before"
        yield "reports", f"of {1e3 * abs(result.age_s[0]):.0f} ms {when} pictures of the same stamp"
    yield "settling", f"pictures stand {result.settle_s:.2f} s after it reports that it does"
    if not result.calibration.anchored:
        yield "base", "no anchor was in view: where it stands, and where pan is 0, stay as the file says"


def page(head: str, config: Path, result: HeadResult, changes: Mapping[KeyPath, object]) -> CalibrationReport:
    """Return the report."""
    made = f"{datetime.now().astimezone():%Y-%m-%d %H:%M}, camrig calibrate head {config} {head}"
    keys = {".".join(map(str, path)): _value(value) for path, value in changes.items()}
    return head_report(head, result, dict(facts(result)), [*axis_rows(result)], keys, made)


def _value(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(f"{item:g}" for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
