"""The rooms of the paper's first table, as rigs: cameras, bodies with tags on the floor, anchors, and what is wrong.

Drawn from a place and what is wrong alone. A room with anchors is the same room without them, and every configuration
of one room has the same errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from camrig.experiments.scenes import FLIGHT_BOX_M, FLOOR_M, HEIGHTS_M, LAB_LENS, PAN_RAD, TILT_RAD, Place
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.lens.errors import TYPICAL_SIGMA
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import perturb, transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.rig import Anchor, Body, BodyTag, CameraSpec, DroneMount, DroneSpec, HeadMount, HeadSpec, Rig, Space, TagKey

TAG_SIZE_M = 0.16
FAMILY = "tag36h11"
ANCHORS_M = ((1.2, 0.8), (3.8, 0.8), (3.8, 2.2), (1.2, 2.2))
FIRST_ANCHOR = 500
"""The number of the first anchor's tag; bodies' tags count from 0."""

_APART_M = 0.3
"""Middles of tags are at least so far apart: plates of 0.2 m must not lie upon each other."""
_FROM_WALL_M = 0.1
_TRIES = 10_000
_KNOWN_RAD, _KNOWN_M = 1e-5, 1e-5
"""One sigma of what is known exactly: no covariance may be singular."""

MOUNT = transform(R_MOUNT_OPTICAL, np.zeros(3))
BELOW = transform(R_BODY_OPTICAL_DOWN, np.zeros(3))


@dataclass(frozen=True, slots=True)
class Wrong:
    """One sigma of what is wrong with a rig: pan and tilt of heads and attitude of drones, drones' positions, and
    whether lenses are off by what a calibration leaves (geometry.lens.errors).
    """

    pointing_rad: float = 0.0
    position_m: float = 0.0
    lenses: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors:
    """What is wrong with one camera: pan and tilt (2,), or the pose of its drone (6,); and its true lens."""

    angles_rad: Array
    pose: Array
    lens: BrownLens


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A rig as camrig is told of it, where its bodies truly are, and what is wrong with its cameras, by id."""

    place: Place
    rig: Rig
    bodies: Mapping[str, Transform]
    wrong: Wrong
    errors: Mapping[str, CameraErrors]

    def believed_pose(self, camera_id: str, aim: Aim) -> Transform:
        """Return ``T_world_camera`` of a camera at an aim if nothing were wrong."""
        return self._pose(camera_id, aim, np.zeros(2), np.zeros(6))

    def true_pose(self, camera_id: str, aim: Aim) -> Transform:
        """Return ``T_world_camera`` of a camera that is believed to be at an aim."""
        errors = self.errors[camera_id]
        return self._pose(camera_id, aim, errors.angles_rad, errors.pose)

    def _pose(self, camera_id: str, aim: Aim, angles_rad: Array, delta: Array) -> Transform:
        match aim:
            case HeadAim(pan_rad=pan_rad, tilt_rad=tilt_rad):
                head = self.rig.heads[camera_id]
                return head.kinematics.T_world_camera(pan_rad + angles_rad[0], tilt_rad + angles_rad[1], MOUNT)
            case DroneAim():
                return perturb(body_pose(aim), delta) @ BELOW


def body_pose(aim: DroneAim) -> Transform:
    """Return ``T_world_body`` of a drone that hovers as it should."""
    return transform(rotation_z(aim.yaw_rad), np.asarray(aim.position_m))


def draw_room(place: Place, wrong: Wrong, *, anchors: bool) -> Room:
    """Draw a room of the paper's size: heads 2.5 m to 3 m up, or drones; bodies on the floor, turned at random."""
    rng = np.random.default_rng([place.seed, place.cameras, place.targets, place.mode == "drone"])
    mounts_m = rng.uniform((0.0, 0.0, HEIGHTS_M[0]), (*FLOOR_M, HEIGHTS_M[1]), size=(place.cameras, 3))
    bodies = {f"t{k + 1}": T for k, T in enumerate(_bodies(place.targets, rng))}
    rig = _rig(place, mounts_m, wrong)
    if anchors:
        rig = replace(rig, anchors=_anchors())
    errors_rng = np.random.default_rng([place.seed, place.cameras, place.targets, place.mode == "drone", 1])
    errors = {name: _errors(wrong, errors_rng) for name in rig.cameras}
    return Room(place, rig, bodies, wrong, errors)


