"""Where to begin with a head: sign and scale of its axes from how pictures turn, then tags and base from single tags.

That a tag's square has two poses is settled by many pictures: the right ones agree with each other, the others do not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.head_model import PAN, TILT, HeadModel, HeadShot, HeadViews, missed_px
from camrig.calibrate.start import agreed
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import square_poses
from camrig.geometry.pose import invert, transform
from camrig.geometry.rotation import rotation_log, rotation_z, wrap_angle

_CAP_PX2 = 8.0 * 5.0**2
"""A view that misses by more tells nothing more."""
_LEAST_TURN_RAD = math.radians(0.3)
"""Less than this of a turn, of what is reported or seen, tells nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What one axis's turn looked like: the true turn over the reported one, and its axis (3,) in the camera."""

    factor: float
    axis: Array
    seen_rad: float


def turn(lens: Lens, before: HeadShot, after: HeadShot, axis: int, expected_axis: Array) -> Turn | None:
    """Return what the pictures tell of a turn of one ``axis``; ``expected_axis`` (3,) tells its positive end roughly.

    None where they share no tag, or the axis or the picture stood still.
    """
    reported_rad = float(after.reported_rad[axis] - before.reported_rad[axis])
    rotation = camera_turn(lens, before.corners_px, after.corners_px)
    if rotation is None or abs(reported_rad) < _LEAST_TURN_RAD:
        return None
    turned = rotation_log(rotation)
    seen_rad = float(np.linalg.norm(turned))
    if seen_rad < _LEAST_TURN_RAD:
        return None
    sign = math.copysign(1.0, float(turned @ expected_axis))
    return Turn(sign * seen_rad / reported_rad, sign * turned / seen_rad, seen_rad)


def camera_turn(lens: Lens, before: Mapping[str, Array], after: Mapping[str, Array]) -> Array | None:
    """Return R_before_after of a camera that turned (3, 3), by the corners that both pictures show; None without any.

    Kabsch's rotation of the rays: that the camera also moved a little is left out.
    """
    shared = sorted(before.keys() & after.keys())
    if not shared:
        return None
    rays = [_rays(lens, np.concatenate([corners[name] for name in shared])) for corners in (before, after)]
    if not np.isfinite(rays).all():
        return None
    U, _, Vt = np.linalg.svd(rays[0].T @ rays[1])
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def expected_axes(T_mount_camera: Transform, tilt_rad: float) -> tuple[Array, Array]:
    """Return the positive ends (3,) of pan and tilt in the camera at a tilt."""
    R_camera_mount = T_mount_camera[:3, :3].T
    up = R_camera_mount @ np.array([math.sin(tilt_rad), 0.0, math.cos(tilt_rad)])
    return np.asarray(up), np.asarray(R_camera_mount @ np.array([0.0, -1.0, 0.0]))


def tilt_of(T_mount_camera: Transform, pan_axis: Array) -> float:
    """Return the tilt at which the pan axis is seen like that in the camera."""
    x, _, z = T_mount_camera[:3, :3] @ pan_axis
    return math.atan2(x, z)


