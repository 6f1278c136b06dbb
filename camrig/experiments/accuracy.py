"""What costs accuracy, one thing at a time: published positions of a rig of heads against the truth, with NEES.

Frames come to the pipeline as in the daemon, camera by camera, with blur as bodies and heads move while they expose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from camrig import pipeline
from camrig.detect import detect_tags
from camrig.experiments.configurations import planned, running_settings
from camrig.experiments.photographs import detector, painter
from camrig.experiments.rooms import MOUNT, Room, Wrong, draw_room
from camrig.experiments.scenes import Place
from camrig.geometry.arrays import Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z, yaw_of
from camrig.interfaces import Painter
from camrig.messages import AxisReading, Frame, HeadAim, TagDetections, TargetStatus
from camrig.pipeline import Inputs, MissionSettings, Settings

HEADS, BODIES = 3, 5
ANCHORS = 4
SCORED_FROM_S, UNTIL_S = 1.0, 2.6
TICK_S, FRAME_S = 0.05, 0.2
CIRCLE_M = 0.25
"""Bodies that move drive in circles of this radius."""
SWING_RAD = math.radians(3.0)
"""Heads that move swing this far to both sides of their aims."""
READING_RAD = 1e-4


@dataclass(frozen=True, slots=True)
class Case:
    """What one run has: everything but what its name says is as in the base case."""

    name: str
    noise_grey: float = 4.0
    psf_px: float = 0.7
    exposure_s: float = 0.002
    body_m_s: float = 0.0
    head_deg_s: float = 0.0
    pointing_deg: float = 0.05
    anchors: bool = False


_BASE = Case("base: heads 0.05 deg wrong, nothing moves")
CASES: tuple[Case, ...] = (
    _BASE,
    *(replace(_BASE, name=f"noise {grey:g} grey levels", noise_grey=grey) for grey in (1.0, 8.0)),
    *(replace(_BASE, name=f"point spread {px:g} px", psf_px=px) for px in (0.4, 1.2)),
    *(replace(_BASE, name=f"bodies {speed:g} m/s", body_m_s=speed) for speed in (0.1, 0.4, 1.0)),
    replace(_BASE, name="bodies 0.4 m/s, exposure 10 ms", body_m_s=0.4, exposure_s=0.01),
    *(replace(_BASE, name=f"heads turn {rate:g} deg/s", head_deg_s=rate) for rate in (5.0, 15.0)),
    *(replace(_BASE, name=f"heads {off:g} deg wrong", pointing_deg=off) for off in (0.0, 0.2)),
    *(
        replace(_BASE, name=f"heads {off:g} deg wrong, {ANCHORS} anchors", pointing_deg=off, anchors=True)
        for off in (0.0, 0.05, 0.2)
    ),
    replace(
        _BASE,
        name=f"bodies 0.4 m/s, heads 0.2 deg wrong, {ANCHORS} anchors",
        body_m_s=0.4,
        pointing_deg=0.2,
        anchors=True,
    ),
)


@dataclass(frozen=True, slots=True)
class Job:
    """One case in one room."""

    case: Case
    seed: int

    @property
    def key(self) -> str:
        """Its name among kept results."""
        return f"{self.case} {self.seed}"


@dataclass(frozen=True, slots=True)
class Track:
    """One body in one room: how often it was published, of how many ticks; means of error, floor error (m) and NEES."""

    case: str
    seed: int
    body: str
    published: int
    possible: int
    error_m: float | None
    floor_m: float | None
    nees: float | None


def jobs(rooms: int, seed: int, cases: tuple[Case, ...] = CASES) -> Iterator[Job]:
    """Yield every case in every room."""
    for case in cases:
        for k in range(seed, seed + rooms):
            yield Job(case, k)


def work(job: Job) -> list[dict[str, Any]]:
    """Run one case in one room; tracks come as they are kept."""
    return [asdict(track) for track in _tracks(job)]


def _tracks(job: Job) -> list[Track]:
    case = job.case
    room = draw_room(
        Place("ptz", HEADS, BODIES, job.seed), Wrong(math.radians(case.pointing_deg)), anchors=case.anchors
    )
    aims = {
        name: aim for name, aim in planned("camrig-fisher", room, lambda: 0.0).aims.items() if isinstance(aim, HeadAim)
    }
    paints = painter(noise_grey=case.noise_grey, psf_px=case.psf_px, exposure_s=case.exposure_s)
    settings = Settings(running_settings("fisher"), MissionSettings(aim=False))
    state, errors = pipeline.begin(0.0), dict[str, list[tuple[float, float, float]]]()
    possible = 0
    for tick in range(1, round(UNTIL_S / TICK_S)):
        now_s = tick * TICK_S
        readings = [reading for name, aim in aims.items() for reading in _readings(name, _at(aim, case, now_s), now_s)]
        frames = [
            _frame(job, room, name, aims[name], now_s - TICK_S, paints)
            for k, name in enumerate(aims)
            if tick % round(FRAME_S / TICK_S) == k
        ]
        state, outputs = pipeline.step(
            state, Inputs(detections=tuple(frames), axis_readings=tuple(readings)), room.rig, settings, now_s
        )
        if now_s < SCORED_FROM_S:
            continue
        possible += 1
        true = _bodies(room, case, now_s)
        for target in outputs.published.targets:
            if target.status is TargetStatus.TRACKED:
                off_m = target.position_m - true[target.id][:3, 3]
                nees = float(off_m @ np.linalg.solve(target.covariance_m2, off_m))
                scored = float(np.linalg.norm(off_m)), math.hypot(off_m[0], off_m[1]), nees
                errors.setdefault(target.id, []).append(scored)
    return [_track(job, name, errors.get(name, []), possible) for name in room.bodies]


def _track(job: Job, name: str, scored: list[tuple[float, float, float]], possible: int) -> Track:
    if not scored:
        return Track(job.case.name, job.seed, name, 0, possible, None, None, None)
    error_m, floor_m, nees = (float(value) for value in np.mean(scored, axis=0))
    return Track(job.case.name, job.seed, name, len(scored), possible, error_m, floor_m, nees)


def _frame(job: Job, room: Room, name: str, aim: HeadAim, stamp_s: float, paints: Painter) -> TagDetections:
    """Return what a camera finds in a picture whose exposure has its middle at a stamp."""
    number = round(stamp_s / TICK_S)
    off = room.errors[name].angles_rad

    def instant_at(offset_s: float) -> tuple[Transform, dict[str, Transform]]:
        at = _at(aim, job.case, stamp_s + offset_s)
        head = room.rig.heads[name].kinematics
        T_world_camera = head.T_world_camera(at.pan_rad + off[0], at.tilt_rad + off[1], MOUNT)
        return T_world_camera, _bodies(room, job.case, stamp_s + offset_s)

    lens = room.rig.cameras[name].lens
    image = paints.paint(room.rig, lens, instant_at, 1000 * job.seed + number)
    return detect_tags(Frame(name, image, stamp_s, number), detector(), lambda: 0.0, lens=lens)


def _at(aim: HeadAim, case: Case, time_s: float) -> HeadAim:
    """Return where a head looks: at its aim, or swinging about it."""
    swing_rad = SWING_RAD * math.sin(math.radians(case.head_deg_s) / SWING_RAD * time_s)
    return HeadAim(aim.pan_rad + swing_rad, aim.tilt_rad)


def _bodies(room: Room, case: Case, time_s: float) -> dict[str, Transform]:
    """Return where bodies are: where they were drawn, or on circles that begin there."""
    if case.body_m_s == 0.0:
        return dict(room.bodies)
    found = {}
    for name, T in room.bodies.items():
        heading_rad = yaw_of(T[:3, :3])
        turned_rad = case.body_m_s / CIRCLE_M * time_s
        x = CIRCLE_M * (math.sin(heading_rad + turned_rad) - math.sin(heading_rad))
        y = CIRCLE_M * (math.cos(heading_rad) - math.cos(heading_rad + turned_rad))
        found[name] = transform(rotation_z(heading_rad + turned_rad), T[:3, 3] + np.array([x, y, 0.0]))
    return found


def _readings(head: str, at: HeadAim, stamp_s: float) -> list[AxisReading]:
    return [
        AxisReading(head, "pan", at.pan_rad, stamp_s, READING_RAD, 0.0),
        AxisReading(head, "tilt", at.tilt_rad, stamp_s, READING_RAD, 0.0),
    ]
