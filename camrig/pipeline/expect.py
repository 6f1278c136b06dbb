"""Where in its next pictures each camera should find tags: the cheap way to look, as long as nothing is missing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens
from camrig.geometry.pose import apply, invert, transform
from camrig.locate import HeadHistory
from camrig.messages import CameraPose, Expected, HeadAim, Target, TargetStatus
from camrig.pipeline.state import State
from camrig.rig import CameraSpec, FixedMount, HeadMount, HeadSpec, Rig, TagKey

VALID_S = 0.3
BEFORE_S = 0.15
"""Regions hold for frames stamped from so long ago, which are still being fetched, to ``VALID_S`` ahead."""

SIGMAS = 3.0
RIM = 1.25
"""A tag is found with the white rim around it, one of its eight cells wide."""

MARGIN_PX = 8.0
"""What a detector needs around that: its decimated pixels and tiles."""

RESTING_RAD = math.radians(0.3)
TURNING_RAD = math.radians(0.5)
"""How far a head that turns may be off what is reckoned: it overshoots, and its speed is not quite what is said."""
COASTS_S = 0.15
"""A head may go on as it did for so long, whatever it was told since: the order's way, and braking."""
POSE_AGE_S = 1.0
MOTION_M = 0.02
"""What a target may do from now on beside going on as it did; that it swerves is in its covariance so far."""


def expected(state: State, targets: tuple[Target, ...], rig: Rig, now_s: float) -> tuple[Expected, ...]:
    """Return where every camera that knows where it looks should find tags, while every target is tracked.

    A camera without an answer looks at its whole pictures. Pure geometry of what is believed now: targets at their
    predicted places, grown by their uncertainty and by what they may move; anchors; both seen from every place where
    the camera may be, by its last pose and by what its head is doing.
    """
    if any(target.status is not TargetStatus.TRACKED for target in targets):
        return ()
    tags, found = _tags(targets, rig), []
    for camera in rig.cameras.values():
        seen_from = state.camera_poses.get(camera.id)
        if not tags.keys or seen_from is None or now_s - seen_from.stamp_s > POSE_AGE_S:
            continue
        from_s, until_s = max(seen_from.stamp_s, now_s - BEFORE_S), now_s + VALID_S
        stamps_s = np.linspace(from_s, until_s, 3)
        views = _views(camera, state, seen_from, rig, stamps_s)
        if views is not None:
            edges_px, sides_px = _regions(camera.lens, seen_from, views, tags, stamps_s - now_s)
            found.append(Expected(camera.id, from_s, until_s, tags.keys, edges_px, sides_px))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Tags:
    """n tags that may be seen: (n, 9, 3) world points about each, whatever its heading, as far as it may have strayed
    beside its way; ``velocity_m_s`` (n, 3); ``size_share`` (n,) of those points' radius is the tag's side.
    """

    keys: tuple[TagKey, ...]
    points_m: Array
    velocity_m_s: Array
    size_share: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """(3, p, 4, 4) ``T_camera_world`` of p places where a camera may be, at three stamps, and what they may be off."""

    T_camera_world: Array
    off_rad: float


def _tags(targets: tuple[Target, ...], rig: Rig) -> _Tags:
    keys, points, velocities, shares = [], [], [], []
    spread = np.linalg.eigvalsh(np.array([target.covariance_m2 for target in targets]).reshape(-1, 3, 3))
    for target, variances_m2 in zip(targets, spread, strict=True):
        body = rig.targets[target.id]
        T_world_body = transform(target.R_world_body, target.position_m)
        moves = body.motion != "static"
        reach_m = SIGMAS * math.sqrt(max(float(variances_m2[-1]), 0.0)) + (MOTION_M if moves else 0.0)
        for tag in body.tags:
            radius_m = RIM * tag.size_m / math.sqrt(2.0) + reach_m
            keys.append(tag.key)
            points.append(apply(T_world_body @ tag.T_body_tag, radius_m * _DISC))
            velocities.append(target.velocity_m_s if moves else np.zeros(3))
            shares.append(tag.size_m / radius_m)
    for anchor in rig.anchors:
        radius_m = RIM * anchor.size_m / math.sqrt(2.0)
        keys.append(anchor.key)
        points.append(apply(anchor.T_world_tag, radius_m * _DISC))
        velocities.append(np.zeros(3))
        shares.append(anchor.size_m / radius_m)
    return _Tags(
        tuple(keys), np.reshape(points, (-1, 9, 3)), np.reshape(velocities, (-1, 3)), np.array(shares, dtype=float)
    )


def _views(camera: CameraSpec, state: State, seen_from: CameraPose, rig: Rig, stamps_s: Array) -> _Views | None:
    """Return where a camera may be; None where nobody knows, and of a drone: it hovers and sways."""
    match camera.mount:
        case FixedMount():
            return _Views(np.tile(invert(seen_from.T_world_camera), (3, 1, 1, 1)), 0.0)
        case HeadMount(head=name) if name in state.histories.heads:
            told = state.steer.head_aims.get(name)
            return _from_head(rig.heads[name], state.histories.heads[name], told and told[0], seen_from, stamps_s)
    return None