def begin(
    file: HeadModel, views: HeadViews, anchors: Mapping[str, Transform]
) -> tuple[HeadModel, dict[str, Transform]]:
    """Return the head and ``T_world_tag`` of all tags, roughly, from a head whose axes are roughly right.

    With anchors in view the base is placed by them, and pan's zero is what makes up for its heading; else the base is
    where the file has it. Raises InputError where no view has a tag pose.
    """
    candidates = [
        [pose.T_camera_tag for pose in square_poses(views.ideal[k], views.px_per_ideal[k], size_m)]
        for k, size_m in enumerate(map(_size_m, views.corners_m))
    ]
    model = file
    angles_rad = model.angles_rad(views.reported_rad, views.travel)
    T_base_camera = [invert(model.T_world_base) @ model.T_world_camera(*angles) for angles in angles_rad]
    of_anchors = [
        anchors[name] @ invert(T_base_camera[shot] @ T)
        for name, shot, poses in zip([views.tags[k] for k in views.tag], views.shot, candidates, strict=True)
        if name in anchors
        for T in poses
    ]
    if of_anchors:
        model = _with_base(model, agreed(of_anchors))
    at = [model.T_world_camera(*angles) for angles in model.angles_rad(views.reported_rad, views.travel)]
    tags: dict[str, Transform] = {}
    for number, name in enumerate(views.tags):
        seen = [at[views.shot[k]] @ T for k in np.flatnonzero(views.tag == number) for T in candidates[k]]
        if name in anchors:
            tags[name] = anchors[name]
        elif seen:
            tags[name] = agreed(seen)
        else:
            raise InputError(f"tag {name} is seen edge-on all the time: turn it towards the camera, or leave it out")
    return model, tags


def placed_anew(model: HeadModel, views: HeadViews, number: int) -> Transform | None:
    """Return the pose of one tag that agrees best with the corners of all its views, from a head that is right.

    Of the two poses of its square in each view. None where no view has one.
    """
    own = views.only(views.tag == number)
    angles_rad = model.angles_rad(views.reported_rad, views.travel)
    found = [
        model.T_world_camera(*angles_rad[shot]) @ pose.T_camera_tag
        for k, shot in enumerate(own.shot)
        for pose in square_poses(own.ideal[k], own.px_per_ideal[k], _size_m(own.corners_m[k]))
    ]
    tags = np.tile(np.eye(4), (len(views.tags), 1, 1))
    costs = []
    for T in found:
        tags[number] = T
        missed, _ = missed_px(model, tags, own, np.zeros_like(views.reported_rad))
        costs.append(float(np.minimum(np.square(missed).sum(axis=1), _CAP_PX2).sum()))
    return found[int(np.argmin(costs))] if found else None


def _size_m(corners_m: Array) -> float:
    return float(np.linalg.norm(corners_m[1] - corners_m[0]))


def _with_base(model: HeadModel, T_world_base: Transform) -> HeadModel:
    """Return the head on another base; that one's heading goes into pan's zero."""
    between = model.T_world_base[:3, :3].T @ T_world_base[:3, :3]
    heading_rad = math.atan2(between[1, 0], between[0, 0])
    pan, tilt = model.axes
    turned = replace(pan, offset_rad=wrap_angle(pan.offset_rad + heading_rad))
    T_level = T_world_base @ transform(rotation_z(-heading_rad), np.zeros(3))
    return replace(model, T_world_base=np.asarray(T_level), axes=(turned, tilt))


def with_turns(
    file: HeadModel, pan: Sequence[Turn], tilt: Sequence[Turn], reported_tilt_rad: Sequence[float]
) -> HeadModel:
    """Return the file's head with the factors that single turns showed, and tilt's zero where pan's axis shows it.

    ``reported_tilt_rad`` is what tilt reported during each of pan's turns.
    """
    axes = list(file.axes)
    for k, turns in ((PAN, pan), (TILT, tilt)):
        if turns:
            weights = np.array([each.seen_rad for each in turns])
            factor = float(np.average([each.factor for each in turns], weights=weights))
            axes[k] = replace(axes[k], factor=factor)
    if pan:
        shown_rad = [tilt_of(file.T_mount_camera, each.axis) for each in pan]
        line_rad = [float(axes[TILT].line_rad(np.array(each))) for each in reported_tilt_rad]
        off = np.exp(1j * (np.array(shown_rad) - np.array(line_rad))).sum()
        axes[TILT] = replace(axes[TILT], offset_rad=axes[TILT].offset_rad + float(np.angle(off)))
    return replace(file, axes=(axes[PAN], axes[TILT]))


def _rays(lens: Lens, pixels: Array) -> Array:
    """Return the (n, 3) unit rays of (n, 2) pixels."""
    ideal = lens.unproject(pixels)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
