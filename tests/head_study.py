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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from camrig.calibrate.head_model import AxisModel, HeadModel
from camrig.calibrate.head_result import HeadResult
from camrig.clock import Clock
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL
from camrig.messages import HeadFindings, TagDetection, TagDetections
from camrig.report.calibration import Drawing
from camrig.report.head_report import head_report
from camrig.rig import TagKey
from camrig.runtime.head_bench import HeadBench
from camrig.runtime.head_calibration import run_calibration
from camrig.runtime.head_survey import Place
from camrig_drivers.pelco_d.head import PelcoDHead
from camrig_drivers.pelco_d.section import PelcoDSection
from camrig_drivers.pelco_d.tuning import changes, plain
from camrig_emulators.head_line import HeadLine
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads, spec
from tests.simulated_room import LENS, tag_in_picture

SIZE_M = 0.2
TRUE_AXES: dict[str, dict[str, float]] = {
    "pan": {"sign": -1, "scale": 1.36, "offset_deg": 7.0},
    "tilt": {"sign": 1, "scale": 1.36, "offset_deg": -4.0},
}
"""Tilt counts upside down against the driver's default, and both scales are far off."""
PLAY_DEG, START_S, PICTURES_LATE_S = 0.3, 0.12, 0.12
ARM_M, ARM_ROLL_DEG = 0.02, 0.4
CAMERA_M, CAMERA_RPY_DEG = (0.03, 0.02, 0.05), (0.8, 0.0, -1.2)
PAN_LIMITS_DEG, TILT_LIMITS_DEG = (-120.0, 120.0), (-85.0, 5.0)
FRAME_S, CORNER_PX = 0.1, 0.08
TAGS = {
    TagKey("tag36h11", k): (at, yaw)
    for k, (at, yaw) in enumerate(
        [
            ((2.0, 1.0, 0.0), 10.0),
            ((3.0, 2.0, 0.0), 40.0),
            ((2.0, 3.0, 0.1), 80.0),
            ((1.0, 2.5, 0.0), 0.0),
            ((0.0, 2.0, 0.3), 20.0),
            ((3.5, 0.5, 0.2), 60.0),
            ((-0.5, 0.8, 0.0), 15.0),
            ((1.2, -0.5, 0.0), 70.0),
        ]
    )
}


def _pose(xyz: tuple[float, float, float], rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Transform:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()
    T[:3, 3] = xyz
    return T


_OPTICAL = np.eye(4)
_OPTICAL[:3, :3] = R_MOUNT_OPTICAL


def camera_in_mount(xyz: tuple[float, float, float], rpy_deg: tuple[float, float, float]) -> Transform:
    """Return T_mount_camera of a camera that looks along the mount's x but for that."""
    return np.asarray(_pose(xyz, rpy_deg) @ _OPTICAL)


BASE = _pose((1.0, 1.0, 2.8))
T_WORLD_TAG = {key: _pose(at, (0.0, 0.0, yaw)) for key, (at, yaw) in TAGS.items()}


def true_camera(pan_rad: float, tilt_rad: float) -> Transform:
    """Return where the camera truly is, written down without camrig.geometry."""
    R_pan = Rotation.from_rotvec([0.0, 0.0, pan_rad]).as_matrix()
    R_tilt = Rotation.from_rotvec([0.0, -tilt_rad, 0.0]).as_matrix()
    turn_pan, turn_tilt = np.eye(4), np.eye(4)
    turn_pan[:3, :3], turn_tilt[:3, :3] = R_pan, R_tilt
    arm = _pose((ARM_M, 0.0, 0.0), (ARM_ROLL_DEG, 0.0, 0.0))
    return np.asarray(BASE @ turn_pan @ arm @ turn_tilt @ camera_in_mount(CAMERA_M, CAMERA_RPY_DEG))


@dataclass
class StudyEye:
    """The camera on the emulated head: frames on a grid of times, stamped late."""

    clock: Clock
    line: HeadLine[Any]
    rng: np.random.Generator
    tags: Mapping[TagKey, Transform] = field(default_factory=lambda: T_WORLD_TAG)
    angles_deg: list[tuple[float, float]] = field(default_factory=list)
    """Where the head truly was at each frame."""
    _next_s: float = 0.0

    def take(self) -> tuple[TagDetections, ...]:
        now_s = self.clock.now_s()
        self._next_s = max(self._next_s, now_s - 5.0)
        found = []
        while self._next_s <= now_s:
            found.append(self._frame(self._next_s))
            self._next_s += FRAME_S
        return tuple(found)

    def _frame(self, stamp_s: float) -> TagDetections:
        angles_rad = self.line.true_angles_rad("pt1", stamp_s)
        self.angles_deg.append((math.degrees(angles_rad[0]), math.degrees(angles_rad[1])))
        T = true_camera(*angles_rad)
        tags = []
        for key, T_world_tag in self.tags.items():
            corners = tag_in_picture(LENS, T, T_world_tag, SIZE_M)
            if corners is not None:
                corners = corners + self.rng.normal(0.0, CORNER_PX, (4, 2))
                tags.append(TagDetection(key, corners, (0.0, 0.0), 0, 60.0))
        number = round(stamp_s / FRAME_S)
        return TagDetections("eye", stamp_s + PICTURES_LATE_S, number, LENS.size_px, tuple(tags), 0.0)


def emulated(seed: int, keys: Mapping[str, Any], **settings: Any) -> SimulatedHeads:
    """Return the emulated head and the driver with some keys of its section."""
    usual = {
        "axes": TRUE_AXES,
        "backlash_deg": PLAY_DEG,
        "start_latency_s": START_S,
        "start_pan_deg": 20.0,
        "start_tilt_deg": -50.0,
        "stop_error_deg": 0.02,
        "speed_drift": 0.005,
        "pan_limits_deg": (-175.0, 175.0),
        "tilt_limits_deg": (-90.0, 20.0),
    }
    return SimulatedHeads(1, 9600, {"gap_s": 0.02, **keys}, seed, **{**usual, **settings})


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


def study_place(*, anchored: bool) -> Place:
    """Return what the file knows of the head and its tags."""
    sizes = {str(key): SIZE_M for key in T_WORLD_TAG}
    return Place(
        lens=LENS,
        sizes_m=sizes,
        file=HeadModel(BASE, np.eye(4), _OPTICAL, (AxisModel(), AxisModel())),
        limits_rad=tuple(tuple(map(math.radians, limits)) for limits in (PAN_LIMITS_DEG, TILT_LIMITS_DEG)),  # type: ignore[arg-type]
        speed_rad_s=math.radians(SPEED_DEG_S),
        anchors={str(key): T for key, T in T_WORLD_TAG.items()} if anchored else {},
    )


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
    roll, _, yaw = Rotation.from_matrix((model.T_mount_camera @ _OPTICAL.T)[:3, :3]).as_euler("xyz", degrees=True)
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
