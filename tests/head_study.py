"""A head's calibration in simulated time: the real driver on an emulated head's wire, and what its camera would see.

The head is far from what its file says. ``python -m tests.head_study --seeds 3 --aims 200`` prints how well each number
was found, and how well the driver points afterwards by what was written. What truly is comes from the emulator and from
OpenCV's projection.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from camrig.calibrate.head_result import HeadResult
from camrig.geometry.arrays import Array, Transform
from camrig.messages import HeadFindings
from camrig.report.calibration import Drawing
from camrig.report.head_report import head_report
from camrig.rig import TagKey
from camrig.runtime.head_bench import HeadBench
from camrig.runtime.head_calibration import run_calibration
from camrig_drivers.pelco_d.head import PelcoDHead
from camrig_drivers.pelco_d.section import PelcoDSection
from camrig_drivers.pelco_d.tuning import changes, plain
from tests.head_stand import (
    ARM_M,
    ARM_ROLL_DEG,
    CAMERA_M,
    CAMERA_RPY_DEG,
    OPTICAL,
    PAN_LIMITS_DEG,
    PICTURES_LATE_S,
    PLAY_DEG,
    START_S,
    T_WORLD_TAG,
    TILT_LIMITS_DEG,
    TRUE_AXES,
    StudyEye,
    emulated,
    study_place,
    true_camera,
)
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads, spec


def study(
    seed: int,
    *,
    anchored: bool,
    tags: Mapping[TagKey, Transform] = T_WORLD_TAG,
    emulated_heads: SimulatedHeads | None = None,
    asked_to_end: Callable[[], bool] = lambda: False,
    **settings: Any,
) -> tuple[HeadResult, SimulatedHeads, StudyEye]:
    """Calibrate the emulated head from a file that knows next to nothing of it."""
    section = PelcoDSection.model_validate({"port": "/sim", "gap_s": 0.02})
    rig = emulated_heads or emulated(seed, {}, **settings)
    rig.heads = [_plain(section, rig)]
    eye = StudyEye(rig.time, rig.line, np.random.default_rng(seed), tags)
    place = study_place(anchored=anchored)
    bench = HeadBench("pt1", rig.head, eye, rig.time, place.sizes_m, asked_to_end)

    def servo(found: HeadFindings) -> PelcoDHead:
        return _plain(section_with(section, changes(section, found)), rig)

    return run_calibration(bench, place, lambda _, __: None, servo), rig, eye


def _plain(section: PelcoDSection, rig: SimulatedHeads) -> PelcoDHead:
    widened = replace(spec("pt1"), pan_limits_rad=(-math.pi, math.pi), tilt_limits_rad=(-math.pi, math.pi))
    return PelcoDHead(widened, plain(section), rig.bus, rig.time)


@dataclass(frozen=True)
class Found:
    """One number: what is true and what was found, in its unit, and how far off it may be."""

    name: str
    true: float
    found: float
    bar: float
    unit: str

    @property
    def off(self) -> float:
        return abs(self.found - self.true)


def numbers(result: HeadResult) -> tuple[Found, ...]:
    """Compare everything that the study knows the truth of; zeros of pan only where anchors showed them."""
    model, found = result.calibration.fit.model, result.findings()
    rows = []
    for name, axis, speeds in (("pan", found.pan, found.pan), ("tilt", found.tilt, found.tilt)):
        true = TRUE_AXES[name]
        # The driver counted -raw + 0: sign and scale of the file's default.
        span_deg = 60.0 if name == "pan" else 30.0
        factor = -float(true["sign"]) * float(true["scale"])
        rows.append(
            Found(f"{name} scale over {span_deg:g} deg", span_deg, span_deg * axis.factor / factor, 0.05, "deg")
        )
        if name == "tilt" or result.calibration.anchored:
            offset_deg = math.degrees(axis.offset_rad)
            rows.append(Found(f"{name} offset", float(true["offset_deg"]), offset_deg, 0.05, "deg"))
        rows.append(Found(f"{name} backlash", PLAY_DEG, math.degrees(axis.play_rad), 0.05, "deg"))
        for step, speed in speeds.speeds_rad_s.items():
            rows.append(
                Found(
                    f"{name} speed {step}",
                    SPEED_DEG_S * step / 63.0,
                    math.degrees(speed),
                    0.05 * SPEED_DEG_S * step / 63.0,
                    "deg/s",
                )
            )
        acceleration = math.degrees(axis.acceleration_rad_s2 or 0.0)
        rows.append(Found(f"{name} acceleration", 160.0, acceleration, 8.0, "deg/s2"))
    roll, _, yaw = Rotation.from_matrix((model.T_mount_camera @ OPTICAL.T)[:3, :3]).as_euler("xyz", degrees=True)
    arm_roll, _, _ = Rotation.from_matrix(model.T_arm_tilt[:3, :3]).as_euler("xyz", degrees=True)
    rows += [
        Found("camera roll", CAMERA_RPY_DEG[0], roll, 0.05, "deg"),
        Found("camera yaw", CAMERA_RPY_DEG[2], yaw, 0.05, "deg"),
        Found("axes not square by", ARM_ROLL_DEG, arm_roll, 0.05, "deg"),
        Found("axes apart", 1e3 * ARM_M, 1e3 * float(model.T_arm_tilt[0, 3]), 2.0, "mm"),
    ]
    for k, axis_name in enumerate("xyz"):
        rows.append(Found(f"camera {axis_name}", 1e3 * CAMERA_M[k], 1e3 * float(model.T_mount_camera[k, 3]), 2.0, "mm"))
    assert found.start_s is not None
    assert found.report_age_s is not None
    rows.append(Found("dead time", 1e3 * START_S, 1e3 * found.start_s, 10.0, "ms"))
    rows.append(Found("pictures late", 1e3 * PICTURES_LATE_S, -1e3 * found.report_age_s, 10.0, "ms"))
    return tuple(rows)


def section_with(section: PelcoDSection, changed: Mapping[tuple[str, ...], object]) -> PelcoDSection:
    """Return a section with keys changed, as the file would have it."""
    keys: dict[str, Any] = section.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    for path, value in changed.items():
        at = keys
        for key in path[:-1]:
            at = at.setdefault(key, {})
        at[path[-1]] = value
    return PelcoDSection.model_validate(keys)


def pointing_errors_deg(result: HeadResult, rig: SimulatedHeads, count: int, seed: int) -> Array:
    """Send the head, driven by what was written, to random aims; return how far off (n,) its camera then looks."""
    section = PelcoDSection.model_validate({"port": "/sim", "gap_s": 0.02})
    section = section_with(section, changes(section, result.findings()))
    limits = [(math.radians(low), math.radians(high)) for low, high in (PAN_LIMITS_DEG, TILT_LIMITS_DEG)]
    rig.heads = [
        PelcoDHead(
            replace(spec("pt1"), pan_limits_rad=limits[0], tilt_limits_rad=limits[1]), section, rig.bus, rig.time
        )
    ]
    rig.head.open()
    rig.head.enable()
    rig.poll(1.0)
    rng, errors = np.random.default_rng(seed), []
    for _ in range(count):
        aim = [rng.uniform(low + 0.02, high - 0.02) for low, high in limits]
        rig.head.move_to(*aim)
        until_s = rig.time.now_s() + 20.0
        still_s = rig.time.now_s() + 1.0
        while rig.time.now_s() < min(until_s, still_s + 1.0):
            before = rig.truth_deg()
            rig.head.read(0.3)
            if np.abs(np.subtract(rig.truth_deg(), before)).max() > 1e-6:
                still_s = rig.time.now_s()
        said = result.calibration.fit.model.T_world_camera(*aim)[:3, 2]
        true = true_camera(*rig.line.true_angles_rad("pt1", rig.time.now_s()))[:3, 2]
        errors.append(math.degrees(math.acos(min(1.0, float(said @ true)))))
    rig.head.stop()
    rig.head.close()
    return np.array(errors)


def draw(folder: Path) -> None:
    """Draw what a report draws."""
    from camrig.report.canvas import figure_of, save, style

    result, _, _ = study(1, anchored=True)
    report = head_report("pt1", result, {}, [], {}, "")
    for section in report.sections:
        if isinstance(section, Drawing) and section.title in ("Play", "Turns"):
            with style():
                figure = figure_of(*section.size_in)
                section.draw(figure)
                save(figure, folder / f"calibrate-head-{section.title.lower()}.svg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--aims", type=int, default=200)
    parser.add_argument("--free-tags", action="store_true", help="no anchors: the places of all tags are unknown")
    parser.add_argument("--figures", type=Path, help="draw the figures of docs/calibrate-head.md into this folder")
    given = parser.parse_args()
    if given.figures is not None:
        draw(given.figures)
        return
    for seed in range(1, given.seeds + 1):
        begun_s = time.perf_counter()
        result, rig, _ = study(seed, anchored=not given.free_tags)
        rows = numbers(result)
        worst = max(rows, key=lambda row: row.off / row.bar)
        for row in rows:
            mark = "" if row.off <= row.bar else "  MISSED"
            sys.stdout.write(
                f"  {row.name:24} {row.true:9.3f} {row.found:9.3f} off {row.off:.4f} of {row.bar:g} {row.unit}{mark}\n"
            )
        line = f"seed {seed}: {result.verdict}, {result.moving_s:.0f} s of motion, {len(rows)} numbers, "
        line += f"worst {worst.name} at {worst.off / worst.bar:.0%} of its bar"
        if not given.free_tags:
            errors = pointing_errors_deg(result, rig, given.aims, seed)
            line += f"; {given.aims} aims: rms {np.sqrt(np.mean(errors**2)):.4f}, worst {errors.max():.4f} deg"
        sys.stdout.write(f"{line}; {time.perf_counter() - begun_s:.0f} s\n")


if __name__ == "__main__":
    main()
