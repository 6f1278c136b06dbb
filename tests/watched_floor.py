"""Heads that watch bodies on a floor: a drawn scene, with every error a real one has, and exactly what is detected.

The corners are projected by OpenCV through the true lens, at the true pose; camrig is told the believed ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np

from camrig.fuse.settings import Settings
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.corner_noise import refined_sigma_px, tag_width_px
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert, perturb, transform
from camrig.geometry.rotation import rotation_z
from camrig.locate import Histories, View, locate
from camrig.locate.camera_pose import MOUNT_COVARIANCE
from camrig.messages import AxisReading, TagDetection, TagDetections
from camrig.rig import Anchor, Body, BodyTag, CameraSpec, HeadMount, HeadSpec, Rig, Space, TagKey

SIZE_PX = (1280, 800)
LENS = BrownLens(SIZE_PX, (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
SIZE_M = 0.162
MOUNT = transform(R_MOUNT_OPTICAL, np.zeros(3))
LENS_SIGMA = (0.0006, 0.4, 0.4, 0.0005)
MIN_WIDTH_PX = 20.0
REPEATING = Settings().repeating
"""The part of the corner noise that camrig takes for a camera's own, the same in every frame."""


@dataclass(frozen=True)
class Errors:
    """One sigma of what is wrong: heads' angles, their mounts as MOUNT_COVARIANCE says, lenses as a calibration."""

    pointing_rad: float = 0.0
    mounts: bool = False
    lenses: bool = False


@dataclass
class Floor:
    """A drawn scene of ``cameras`` heads and ``bodies`` bodies on a floor of 5 m x 3 m, and four anchors if wanted."""

    seed: int
    cameras: int = 5
    bodies: int = 10
    anchors: bool = False
    known_height: bool = False
    errors: Errors = field(default_factory=Errors)
    refine_lenses: bool = False
    motion: str = "floor"

    def __post_init__(self) -> None:
        self.rng = rng = np.random.default_rng(self.seed)
        self.places: dict[str, Transform] = {}
        for k in range(self.bodies):
            heading, (x, y) = rng.uniform(-math.pi, math.pi), rng.uniform([0.4, 0.4], [4.6, 2.6])
            self.places[f"b{k}"] = transform(rotation_z(heading), np.array([x, y, 0.0]))
        self.aims: dict[str, tuple[float, float]] = {}
        self.true_poses: dict[str, Transform] = {}
        self.true_lenses: dict[str, BrownLens] = {}
        heads, cameras = {}, {}
        for k in range(self.cameras):
            x, y, z = *rng.uniform([0.3, 0.3], [4.7, 2.7]), rng.uniform(2.5, 3.0)
            kinematics = PanTilt(transform(np.eye(3), np.array([x, y, z])))
            bias_rad = max(self.errors.pointing_rad, 1e-5)
            heads[f"h{k}"] = HeadSpec(f"h{k}", kinematics, (-4.0, 4.0), (-1.6, 0.2), 1.0, bias_sigma_rad=bias_rad)
            cameras[f"c{k}"] = CameraSpec(f"c{k}", LENS, HeadMount(f"h{k}", MOUNT), refine_lens=self.refine_lenses)
            self._turn(f"c{k}", kinematics)
            self.true_lenses[f"c{k}"] = self._lens()
        anchors = ((1.2, 0.8), (3.8, 0.8), (3.8, 2.2), (1.2, 2.2)) if self.anchors else ()
        self.rig = Rig(
            "floor",
            Space(),
            cameras,
            heads,
            {},
            {
                f"b{k}": Body(
                    f"b{k}",
                    (BodyTag(_key(k), SIZE_M, np.eye(4)),),
                    self.motion,
                    height_m=0.0 if self.known_height else None,
                )
                for k in range(self.bodies)
            },
            tuple(
                Anchor(_key(100 + k), SIZE_M, transform(np.eye(3), np.array([x, y, 0.0])))
                for k, (x, y) in enumerate(anchors)
            ),
        )

    def turn(self) -> None:
        """Aim every head at other bodies; what is wrong with where it points is drawn anew."""
        for k in range(self.cameras):
            self._turn(f"c{k}", self.rig.heads[f"h{k}"].kinematics)

    def _turn(self, name: str, kinematics: PanTilt) -> None:
        """Aim a head, and draw what is wrong with its pose."""
        before = self.aims.get(name, (math.inf, 0.0))
        aim = self._aim(kinematics.T_world_base)
        while math.dist(aim, before) < 0.02:  # the same bodies again
            aim = self._aim(kinematics.T_world_base)
        self.aims[name] = pan, tilt = aim
        off = self.rng.normal(size=2) * self.errors.pointing_rad
        T = kinematics.T_world_camera(pan + off[0], tilt + off[1], MOUNT)
        if self.errors.mounts:
            T = perturb(T, self.rng.normal(size=6) * np.sqrt(np.diag(MOUNT_COVARIANCE)))
        self.true_poses[name] = T

    def _aim(self, base: Transform) -> tuple[float, float]:
        """Look at the middle of some bodies."""
        names = self.rng.choice(list(self.places), size=min(4, self.bodies), replace=False)
        x, y, z = np.mean([self.places[name][:3, 3] for name in names], axis=0) - base[:3, 3]
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    def _lens(self) -> BrownLens:
        if not self.errors.lenses:
            return LENS
        f, cx, cy, k1 = self.rng.normal(size=4) * LENS_SIGMA
        return BrownLens(
            SIZE_PX, (827.7 * (1 + f), 827.9 * (1 + f)), (640.0 + cx, 400.0 + cy), (-0.336 + k1, 0.101, 0.0, 0.0, 0.0)
        )

    def histories(self) -> Histories:
        """Return what the heads say: where they were told to look, which is not quite where they do."""
        found = Histories()
        for k, (pan, tilt) in enumerate(self.aims.values()):
            for stamp_s in (0.9, 1.1):
                found = found.with_reading(AxisReading(f"h{k}", "pan", pan, stamp_s, 1e-5, 0.0))
                found = found.with_reading(AxisReading(f"h{k}", "tilt", tilt, stamp_s, 1e-5, 0.0))
        return found

    def views(self) -> list[View]:
        """Return what every camera that sees anything sees of it."""
        return [self.view(name) for name in self.rig.cameras]

    def view(
        self,
        camera_id: str,
        stamp_s: float = 1.0,
        noise: float = 1.0,
        rig: Rig | None = None,
        places: Mapping[str, Transform] | None = None,
    ) -> View:
        """Return what camrig makes of one camera's frame; ``rig`` is what it is told instead of the truth."""
        found = locate(self.detections(camera_id, stamp_s, noise, places), self.histories(), rig or self.rig, {})
        assert found.view is not None
        return found.view

    def detections(
        self, camera_id: str, stamp_s: float = 1.0, noise: float = 1.0, places: Mapping[str, Transform] | None = None
    ) -> TagDetections:
        """Return the tags that a camera shows, refined corners with the noise these have (times ``noise``)."""
        at = places or self.places
        T, lens = self.true_poses[camera_id], self.true_lenses[camera_id]
        found = [(tag.key, at[body.id]) for body in self.rig.targets.values() for tag in body.tags]
        found += [(anchor.key, anchor.T_world_tag) for anchor in self.rig.anchors]
        return detected(camera_id, stamp_s, 0, T, lens, found, self.rng, noise)


