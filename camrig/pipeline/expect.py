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
from camrig.rig import CameraSpec, DroneMount, HeadMount, Rig

VALID_S = 0.3
SIGMAS = 3.0
TAG_MARGIN = 0.5
"""A tag needs its white rim: half its side on every side."""

RESTING_RAD = math.radians(0.3)
POSE_AGE_S = 1.0
MOTION_M = 0.03
"""What a target may do within ``VALID_S`` beside going on as it did."""


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
        found.append(Expected(camera.id, seen_from.stamp_s, now_s + VALID_S, regions))
    return tuple(found)


def _still(camera: CameraSpec, state: State, pose: RigPose, since_s: float) -> bool:
    """Tell whether the camera has been where it was told to be since a stamp: a head that has arrived, or none."""
    match camera.mount:
        case HeadMount(head=name):
            told, at = state.steer.head_aims.get(name), pose.heads.get(name)
            then = state.histories.heads[name].at(since_s) if name in state.histories.heads else None
            if at is None or then is None:
                return False
            was = HeadAim(*(float(angle) for angle in then.angles_rad))
            wanted = told[0] if told else was
            return max(_apart_rad(wanted, at), _apart_rad(wanted, was)) < RESTING_RAD
        case DroneMount():
            return False  # it hovers and sways: a pixel's worth of region is a tenth of a degree
    return True


def _apart_rad(a: HeadAim, b: HeadAim) -> float:
    return max(abs(a.pan_rad - b.pan_rad), abs(a.tilt_rad - b.tilt_rad))


def _regions(lens: Lens, seen_from: CameraPose, targets: tuple[Target, ...], rig: Rig) -> Iterator[Region]:
    """Yield the part of the picture that each tag may cover, whatever its heading, if it may be in it at all."""
    T_camera_world = invert(seen_from.T_world_camera)
    tags = [*_target_tags(targets, rig), *((anchor.T_world_tag, anchor.size_m, 0.0) for anchor in rig.anchors)]
    if not tags:
        return
    squares = np.stack([apply(T_camera_world @ T, _half_m(size_m, reach_m) * _SQUARE) for T, size_m, reach_m in tags])
    pixels = lens.project(squares)
    sway_px = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(seen_from.covariance[3:, 3:]).max())) * max(lens.focal_px)
    width, height = lens.size_px
    for points in pixels:
        known = points[np.isfinite(points).all(axis=1)]
        if not len(known):
            continue
        (left, top), (right, bottom) = known.min(axis=0) - sway_px, known.max(axis=0) + sway_px
        if left < width and top < height and right > 0.0 and bottom > 0.0:
            yield math.floor(left), math.floor(top), math.ceil(right) + 1, math.ceil(bottom) + 1


def _target_tags(targets: tuple[Target, ...], rig: Rig) -> Iterator[tuple[Transform, float, float]]:
    """Yield T_world_tag, size and how far it may be from there, of every tag on every target."""
    for target in targets:
        body = rig.targets[target.id]
        T_world_body = transform(target.R_world_body, target.position_m)
        reach_m = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(target.covariance_m2).max()))
        if body.motion != "static":
            reach_m += VALID_S * float(np.linalg.norm(target.velocity_m_s)) + MOTION_M
        for tag in body.tags:
            yield T_world_body @ tag.T_body_tag, tag.size_m, reach_m


def _half_m(size_m: float, reach_m: float) -> float:
    return size_m * (0.5 * math.sqrt(2.0) + TAG_MARGIN) + reach_m


_SQUARE: Array = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
"""The corners and the middle: where part of it is behind the camera, the rest still counts."""
