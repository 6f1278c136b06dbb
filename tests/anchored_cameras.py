"""One camera on each kind of carrier over three anchors, and exactly what it sees of them; projection by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.stats import chi2

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pnp import TAG_CORNERS, observe_tags
from camrig.locate import Histories
from camrig.messages import AxisReading, TagDetection, TagDetections
from camrig.rig import (
    Anchor,
    CameraSpec,
    DroneMount,
    DroneSpec,
    FixedMount,
    FreeMount,
    HeadMount,
    HeadSpec,
    Rig,
    Space,
    TagKey,
)

LENS = BrownLens((1280, 720), (827.7, 827.9), (640.0, 360.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
KINEMATICS = PanTilt(
    pose.transform(np.eye(3), np.array([1.0, 1.0, 2.7])), pose.transform(np.eye(3), np.array([0.02, 0.0, 0.05]))
)
T_MOUNT = pose.transform(R_MOUNT_OPTICAL, np.array([0.03, 0.01, 0.06]))
T_UNDER = pose.transform(R_BODY_OPTICAL_DOWN, np.array([0.0, 0.0, -0.05]))
PAN, TILT = 0.9, -1.1
TRUE_ON_HEAD = KINEMATICS.T_world_camera(PAN, TILT, T_MOUNT)
SIZE_M = 0.2

HEAD_CAMERA = CameraSpec("north", LENS, HeadMount("h", T_MOUNT))
DRONE_CAMERA = CameraSpec("above", LENS, DroneMount("d", T_UNDER))
FIXED_CAMERA = CameraSpec("wall", LENS, FixedMount(TRUE_ON_HEAD))
FREE_CAMERA = CameraSpec("hand", LENS, FreeMount())


def key(number: int) -> TagKey:
    return TagKey("tag36h11", number)


def anchor(number: int, x_m: float, y_m: float, R: Array | None = None, z_m: float = 0.0) -> Anchor:
    return Anchor(key(number), SIZE_M, pose.transform(np.eye(3) if R is None else R, np.array([x_m, y_m, z_m])))


ON_FLOOR = (anchor(100, 1.9, 2.2), anchor(101, 1.2, 2.6), anchor(102, 2.2, 1.7))


def rig_with(anchors: tuple[Anchor, ...], bias_sigma_rad: float = 0.003) -> Rig:
    head = HeadSpec("h", KINEMATICS, (-3.0, 3.0), (-1.6, 0.2), 1.0, bias_sigma_rad=bias_sigma_rad)
    cameras = {camera.id: camera for camera in (HEAD_CAMERA, DRONE_CAMERA, FIXED_CAMERA, FREE_CAMERA)}
    drone = DroneSpec("d", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), 0.8, 0.5)
    return Rig("test", Space(), cameras, {"h": head}, {"d": drone}, {}, anchors)


RIG = rig_with(ON_FLOOR)


def read(pan_rad: float, tilt_rad: float, sigma_rad: float = 0.001) -> Histories:
    histories = Histories()
    for stamp_s in (0.9, 1.1):
        histories = histories.with_reading(AxisReading("h", "pan", pan_rad, stamp_s, sigma_rad, 0.0))
        histories = histories.with_reading(AxisReading("h", "tilt", tilt_rad, stamp_s, sigma_rad, 0.0))
    return histories


def opencv_pixels(T_camera_world: Array, points_world: Array) -> Array:
    K = np.array([[827.7, 0.0, 640.0], [0.0, 827.9, 360.0], [0.0, 0.0, 1.0]])
    rvec = cv2.Rodrigues(T_camera_world[:3, :3])[0]
    pixels, _ = cv2.projectPoints(points_world, rvec, T_camera_world[:3, 3], K, np.array(LENS.distortion))
    return np.asarray(pixels[:, 0], dtype=float)


def seen(
    anchors: tuple[Anchor, ...],
    T_world_camera: Array,
    camera: CameraSpec,
    rng: np.random.Generator | None = None,
    stamp_s: float = 1.0,
) -> TagDetections:
    """The anchors in the picture of a camera at a pose; with the noise law's own noise where ``rng`` is given."""
    tags = []
    for one in anchors:
        corners = opencv_pixels(pose.invert(T_world_camera), pose.apply(one.T_world_tag, one.size_m * TAG_CORNERS))
        if rng is not None:
            corners = corners + rng.normal(size=(4, 2)) * observe_tags(LENS, corners[None]).sigma_px[0, :, None]
        x, y = corners.mean(axis=0)
        tags.append(TagDetection(one.key, corners, (float(x), float(y)), 0, 60.0))
    return TagDetections(camera.id, stamp_s, 0, LENS.size_px, tuple(tags), 0.0)


def within_chance(values: list[float], freedoms: int) -> bool:
    """Whether a mean of NEES lies within the two-sided 99.8 % bounds of chi2."""
    n = len(values)
    low, high = (float(chi2.ppf(p, freedoms * n)) / n for p in (0.001, 0.999))
    return bool(low <= np.mean(values) <= high)