def detected(
    camera_id: str,
    stamp_s: float,
    number: int,
    T_world_camera: Transform,
    lens: BrownLens,
    tags: Iterable[tuple[TagKey, Transform]],
    rng: np.random.Generator,
    noise: float = 1.0,
    again: Mapping[TagKey, Array] | None = None,
) -> TagDetections:
    """Return the tags (number and true ``T_world_tag``) that a camera truly there, with that lens, shows.

    ``again`` (4, 2) is the part of a tag's corner noise, in its sigma, that comes again in every frame: where it is
    given, the rest is drawn with ``1 - REPEATING`` of the variance.
    """
    fresh = noise if again is None else noise * math.sqrt(1.0 - REPEATING)
    found = []
    for key, T_world_tag in tags:
        corners = _project(lens, apply(invert(T_world_camera) @ T_world_tag, SIZE_M * TAG_CORNERS))
        if corners is None:
            continue
        sigma = float(refined_sigma_px(tag_width_px(corners)))
        corners = corners + sigma * (rng.normal(size=(4, 2)) * fresh + (0.0 if again is None else again[key]))
        found.append(TagDetection(key, corners, tuple(corners.mean(axis=0)), 0, 80.0, (True,) * 4))
    return TagDetections(camera_id, stamp_s, number, SIZE_PX, tuple(found), 0.0)


def _project(lens: BrownLens, points: Array) -> Array | None:
    if (points[:, 2] < 0.1).any() or (np.hypot(*points[:, :2].T) > 0.95 * points[:, 2]).any():
        return None
    K = np.array(
        [[lens.focal_px[0], 0.0, lens.centre_px[0]], [0.0, lens.focal_px[1], lens.centre_px[1]], [0.0, 0.0, 1.0]]
    )
    pixels = np.asarray(
        cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(lens.distortion))[0][:, 0], float
    )
    if (pixels < 8).any() or (pixels > np.array(SIZE_PX) - 8).any() or float(tag_width_px(pixels)) < MIN_WIDTH_PX:
        return None
    return pixels


def _key(number: int) -> TagKey:
    return TagKey("tag36h11", number)
