"""Does predicted quality predict real error? Single cameras that look at a floor full of tags, aimed at random.

Every tag of every picture is one sighting: what each model promises of it, and how far off its pose is, found from this
picture alone through the exact lens from the exact place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np

from camrig.experiments.estimators import single_poses
from camrig.experiments.photographs import Photograph, photograph
from camrig.experiments.rooms import TAG_SIZE_M, Room, Wrong, draw_room
from camrig.experiments.scenes import FLOOR_M, HEIGHTS_M, LAB_LENS, TILT_RAD, Mode, Place
from camrig.geometry.arrays import Transform
from camrig.geometry.rotation import yaw_of
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.optimise import FixedPlace, PlannerSettings, PoseSigma, Scene, SceneCamera, SceneTarget, quality_at
from camrig.optimise.scene import Quality

MODES: tuple[Mode, ...] = get_args(Mode)
TAGS = 25
Corners = Literal["detected", "refined"]
CORNERS: tuple[Corners, ...] = get_args(Corners)
QUALITIES: tuple[Quality, ...] = ("pixel", "perspective", "fisher")

_EXACT = PoseSigma(1e-7, 1e-7)
_SPREAD_M = 0.8
"""Heads look at places about the middle of the floor: at a wall there is nothing to see."""


@dataclass(frozen=True, slots=True)
class Setup:
    """``pictures`` of heads and as many of drones, seeds from ``seed`` on."""

    pictures: int = 40
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Job:
    """One picture."""

    mode: Mode
    seed: int

    @property
    def key(self) -> str:
        """Its name among kept results."""
        return f"{self.mode} {self.seed}"


@dataclass(frozen=True, slots=True)
class Sighted:
    """One tag of one picture: what is promised (m) by corners and model, and its error [x, y, z] (m) by corners."""

    mode: Mode
    seed: int
    tag: str
    promised_m: dict[Corners, dict[Quality, float]]
    error_m: dict[Corners, list[float]]
    position_m: list[float]


def jobs(setup: Setup) -> Iterator[Job]:
    """Yield all pictures."""
    for mode in MODES:
        for seed in range(setup.seed, setup.seed + setup.pictures):
            yield Job(mode, seed)


def work(job: Job) -> list[dict[str, Any]]:
    """Take a picture and find every tag in it; sightings come as they are kept."""
    room = draw_room(Place(job.mode, 1, TAGS, job.seed), Wrong(), anchors=False)
    (camera_id,) = room.rig.cameras
    aim = _random_aim(room, camera_id, job)
    seen = photograph(room, camera_id, aim)
    found = {corners: _positions(room, camera_id, aim, seen, corners) for corners in CORNERS}
    promised = {corners: _promised(room, room.true_pose(camera_id, aim), corners) for corners in CORNERS}
    sightings = []
    for name, T_world_body in room.bodies.items():
        if all(name in found[corners] and name in promised[corners] for corners in CORNERS):
            position = T_world_body[:3, 3]
            sightings.append(
                Sighted(
                    job.mode,
                    job.seed,
                    name,
                    promised_m={corners: promised[corners][name] for corners in CORNERS},
                    error_m={corners: (found[corners][name] - position).tolist() for corners in CORNERS},
                    position_m=position.tolist(),
                )
            )
    return [asdict(each) for each in sightings]


def _random_aim(room: Room, camera_id: str, job: Job) -> Aim:
    rng = np.random.default_rng([job.seed, 7])
    middle = np.asarray(FLOOR_M) / 2.0
    if job.mode == "drone":
        x, y = rng.uniform((0.5, 0.5), np.asarray(FLOOR_M) - 0.5)
        return DroneAim((float(x), float(y), float(rng.uniform(1.0, HEIGHTS_M[1]))))
    x, y = middle + rng.uniform(-_SPREAD_M, _SPREAD_M, size=2)
    dx, dy, dz = np.array([x, y, 0.0]) - room.rig.heads[camera_id].kinematics.T_world_base[:3, 3]
    return HeadAim(math.atan2(dy, dx), max(math.atan2(dz, math.hypot(dx, dy)), TILT_RAD[0]))


def _positions(room: Room, camera_id: str, aim: Aim, seen: Photograph, corners: Corners) -> dict[str, Any]:
    tags = seen.detected if corners == "detected" else seen.refined
    poses = single_poses(room, {camera_id: aim}, {camera_id: tags})
    return {name: each[0].position_m for name, each in poses.items()}


def _promised(room: Room, T_world_camera: Transform, corners: Corners) -> Mapping[str, dict[Quality, float]]:
    """Return what each model says of every tag that is in the picture, in metres, with a camera that is exact."""
    targets = tuple(
        SceneTarget(name, (float(T[0, 3]), float(T[1, 3]), float(T[2, 3])), TAG_SIZE_M, facing_rad=yaw_of(T[:3, :3]))
        for name, T in room.bodies.items()
    )
    camera = SceneCamera("camera", LAB_LENS, FixedPlace(T_world_camera), pose_sigma=_EXACT)
    found: dict[str, dict[Quality, float]] = {}
    for quality in QUALITIES:
        settings = PlannerSettings(quality=quality, visibility="image", refined_corners=corners == "refined")
        plan = quality_at(Scene((camera,), targets, settings), {})
        for name, promise in plan.targets.items():
            if promise.quality_m is not None:
                found.setdefault(name, {})[quality] = promise.quality_m
    return found
