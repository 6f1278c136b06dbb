"""The room of the simulated rig, and exactly what a picture taken in it shows; projection by OpenCV."""

from __future__ import annotations

import math

import cv2
import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert, transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import HeadAim
from camrig.rig import (
    Anchor,
    Body,
    BodyTag,
    CameraSpec,
    DroneMount,
    DroneSpec,
    HeadMount,
    HeadSpec,
    Rig,
    Space,
    TagKey,
)

MIN_SIDE_PX = 20.0
"""What a detector surely reads."""
RIM = 1.25
"""A tag is found with the white rim around it, one of its eight cells wide."""

LENS = BrownLens((1280, 720), (1050.0, 1050.0), (640.0, 360.0), (-0.33, 0.10, 0.0, 0.0))
SIZE_M = 0.2
_HEADS = {"west": (0.3, 3.7, -45.0), "east": (5.7, 3.7, -135.0), "south": (3.0, 0.3, 90.0)}
_ANCHORS_M = ((1.2, 1.0), (4.8, 1.0), (4.8, 3.0), (1.2, 3.0))
AWAY = HeadAim(math.radians(170.0), 0.0)
"""A start aim at the wall behind: no target in the picture."""
LOOKING_IN = HeadAim(0.0, math.radians(-45.0))


def room() -> Rig:
    """Return three heads in a room of 6 x 4 m, 2.8 m up, a drone, five robots and four anchors on the floor."""
    cameras = {
        f"c_{name}": CameraSpec(f"c_{name}", LENS, HeadMount(name, transform(R_MOUNT_OPTICAL, np.zeros(3))))
        for name in _HEADS
    }
    cameras["c_sky"] = CameraSpec("c_sky", LENS, DroneMount("d1", transform(R_BODY_OPTICAL_DOWN, np.zeros(3))))
    tag_up = transform(np.eye(3), np.array([0.0, 0.0, 0.25]))
    return Rig(
        "room",
        Space(((0.0, 0.0), (6.0, 4.0))),
        cameras,
        heads={name: _head(name, x, y, yaw_deg) for name, (x, y, yaw_deg) in _HEADS.items()},
        drones={"d1": DroneSpec("d1", ((0.5, 0.5, 1.2), (5.5, 3.5, 2.2)), 0.8, 0.6)},
        targets={
            f"robot{k}": Body(f"robot{k}", (BodyTag(TagKey("tag36h11", k), SIZE_M, tag_up),)) for k in range(1, 6)
        },
        anchors=tuple(
            Anchor(TagKey("tag36h11", 100 + k), SIZE_M, transform(np.eye(3), np.array([x, y, 0.0])))
            for k, (x, y) in enumerate(_ANCHORS_M)
        ),
    )


def _head(name: str, x: float, y: float, yaw_deg: float) -> HeadSpec:
    base = transform(rotation_z(math.radians(yaw_deg)), np.array([x, y, 2.8]))
    pan = math.radians(170.0)
    return HeadSpec(name, PanTilt(base), (-pan, pan), (-math.pi / 2.0, 0.0), math.radians(40.0), auto_enable=True)


def tag_in_picture(lens: BrownLens, T_world_camera: Transform, T_world_tag: Transform, size_m: float) -> Array | None:
    """Return the exact (4, 2) corners p0..p3 of a tag; None where the picture does not show all of it, rim included,
    from the front and at least ``MIN_SIDE_PX`` wide.
    """
    T_camera_tag = invert(T_world_camera) @ T_world_tag
    rim = apply(T_camera_tag, RIM * size_m * TAG_CORNERS)
    faces = float(T_camera_tag[:3, 2] @ T_camera_tag[:3, 3]) < 0.0
    if not faces or (rim[:, 2] <= 0.05).any() or (np.hypot(*rim[:, :2].T) >= lens.r_max * rim[:, 2]).any():
        return None
    if not (np.abs(2.0 * project(lens, rim) + 1.0 - lens.size_px) < lens.size_px).all():
        return None
    corners = project(lens, apply(T_camera_tag, size_m * TAG_CORNERS))
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    return corners if sides.min() >= MIN_SIDE_PX else None


def project(lens: BrownLens, points_camera: Array) -> Array:
    """Map (n, 3) points in front of the camera to (n, 2) pixels."""
    fx, fy = lens.focal_px
    K = np.array([[fx, 0.0, lens.centre_px[0]], [0.0, fy, lens.centre_px[1]], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(points_camera, np.zeros(3), np.zeros(3), K, np.array(lens.distortion))
    return np.asarray(pixels, float).reshape(-1, 2)