def _bodies(count: int, rng: np.random.Generator) -> list[Transform]:
    """Return where bodies stand, apart from each other and from where anchors may lie."""
    taken = list(np.asarray(ANCHORS_M))
    low, high = np.full(2, _FROM_WALL_M), np.asarray(FLOOR_M) - _FROM_WALL_M
    found: list[Transform] = []
    for _ in range(_TRIES):
        if len(found) == count:
            return found
        at, heading_rad = rng.uniform(low, high), rng.uniform(-math.pi, math.pi)
        if np.linalg.norm(np.asarray(taken) - at, axis=1).min() >= _APART_M:
            taken.append(at)
            found.append(transform(rotation_z(heading_rad), np.append(at, 0.0)))
    raise AssertionError(f"{count} bodies find no room on the floor")


def _rig(place: Place, mounts_m: Array, wrong: Wrong) -> Rig:
    cameras, heads, drones = {}, {}, {}
    for k, mount_m in enumerate(mounts_m):
        if place.mode == "ptz":
            name = f"c{k + 1}"
            heads[name] = HeadSpec(
                name,
                PanTilt(transform(np.eye(3), mount_m)),
                PAN_RAD,
                TILT_RAD,
                speed_rad_s=1.0,
                bias_sigma_rad=max(wrong.pointing_rad, _KNOWN_RAD),
            )
            cameras[name] = CameraSpec(name, LAB_LENS, HeadMount(name, MOUNT))
        else:
            name = f"d{k + 1}"
            drones[name] = DroneSpec(
                name,
                FLIGHT_BOX_M,
                min_separation_m=0.0,
                speed_m_s=1.0,
                position_sigma_m=max(wrong.position_m, _KNOWN_M),
                attitude_sigma_rad=max(wrong.pointing_rad, _KNOWN_RAD),
            )
            cameras[name] = CameraSpec(name, LAB_LENS, DroneMount(name, BELOW))
    targets = {
        f"t{k + 1}": Body(f"t{k + 1}", (BodyTag(TagKey(FAMILY, k), TAG_SIZE_M, np.eye(4)),), "drives")
        for k in range(place.targets)
    }
    return Rig("table1", Space(((0.0, 0.0), FLOOR_M)), cameras, heads, drones, targets)


def _anchors() -> tuple[Anchor, ...]:
    return tuple(
        Anchor(TagKey(FAMILY, FIRST_ANCHOR + k), TAG_SIZE_M, transform(np.eye(3), np.array([x, y, 0.0])))
        for k, (x, y) in enumerate(ANCHORS_M)
    )


def _errors(wrong: Wrong, rng: np.random.Generator) -> CameraErrors:
    """Draw one camera's errors; as many numbers are drawn whatever is wrong, so that rooms differ in that alone."""
    angles, position, attitude = rng.normal(size=2), rng.normal(size=3), rng.normal(size=3)
    of_lens = rng.normal(size=4) * TYPICAL_SIGMA
    pose = np.concatenate([position * wrong.position_m, attitude * wrong.pointing_rad])
    return CameraErrors(angles * wrong.pointing_rad, pose, _off(of_lens) if wrong.lenses else LAB_LENS)


def _off(errors: Array) -> BrownLens:
    """Return the lab lens off by [relative focal length, cx, cy, k1]."""
    longer, right, down, bent = (float(each) for each in errors)
    fx, fy = LAB_LENS.focal_px
    cx, cy = LAB_LENS.centre_px
    k1, *others = LAB_LENS.distortion
    return BrownLens(
        LAB_LENS.size_px,
        (fx * (1.0 + longer), fy * (1.0 + longer)),
        (cx + right, cy + down),
        (k1 + bent, *others),
    )
