"""Scene -> Problem: everything that the kernels work on, as arrays. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import SIZE, lens_row
from camrig.geometry.tags import tag_corners
from camrig.optimise.check import check
from camrig.optimise.kernels.problem import (
    ARM_R,
    ARM_T,
    BASE_R,
    CAMERA_R,
    CAMERA_SIZE,
    CAMERA_T,
    CONE,
    CORNERS,
    FISHER,
    HIGH,
    LEAST_FACING,
    LENS_COUNT,
    LENS_FIRST,
    LOW,
    MARGIN,
    MIN_TAG_PX,
    NEEDS_ANCHOR,
    NORMAL,
    PERSPECTIVE,
    PIXEL,
    POINT,
    PRIOR,
    QUALITY,
    RANGE,
    REACH,
    ROOM,
    SEPARATION,
    SETTINGS_SIZE,
    TAGGED,
    TARGET_SIZE,
    VARIABLES,
    WEIGHT,
    ZOOM,
    Problem,
)
from camrig.optimise.places import bounds, frames
from camrig.optimise.scene import DronePlace, PlannerSettings, Scene, SceneCamera, SceneTarget

_MODELS = {"pixel": PIXEL, "fisher": FISHER, "perspective": PERSPECTIVE}


def problem_of(scene: Scene) -> Problem:
    """Prepare a scene. Raises InputError for one that cannot be planned (optimise.check)."""
    check(scene)
    lenses = [_lens_rows(camera, scene.settings) for camera in scene.cameras]
    firsts = np.concatenate([[0], np.cumsum([len(rows) for rows in lenses])])
    cameras = [
        _camera_row(camera, scene.settings.min_separation_m, int(first), len(rows))
        for camera, first, rows in zip(scene.cameras, firsts, lenses, strict=False)
    ]
    return Problem(
        cameras=_stack(cameras, (len(cameras), CAMERA_SIZE)),
        lenses=np.concatenate([np.zeros((0, SIZE)), *lenses]),
        targets=_tag_rows(scene.targets),
        anchors=_tag_rows([SceneTarget("", a.position_m, a.tag_size_m, a.normal, a.facing_rad) for a in scene.anchors]),
        boxes=_stack(scene.keep_out_m, (len(scene.keep_out_m), 2, 3)),
        settings=_settings_row(scene.settings),
    )


def _stack(values: Sequence[object], shape: tuple[int, ...]) -> Array:
    return np.ascontiguousarray(np.array(values, dtype=float).reshape(shape))


def _settings_row(settings: PlannerSettings) -> Array:
    row = np.zeros(SETTINGS_SIZE)
    row[MARGIN], row[MIN_TAG_PX], row[RANGE] = settings.margin_rad, settings.min_tag_px, settings.max_range_m
    row[LEAST_FACING] = math.cos(settings.max_incidence_rad)
    row[CONE], row[QUALITY] = settings.visibility == "cone", _MODELS[settings.quality]
    return row


def _camera_row(camera: SceneCamera, least_separation_m: float, lens_first: int, lens_count: int) -> Array:
    row = np.zeros(CAMERA_SIZE)
    fixed, (low, high) = frames(camera.place), bounds(camera.place)
    row[BASE_R : BASE_R + 9] = fixed.base_R.ravel()
    row[ARM_R : ARM_R + 9], row[ARM_T : ARM_T + 3] = fixed.arm[:3, :3].ravel(), fixed.arm[:3, 3]
    row[CAMERA_R : CAMERA_R + 9], row[CAMERA_T : CAMERA_T + 3] = fixed.camera[:3, :3].ravel(), fixed.camera[:3, 3]
    row[LOW : LOW + VARIABLES], row[HIGH : HIGH + VARIABLES] = low, high
    row[HIGH + ZOOM] = lens_count - 1
    sigma, place = camera.pose_sigma, camera.place
    row[PRIOR : PRIOR + 4] = sigma.position_m, sigma.attitude_rad, sigma.pan_rad, sigma.tilt_rad
    row[SEPARATION] = max(place.min_separation_m, least_separation_m) if isinstance(place, DronePlace) else -1.0
    row[NEEDS_ANCHOR], row[LENS_FIRST], row[LENS_COUNT] = camera.needs_anchor, lens_first, lens_count
    return row


def _lens_rows(camera: SceneCamera, settings: PlannerSettings) -> Array:
    lenses = [step.lens for step in camera.zoom] or [camera.lens]
    return np.array([lens_row(lens, camera.alpha_rad, refined=settings.refined_corners) for lens in lenses])


def _tag_rows(targets: Sequence[SceneTarget]) -> Array:
    rows = np.zeros((len(targets), TARGET_SIZE))
    if not targets:
        return rows
    points, normals = np.array([each.position_m for each in targets]), np.array([each.normal for each in targets])
    facing_rad, sizes = (
        np.array([each.facing_rad for each in targets]),
        np.array([each.tag_size_m or 0.0 for each in targets]),
    )
    reach = np.array([each.reach_m for each in targets])
    rows[:, POINT : POINT + 3] = points
    rows[:, CORNERS : CORNERS + 12] = tag_corners(points, normals, facing_rad, sizes).reshape(-1, 12)
    rows[:, ROOM : ROOM + 12] = tag_corners(points, normals, facing_rad, sizes + 2.0 * reach).reshape(-1, 12)
    rows[:, NORMAL : NORMAL + 3] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    rows[:, REACH], rows[:, WEIGHT] = reach, [each.weight for each in targets]
    rows[:, TAGGED] = [each.tag_size_m is not None for each in targets]
    return rows
