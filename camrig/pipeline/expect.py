"""Where in its next pictures each camera should find tags: the cheap way to look, as long as nothing is missing."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pose import apply, invert, transform
from camrig.messages import CameraPose, Expected, HeadAim, Region, RigPose, Target, TargetStatus
from camrig.pipeline.state import State
from camrig.rig import CameraSpec, FixedMount, HeadMount, Rig
from camrig.steer import apart_rad

VALID_S = 0.3
BEFORE_S = 0.15
"""Regions hold for frames stamped from so long ago, which are still being fetched, to ``VALID_S`` ahead."""

SIGMAS = 3.0
RIM = 1.25
"""A tag is found with the white rim around it, one of its eight cells wide."""

MARGIN_PX = 8.0
"""What a detector needs around that: its decimated pixels and tiles."""

RESTING_RAD = math.radians(0.3)
POSE_AGE_S = 1.0
MOTION_M = 0.03
"""What a target may do in the meantime beside going on as it did and what its covariance says."""


def expected(state: State, targets: tuple[Target, ...], pose: RigPose, rig: Rig, now_s: float) -> tuple[Expected, ...]:
    """Return the regions of every camera that stands still and knows where it is, while every target is tracked.

    A camera without an answer looks at its whole pictures. Pure geometry of what is believed now: targets at their
    predicted places, grown by their uncertainty and by what they may move; anchors; both seen with the last pose.
    """
    if any(target.status is not TargetStatus.TRACKED for target in targets):
        return ()
    found = []
    for camera in rig.cameras.values():
        seen_from = state.camera_poses.get(camera.id)
        if seen_from is None or now_s - seen_from.stamp_s > POSE_AGE_S:
            continue
        if not _still(camera, state, pose, seen_from.stamp_s):
            continue
        regions = tuple(_regions(camera.lens, seen_from, targets, rig))
        from_s = max(seen_from.stamp_s, now_s - BEFORE_S)
        found.append(Expected(camera.id, from_s, now_s + VALID_S, regions))
    return tuple(found)


def _still(camera: CameraSpec, state: State, pose: RigPose, since_s: float) -> bool:
    """Tell whether the camera has been where it was told to be since a stamp: a head that has arrived, or none."""
    match camera.mount:
        case FixedMount():
            return True
        case HeadMount(head=name):
            told, at = state.steer.head_aims.get(name), pose.heads.get(name)
            then = state.histories.heads[name].at(since_s) if name in state.histories.heads else None
            if at is None or then is None:
                return False
            was = HeadAim(*(float(angle) for angle in then.angles_rad))
            wanted = told[0] if told else was
            return max(apart_rad(wanted, at), apart_rad(wanted, was)) < RESTING_RAD
    # A hand-carried camera never rests, and a drone hovers and sways: a tenth of a degree is a pixel or two.
    return False


def _regions(lens: Lens, seen_from: CameraPose, targets: tuple[Target, ...], rig: Rig) -> Iterator[Region]:
    """Yield the part of the picture that each tag may cover, whatever its heading, if it may be in it at all."""
    tags = [*_target_tags(targets, rig), *(_around(each.T_world_tag, each.size_m, 0.0, _STAYS) for each in rig.anchors)]
    if not tags:
        return
    pixels = lens.project(apply(invert(seen_from.T_world_camera), np.stack(tags)))
    sway_rad = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(seen_from.covariance[3:, 3:]).max()))
    margin_px = sway_rad * max(lens.focal_px) + MARGIN_PX
    width, height = lens.size_px
    for points in pixels:
        known = points[np.isfinite(points).all(axis=1)]
        if not len(known):
            continue
        (left, top), (right, bottom) = known.min(axis=0) - margin_px, known.max(axis=0) + margin_px
        if left < width and top < height and right > 0.0 and bottom > 0.0:
            yield math.floor(left), math.floor(top), math.ceil(right) + 1, math.ceil(bottom) + 1


def _target_tags(targets: tuple[Target, ...], rig: Rig) -> Iterator[Array]:
    """Yield world points around every place where a tag of a target may be while the regions hold."""
    for target in targets:
        body = rig.targets[target.id]
        T_world_body = transform(target.R_world_body, target.position_m)
        reach_m, way_m = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(target.covariance_m2).max())), _STAYS
        if body.motion != "static":
            reach_m, way_m = reach_m + MOTION_M, np.multiply.outer([-BEFORE_S, VALID_S], target.velocity_m_s)
        for tag in body.tags:
            yield _around(T_world_body @ tag.T_body_tag, tag.size_m, reach_m, way_m)


def _around(T_world_tag: Transform, size_m: float, reach_m: float, way_m: Array) -> Array:
    """Return (18, 3) world points round a tag of any heading, up to ``reach_m`` off, at both ends (2, 3) of its way."""
    disc = apply(T_world_tag, (RIM * size_m / math.sqrt(2.0) + reach_m) * _DISC)
    return (disc + way_m[:, None]).reshape(-1, 3)


_STAYS: Array = np.zeros((2, 3))
_TURNS = math.pi / 4.0 * np.arange(8)
_DISC: Array = np.vstack(
    [np.column_stack([np.cos(_TURNS), np.sin(_TURNS), np.zeros(8)]) / math.cos(math.pi / 8.0), np.zeros((1, 3))]
)
"""An octagon about the unit circle, and its middle: where part of it is behind the camera, the rest still counts."""
