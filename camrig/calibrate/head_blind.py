"""The time model of a head that tells nothing: its angles are measured in its own camera's pictures. Pure.

First roughly, by how the rays of tags turned since the first picture; then with the tags' places, in one least squares.
The kinematics stay the file's: a camera that is 1 cm from where the file has it makes speeds wrong by 0.3 % with tags
3 m away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.calibrate.head import HeadCalibration
from camrig.calibrate.head_fit import fit, off_model_rad
from camrig.calibrate.head_model import AxisModel, HeadModel, HeadShot, views_of
from camrig.calibrate.head_start import begin, camera_turn
from camrig.calibrate.head_timing import AxisTiming, Run, axis_timing
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pan_tilt import aim_rotation
from camrig.geometry.rotation import rotation_log

_FRAME_SIGMA_S = 0.002
_BEFORE_S, _AFTER_S = 0.6, 1.5
_REST_S = 0.5
_LONG_RAD, _LEAST_TURNS = math.radians(5.0), 8
"""Of shorter turns the play takes too large a share to tell of speed."""
_EACH_SHOT = 3
"""Every third picture is enough to place the tags."""
Corners = Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class BlindView:
    """What pictures are measured against: the first one, and how its head then stood (tilt; pan is 0 by definition)."""

    lens: Lens
    T_mount_camera: Transform
    first: Corners
    tilt_rad: float

    def angles_rad(self, corners_px: Corners) -> Array | None:
        """Return pan and tilt (2,) of a picture; None where it shares no tag with the first one."""
        R_first_now = camera_turn(self.lens, self.first, corners_px)
        if R_first_now is None:
            return None
        R_mount_camera = self.T_mount_camera[:3, :3]
        R = aim_rotation(0.0, self.tilt_rad) @ R_mount_camera @ R_first_now @ R_mount_camera.T
        return np.array([math.atan2(-R[0, 1], R[1, 1]), math.atan2(R[2, 0], R[2, 2])])

    def turn_rad(self, corners_px: Corners) -> Array | None:
        """Return the camera's rotation vector since the first picture (3,), in its frame."""
        R_first_now = camera_turn(self.lens, self.first, corners_px)
        return None if R_first_now is None else rotation_log(R_first_now)


@dataclass(frozen=True, slots=True)
class BlindRun:
    """One turn of both axes at signed ``steps`` (pan, tilt), told and ended."""

    steps: tuple[int, int]
    told_s: float
    ended_s: float


def measured(
    view: BlindView, file: HeadModel, sizes_m: Mapping[str, float], frames: Sequence[tuple[float, Corners]]
) -> tuple[HeadCalibration, Array, Array]:
    """Return the tags' places as a calibration, and the stamps (n,) and angles (n, 2) of the pictures that show any."""
    seen = [(stamp_s, corners, view.angles_rad(corners)) for stamp_s, corners in frames]
    shots = [HeadShot(angles, np.zeros(2), corners, stamp_s) for stamp_s, corners, angles in seen if angles is not None]
    model = HeadModel(file.T_world_base, file.T_arm_tilt, file.T_mount_camera, (AxisModel(), AxisModel()))
    few = shots[::_EACH_SHOT]
    views = views_of(few, view.lens, sizes_m)
    model, tags = begin(model, views, {})
    found = fit(views, model, tags, ())
    every = views_of(shots, view.lens, {name: sizes_m[name] for name in tags})
    off = off_model_rad(found.model, found.T_world_tag, every)
    known = np.isfinite(off).all(axis=1)
    angles_rad = (every.reported_rad + off)[known]
    stamps_s = np.array([shot.stamp_s for shot in shots])[known]
    calibration = HeadCalibration(found, False, (), (), np.full((len(few), 2), np.nan), tuple(few))
    return calibration, stamps_s, angles_rad


def timings(runs: Sequence[BlindRun], stamps_s: Array, angles_rad: Array) -> tuple[AxisTiming | None, ...]:
    """Return the time models of pan and tilt, from the angles that pictures show round each turn."""
    both = []
    for axis in range(2):
        own = []
        for before, run, after in zip([None, *runs], runs, [*runs[1:], None], strict=False):
            from_s = max(run.told_s - _BEFORE_S, -math.inf if before is None else before.ended_s + _REST_S)
            until_s = min(run.ended_s + _AFTER_S, math.inf if after is None else after.told_s)
            near = (stamps_s > from_s) & (stamps_s < until_s)
            if run.steps[axis] and (stamps_s[near] <= run.told_s).any() and (stamps_s[near] > run.ended_s).any():
                sigma_s = np.full(int(near.sum()), _FRAME_SIGMA_S)
                angles = angles_rad[near, axis]
                own.append(Run(axis, run.steps[axis], run.told_s, run.ended_s, stamps_s[near], sigma_s, angles))
        both.append(axis_timing(own))
    return tuple(both)


def speed_sigma(found: Sequence[AxisTiming | None]) -> float | None:
    """Return one sigma of a turn's speed against the table's, relative; None where too few turns tell."""
    ratios = []
    for timing in found:
        if timing is None:
            continue
        for k, run in enumerate(timing.runs):
            lasted_s = run.ended_s + timing.stop_s - run.told_s - timing.start_s
            expected = timing.speed_rad_s[run.step] * lasted_s
            rested_rad = run.reported_rad[run.stamps_s > run.ended_s + _REST_S]
            if abs(expected) > _LONG_RAD and len(rested_rad):
                came = float(np.median(rested_rad) - timing.at_rest_rad[k])
                ratios.append(came / expected - 1.0)
    if len(ratios) < _LEAST_TURNS:
        return None
    return float(np.median(np.abs(ratios)) / 0.6745)
