"""What a head's calibration changes in a rig's file."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from camrig.calibrate.head_result import HeadResult
from camrig.config.document import KeyPath
from camrig.config.rig_file import DeviceConfig, RigConfig
from camrig.geometry.arrays import Transform
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL
from camrig.messages import AxisFindings, HeadFindings, HeadGrade

_LEAST_BIAS_DEG = 0.005


def head_changes(config: RigConfig, head_id: str, camera_id: str, result: HeadResult) -> dict[KeyPath, object]:
    """Return what to write, by key path: kinematics, the head's own error, and what its driver needs.

    Where the base stands only where anchors showed it; what the motion did not show stays as it is in the file anyway.
    """
    device = config.devices["heads"][head_id]
    model = result.calibration.fit.model
    changes: dict[KeyPath, object] = {
        ("heads", head_id, *path): value for path, value in _section_changes(device, result).items()
    }
    if result.grade == "open loop":
        return changes
    if result.calibration.anchored:
        base = pose_keys(model.T_world_base)
        changes |= {("heads", head_id, key): value for key, value in base.items()}
    changes["heads", head_id, "T_arm_tilt"] = pose_keys(model.T_arm_tilt)
    changes["heads", head_id, "bias_deg"] = round(bias_deg(result), 4)
    T_mount_forward = model.T_mount_camera.copy()
    T_mount_forward[:3, :3] = T_mount_forward[:3, :3] @ R_MOUNT_OPTICAL.T
    changes["cameras", camera_id, "mount", "T_mount_camera"] = pose_keys(T_mount_forward)
    return changes


def head_places(config: RigConfig, head_id: str, camera_id: str) -> list[KeyPath]:
    """Return where a calibration may write, before it is known what."""
    device = config.devices["heads"][head_id]
    own: list[tuple[str, ...]] = [("position_m",), ("rpy_deg",), ("T_arm_tilt",), ("bias_deg",)]
    if device.driver.tuning is not None:
        grade: HeadGrade = "absolute" if device.driver.tuning.reads_back(device.section) else "open loop"
        axis = AxisFindings(1.0, 0.0, 0.0, speeds_rad_s={1: 0.1})
        any_findings = HeadFindings(axis, axis, grade, report_age_s=0.0, start_s=0.0, speed_sigma=0.0)
        own += device.driver.tuning.changes(device.section, any_findings)
    return [*(("heads", head_id, *path) for path in own), ("cameras", camera_id, "mount", "T_mount_camera")]


def _section_changes(device: DeviceConfig, result: HeadResult) -> Mapping[tuple[str, ...], object]:
    """Return what its driver needs: what it was given to drive the head at all, and what was found with that."""
    tuning = device.driver.tuning
    if tuning is None:
        return {}
    given = {} if result.driven_by is None else tuning.changes(device.section, result.driven_by)
    driven = device.amended(given)
    return {**given, **tuning.changes(driven.section, result.findings())}


def bias_deg(result: HeadResult) -> float:
    """Return one sigma per axis of what read-back does not see."""
    return min(5.0, max(_LEAST_BIAS_DEG, math.degrees(result.pointing_rad) / math.sqrt(2.0)))


def pose_keys(T: Transform) -> dict[str, list[float]]:
    """Return a pose as a file has it: to 0.01 mm and 0.0001 deg."""
    rpy_deg = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    return {"position_m": _rounded(T[:3, 3], 5), "rpy_deg": _rounded(rpy_deg, 4)}


def _rounded(values: np.typing.ArrayLike, digits: int) -> list[float]:
    return [float(value) + 0.0 for value in np.round(np.asarray(values, float), digits)]
