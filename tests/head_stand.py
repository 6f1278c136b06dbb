"""A head far from what its file says, on an emulated wire in simulated time, and what its camera sees of eight tags.

What truly is comes from the emulator and from OpenCV's projection, not from camrig.geometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from camrig.calibrate.head_model import AxisModel, HeadModel
from camrig.clock import Clock
from camrig.geometry.arrays import Transform
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL
from camrig.messages import TagDetection, TagDetections
from camrig.rig import TagKey
from camrig.runtime.head_survey import Place
from camrig_emulators.head_line import HeadLine
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads
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


OPTICAL = np.eye(4)
OPTICAL[:3, :3] = R_MOUNT_OPTICAL


def camera_in_mount(xyz: tuple[float, float, float], rpy_deg: tuple[float, float, float]) -> Transform:
    """Return T_mount_camera of a camera that looks along the mount's x but for that."""
    return np.asarray(_pose(xyz, rpy_deg) @ OPTICAL)


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


def study_place(*, anchored: bool) -> Place:
    """Return what the file knows of the head and its tags."""
    sizes = {str(key): SIZE_M for key in T_WORLD_TAG}
    return Place(
        lens=LENS,
        sizes_m=sizes,
        file=HeadModel(BASE, np.eye(4), OPTICAL, (AxisModel(), AxisModel())),
        limits_rad=tuple(tuple(map(math.radians, limits)) for limits in (PAN_LIMITS_DEG, TILT_LIMITS_DEG)),  # type: ignore[arg-type]
        speed_rad_s=math.radians(SPEED_DEG_S),
        anchors={str(key): T for key, T in T_WORLD_TAG.items()} if anchored else {},
    )