def _from_head(
    head: HeadSpec, history: HeadHistory, wanted: HeadAim | None, seen_from: CameraPose, stamps_s: Array
) -> _Views | None:
    """Carry the last pose along with the head: it is as read up to the last reading, and then either still there, or on
    its way to where it was told to be, or going on as it did.
    """
    then = history.at(seen_from.stamp_s)
    read_s = min(
        (axis.readings[-1].stamp_s for axis in (history.pan, history.tilt) if axis.readings), default=-math.inf
    )
    last, before = history.at(read_s), history.at(read_s - COASTS_S)
    if then is None or last is None or history.at(stamps_s[1]) is None:
        return None
    rate_rad_s = np.zeros(2) if before is None else (last.angles_rad - before.angles_rad) / COASTS_S
    to_go = np.array([wanted.pan_rad, wanted.tilt_rad]) - last.angles_rad if wanted else np.zeros(2)
    turns = max(np.abs(to_go).max(), np.abs(last.angles_rad - then.angles_rad).max()) >= RESTING_RAD
    turns = turns or np.abs(rate_rad_s).max() * COASTS_S >= RESTING_RAD
    if not turns:
        return _Views(np.tile(invert(seen_from.T_world_camera), (3, 1, 1, 1)), 0.0)
    if wanted is None:
        return None
    T_mount_camera = invert(head.kinematics.T_world_mount(*then.angles_rad)) @ seen_from.T_world_camera
    views = []
    for stamp_s in stamps_s:
        known = history.at(min(stamp_s, read_s))
        if known is None:
            return None
        ahead_s = max(0.0, stamp_s - read_s)
        way = np.clip(to_go, -head.speed_rad_s * ahead_s, head.speed_rad_s * ahead_s)
        coasted = rate_rad_s * min(ahead_s, COASTS_S)
        angles = [known.angles_rad, known.angles_rad + way, known.angles_rad + coasted]
        views.append([invert(head.kinematics.T_world_mount(*each) @ T_mount_camera) for each in angles])
    return _Views(np.array(views), TURNING_RAD)


def _regions(lens: Lens, seen_from: CameraPose, views: _Views, tags: _Tags, ahead_s: Array) -> tuple[Array, Array]:
    """Return edges (3, n, 4) of the parts of the picture that the tags may cover, and (n,) their shortest sides.

    The region of a tag that cannot be in the picture is empty.
    """
    points_m = tags.points_m + (ahead_s[:, None, None] * tags.velocity_m_s)[:, :, None]  # (3, n, 9, 3)
    T = views.T_camera_world[:, :, None]  # (3, p, 1, 4, 4)
    pixels = lens.project(points_m[:, None] @ T[..., :3, :3].swapaxes(-1, -2) + T[..., None, :3, 3])  # (3, p, n, 9, 2)
    known = np.isfinite(pixels[..., :1])
    low = np.where(known, pixels, np.inf).min(axis=(1, 3))
    high = np.where(known, pixels, -np.inf).max(axis=(1, 3))
    sway_rad = SIGMAS * math.sqrt(max(float(np.linalg.eigvalsh(seen_from.covariance[3:, 3:])[-1]), 0.0))
    margin_px = (sway_rad + views.off_rad) * max(lens.focal_px) + MARGIN_PX
    edges_px = np.concatenate([low - margin_px, high + margin_px], axis=-1)
    # What is out of sight at one of the three stamps has no place to move from or to: it is left where it is known.
    unknown = ~np.isfinite(edges_px).all(axis=-1, keepdims=True)
    if unknown.any():
        edges_px = np.where(unknown, _NOWHERE, edges_px)
        partly = unknown.any(axis=0) & ~unknown.all(axis=0)
        widest = np.concatenate([low.min(axis=0) - margin_px, high.max(axis=0) + margin_px], axis=-1)
        edges_px = np.where(partly, widest, edges_px)
    return edges_px, _sides_px(pixels[1, 0], tags.size_share)


def _sides_px(pixels: Array, size_share: Array) -> Array:
    """Return (n,) the shortest side of squares from the octagons (n, 9, 2) about them: the ellipse's lesser radius."""
    apart = pixels[:, :8] - pixels[:, 8:]
    xx, yy, xy = (apart[..., 0] ** 2).mean(-1), (apart[..., 1] ** 2).mean(-1), (apart[..., 0] * apart[..., 1]).mean(-1)
    least = 0.5 * (xx + yy - np.hypot(xx - yy, 2.0 * xy))
    radius_px = math.cos(math.pi / 8.0) * np.sqrt(2.0 * np.maximum(least, 0.0))
    return np.asarray(radius_px * size_share)


_NOWHERE = -1e6
_TURNS = math.pi / 4.0 * np.arange(8)
_DISC: Array = np.vstack(
    [np.column_stack([np.cos(_TURNS), np.sin(_TURNS), np.zeros(8)]) / math.cos(math.pi / 8.0), np.zeros((1, 3))]
)
"""An octagon about the unit circle, and its middle: where part of it is behind the camera, the rest still counts."""
