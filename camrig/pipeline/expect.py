"""Where in its next pictures each camera should find tags: the cheap way to look, as long as nothing is missing."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pose import apply, invert
from camrig.messages import CameraPose, Expected, HeadAim, Region, RigPose, Target, TargetStatus
from camrig.pipeline.state import State
from camrig.rig import Body, CameraSpec, DroneMount, HeadMount, Rig

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
    T_camera_world = invert(seen_from.T_world_camera)
    sway_rad = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(seen_from.covariance[3:, 3:]).max()))
    for target in targets:
        T_world_body = np.eye(4)
        T_world_body[:3, :3], T_world_body[:3, 3] = target.R_world_body, target.position_m
        sigma_m = math.sqrt(float(np.linalg.eigvalsh(target.covariance_m2).max()))
        travel_m = VALID_S * float(np.linalg.norm(target.velocity_m_s)) + MOTION_M * _moves(
            rig.targets[target.id]
        )
        for tag in rig.targets[target.id].tags:
            T_camera_tag = T_camera_world @ T_world_body @ tag.T_body_tag
            yield from _region(lens, T_camera_tag, tag.size_m, SIGMAS * sigma_m + travel_m, sway_rad)
    for anchor in rig.anchors:
        yield from _region(lens, T_camera_world @ anchor.T_world_tag, anchor.size_m, 0.0, sway_rad)


def _moves(body: Body) -> float:
    return 0.0 if body.motion == "static" else 1.0


def _region(lens: Lens, T_camera_tag: Transform, size_m: float, reach_m: float, sway_rad: float) -> Iterator[Region]:
    """Yield the picture's part that a tag of unknown heading may cover, if it may be in the picture at all."""
    centre = T_camera_tag[:3, 3]
    if centre[2] <= 0.1:
        return
    half_m = size_m * (0.5 * math.sqrt(2.0) + TAG_MARGIN) + reach_m
    pixels = lens.project(apply(T_camera_tag, half_m * _SQUARE))
    pixels = np.vstack([pixels, lens.project(centre[None])])
    known = pixels[np.isfinite(pixels).all(axis=1)]
    if not len(known):
        return
    sway_px = sway_rad * max(lens.focal_px)
    low, high = np.floor(known.min(axis=0) - sway_px), np.ceil(known.max(axis=0) + sway_px) + 1
    width, height = lens.size_px
    if low[0] < width and low[1] < height and high[0] > 0 and high[1] > 0:
        yield int(low[0]), int(low[1]), int(high[0]), int(high[1])


_SQUARE: Array = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
