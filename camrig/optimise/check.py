"""What cannot be planned is refused by the name of the culprit, before a NaN gets anywhere. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from camrig.errors import InputError
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.optimise.places import bounds, frames
from camrig.optimise.scene import DronePlace, PlannerSettings, Scene, SceneAnchor, SceneCamera, SceneTarget


def check(scene: Scene) -> None:
    """Raise InputError for numbers that are not finite or mean nothing, and for ``fisher`` without a tag's size."""
    _check_settings(scene.settings)
    for camera in scene.cameras:
        _check_camera(camera)
    _check_targets(scene.targets)
    for k, anchor in enumerate(scene.anchors):
        _check_anchor(k, anchor)
    for k, box in enumerate(scene.keep_out_m):
        if not np.isfinite(box).all():
            raise InputError(f"keep-out box {k}: its corners must be finite numbers")
    if scene.settings.quality == "fisher":
        for target in scene.targets:
            if target.tag_size_m is None:
                raise InputError(f"target {target.id} has no tag_size_m; quality 'fisher' judges by a tag's corners")


def check_aims(aims: Mapping[str, Aim]) -> None:
    """Raise InputError for an aim that is not made of finite numbers."""
    for name, aim in aims.items():
        numbers: tuple[float, ...] = ()
        match aim:
            case HeadAim(pan_rad=pan_rad, tilt_rad=tilt_rad, zoom=zoom):
                numbers = (pan_rad, tilt_rad, zoom or 0.0)
            case DroneAim(position_m=position_m, yaw_rad=yaw_rad):
                numbers = (*position_m, yaw_rad)
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"the aim of {name} must be finite numbers, not {aim}")


def _check_settings(settings: PlannerSettings) -> None:
    for name in (
        "margin_rad",
        "min_separation_m",
        "min_tag_px",
        "max_incidence_rad",
        "max_range_m",
        "gain",
        "motion_cost_per_s",
    ):
        if math.isnan(getattr(settings, name)):
            raise InputError(f"{name} must be a number, not nan")


def _check_camera(camera: SceneCamera) -> None:
    low, high = bounds(camera.place)
    if not np.isfinite([low, high]).all() or (low > high).any():
        raise InputError(f"camera {camera.id}: its limits must be finite and leave something between them")
    if not all(np.isfinite(frame).all() for frame in frames(camera.place)):
        raise InputError(f"camera {camera.id}: its mounting must be a pose of finite numbers")
    sigma = camera.pose_sigma
    sigmas = (sigma.position_m, sigma.attitude_rad, sigma.pan_rad, sigma.tilt_rad)
    if not all(0.0 <= value < math.inf for value in sigmas):
        raise InputError(f"camera {camera.id}: what its pose is uncertain by must be finite and not below 0")
    if camera.alpha_rad is not None and not math.isfinite(camera.alpha_rad):
        raise InputError(f"camera {camera.id}: alpha_rad must be a finite number, not {camera.alpha_rad}")
    if isinstance(camera.place, DronePlace) and math.isnan(camera.place.min_separation_m):
        raise InputError(f"camera {camera.id}: min_separation_m must be a number, not nan")


def _check_targets(targets: Sequence[SceneTarget]) -> None:
    if not targets:
        return
    values = np.array(
        [
            (*t.position_m, *t.normal, t.facing_rad, t.reach_m, t.weight, 1.0 if t.tag_size_m is None else t.tag_size_m)
            for t in targets
        ]
    )
    endless = ~np.isfinite(values).all(axis=1)
    if endless.any():
        name = targets[int(endless.argmax())].id
        raise InputError(f"target {name}: its place, normal, facing, reach, weight and tag size must be finite numbers")
    empty = (values[:, 8:] <= 0.0).any(axis=1) | (values[:, 7] < 0.0) | ~values[:, 3:6].any(axis=1)
    if empty.any():
        name = targets[int(empty.argmax())].id
        raise InputError(
            f"target {name}: its weight and tag size must be above 0, its reach not below, its normal of some length"
        )


def _check_anchor(k: int, anchor: SceneAnchor) -> None:
    numbers = (*anchor.position_m, *anchor.normal, anchor.facing_rad, anchor.tag_size_m)
    if not all(map(math.isfinite, numbers)) or anchor.tag_size_m <= 0.0 or not any(anchor.normal):
        raise InputError(
            f"anchor {k}: its place, normal and facing must be finite numbers, "
            "its tag size above 0, its normal of some length"
        )
