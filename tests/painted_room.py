"""A camera on a wall over five robots that drive in circles: its pictures, what they show, and who follows them.

The tags are painted into a picture as busy as a real room's, each by averaging 4 x 4 samples a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert, transform
from camrig.geometry.rotation import rotation_z
from camrig.host.detection import busy_picture
from camrig.interfaces import Published
from camrig.messages import Expected, TagDetection, TagDetections, TargetStatus
from camrig.optimise import PlannerSettings
from camrig.pipeline import Inputs, Settings, State, begin, step
from camrig.rig import Body, BodyTag, CameraSpec, FixedMount, Rig, Space, TagKey
from camrig_emulators.tag_pictures import tag_texture
from tests.simulated_room import LENS, RIM, SIZE_M, project

FINE = 4
TEXELS = 16
PSF_PX, NOISE_GREY = 0.7, 3.0
T_WORLD_CAMERA = transform(aim_rotation(0.0, math.radians(-50.0)) @ R_MOUNT_OPTICAL, np.array([0.0, 2.0, 2.8]))
CENTRES_M = ((1.75, 1.5), (2.0, 2.7), (2.6, 2.0), (3.2, 1.1), (3.3, 2.9))
CIRCLE_M, SPEED_M_S = 0.25, 0.4
T_ROOF = transform(np.eye(3), np.array([0.0, 0.0, 0.25]))
KEYS = tuple(TagKey("tag36h11", k) for k in range(1, 6))
RIG = Rig(
    "painted",
    Space(((0.0, 0.0), (6.0, 4.0))),
    {"wall": CameraSpec("wall", LENS, FixedMount(T_WORLD_CAMERA))},
    targets={f"robot{key.id}": Body(f"robot{key.id}", (BodyTag(key, SIZE_M, T_ROOF),)) for key in KEYS},
)


def robot_at(number: int, stamp_s: float) -> Transform:
    """Return T_world_body of a robot."""
    turn = SPEED_M_S / CIRCLE_M * stamp_s + number
    x, y = CENTRES_M[number]
    place = np.array([x + CIRCLE_M * math.cos(turn), y + CIRCLE_M * math.sin(turn), 0.0])
    return transform(rotation_z(turn + math.pi / 2.0), place)


def corners_at(stamp_s: float) -> Array:
    """Return the true corners p0..p3 of the robots' tags, (5, 4, 2) pixels."""
    T_camera_world = invert(T_WORLD_CAMERA)
    square = SIZE_M * TAG_CORNERS
    return np.array([project(LENS, apply(T_camera_world @ robot_at(k, stamp_s) @ T_ROOF, square)) for k in range(5)])


def paint(picture: np.ndarray, quad: Array, key: TagKey) -> None:
    """Lay a tag with its rim over a picture drawn ``FINE`` times as fine; ``quad`` are its corners p0..p3 in pixels."""
    texture = tag_texture(key, TEXELS).astype(np.float32)
    low, high = TEXELS - 0.5, len(texture) - TEXELS - 0.5
    corners = np.array([[low, high], [high, high], [high, low], [low, low]], np.float32)
    H = cv2.getPerspectiveTransform(corners, ((quad + 0.5) * FINE - 0.5).astype(np.float32))
    size = picture.shape[1], picture.shape[0]
    cv2.warpPerspective(texture, H, size, dst=picture, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)


def picture_at(stamp_s: float, rng: np.random.Generator, ground: GreyImage | None = None) -> GreyImage:
    """Return what the camera sees."""
    image = (busy_picture() if ground is None else ground).copy()
    for key, quad in zip(KEYS, corners_at(stamp_s), strict=True):
        rim = quad.mean(axis=0) + 1.1 * RIM * (quad - quad.mean(axis=0))
        (left, top), (right, bottom) = np.floor(rim.min(axis=0)).astype(int), np.ceil(rim.max(axis=0)).astype(int) + 1
        before = image[top:bottom, left:right].astype(np.float32)
        fine = cv2.resize(before, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_NEAREST)
        paint(fine, quad - [left, top], key)
        part = cv2.resize(fine, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
        noisy = cv2.GaussianBlur(part, (0, 0), PSF_PX) + rng.normal(0.0, NOISE_GREY, part.shape)
        image[top:bottom, left:right] = np.clip(noisy, 0, 255)
    return image


def exactly_seen(stamp_s: float, sequence: int, rng: np.random.Generator) -> TagDetections:
    """Return what a good detector would find there."""
    tags = tuple(
        TagDetection(key, quad + rng.normal(0.0, 0.03, (4, 2)), tuple(quad.mean(axis=0).tolist()), 0, 80.0, (True,) * 4)
        for key, quad in zip(KEYS, corners_at(stamp_s), strict=True)
    )
    return TagDetections("wall", stamp_s, sequence, LENS.size_px, tags, 0.0)


@dataclass
class Follower:
    """The pipeline, stepped by hand; nobody answers what it asks of the planner."""

    settings: Settings = field(default_factory=lambda: Settings(PlannerSettings()))
    state: State = field(default_factory=lambda: begin(0.0))

    def take(self, found: TagDetections, now_s: float) -> tuple[Published, tuple[Expected, ...] | None]:
        """Take a frame's detections; return what is published, and where tags are expected."""
        self.state, outputs = step(self.state, Inputs(detections=(found,)), RIG, self.settings, now_s)
        return outputs.published, outputs.expected

    @staticmethod
    def tracked(published: Published) -> int:
        return sum(target.status is TargetStatus.TRACKED for target in published.targets)
