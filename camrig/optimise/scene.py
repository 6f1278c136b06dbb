"""What is planned: cameras with their places and limits, targets, settings. Frozen, SI and radians, world frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pan_tilt import PanTilt
from camrig.messages import Aim, DroneAim, HeadAim, PlanRequest, PlanTarget
from camrig.rig import Box, CameraSpec, DroneMount, FixedMount, HeadMount, Interval, Rig

Quality = Literal["pixel"]
Visibility = Literal["cone", "image"]
Objective = Literal["mean"]


@dataclass(frozen=True, slots=True, eq=False)
class HeadPlace:
    """A camera on a pan-tilt head; plans choose (pan, tilt) within the limits."""

    kinematics: PanTilt
    T_mount_camera: Transform
    pan_limits_rad: Interval
    tilt_limits_rad: Interval


@dataclass(frozen=True, slots=True, eq=False)
class DronePlace:
    """A camera under a drone; plans choose its (x, y, z) in the box, the body's yaw stays ``yaw_rad``."""

    T_body_camera: Transform
    box_m: Box
    min_separation_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FixedPlace:
    """A camera bolted to the room; it counts, and plans choose nothing."""

    T_world_camera: Transform


Place = HeadPlace | DronePlace | FixedPlace


@dataclass(frozen=True, slots=True, eq=False)
class SceneCamera:
    """A camera of a scene; ``alpha_rad`` is its half angle under ``cone`` where it is not the lens's own."""

    id: str
    lens: Lens
    place: Place
    alpha_rad: float | None = None


@dataclass(frozen=True, slots=True)
class SceneTarget:
    """A point, or with ``tag_size_m`` a square tag turned by ``facing_rad`` about its normal (sensing.tag_corners)."""

    id: str
    position_m: tuple[float, float, float]
    tag_size_m: float | None = None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    facing_rad: float = 0.0
    weight: float = 1.0
    reach_m: float = 0.0
    """A tag counts as seen under ``image`` only if the picture also shows this much around it: it may move."""


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How a scene is planned; the defaults are the paper's problem.

    ``min_tag_px`` and ``max_incidence_rad`` say when a tag counts as detectable under ``image``. A plan that starts
    from running aims moves cameras only for ``gain``, a share of the objective, or for more coverage.
    """

    quality: Quality = "pixel"
    visibility: Visibility = "cone"
    objective: Objective = "mean"
    margin_rad: float = 0.0
    min_separation_m: float = 0.0
    min_tag_px: float = 0.0
    max_incidence_rad: float = math.pi / 2.0
    gain: float = 0.0
    reach_s: float = math.inf
    """How far a running rig plans: places that a head or drone would take longer to reach are not considered, since a
    target promised to a camera that is still on its way is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One planning problem; ``keep_out_m`` boxes block sight, and no drone enters them."""

    cameras: tuple[SceneCamera, ...]
    targets: tuple[SceneTarget, ...]
    settings: PlannerSettings = field(default_factory=PlannerSettings)
    keep_out_m: tuple[Box, ...] = ()


def scene_of(rig: Rig, request: PlanRequest, settings: PlannerSettings) -> Scene:
    """Return the scene of a running rig: the cameras that are available, the targets as the request has them.

    Hand-carried cameras take no part. A drone keeps the yaw of ``request.aims``. Raises InputError for a camera that
    the rig does not have.
    """
    unknown = sorted(set(request.available) - set(rig.cameras))
    if unknown:
        raise InputError(f"the plan request names cameras the rig does not have: {', '.join(unknown)}")
    places = {
        name: _place(rig, rig.cameras[name], request.aims, 0.0 if name in request.fixed else settings.reach_s)
        for name in request.available
    }
    cameras = [SceneCamera(name, rig.cameras[name].lens, place) for name, place in places.items() if place is not None]
    targets = tuple(_scene_target(target) for target in request.targets)
    return Scene(tuple(cameras), targets, settings, rig.space.keep_out_m)


def with_yaws(scene: Scene, aims: Mapping[str, Aim]) -> Scene:
    """Return the scene with every drone at the yaw that ``aims`` gives it."""
    cameras = []
    for camera in scene.cameras:
        aim = aims.get(camera.id)
        if isinstance(camera.place, DronePlace) and isinstance(aim, DroneAim):
            cameras.append(replace(camera, place=replace(camera.place, yaw_rad=aim.yaw_rad)))
        else:
            cameras.append(camera)
    return replace(scene, cameras=tuple(cameras))


def _place(rig: Rig, camera: CameraSpec, aims: Mapping[str, Aim], reach_s: float) -> Place | None:
    aim = aims.get(camera.id)
    match camera.mount:
        case HeadMount(head=name, T_mount_camera=T_mount_camera):
            head = rig.heads[name]
            pan, tilt = head.pan_limits_rad, head.tilt_limits_rad
            if isinstance(aim, HeadAim):
                reach_rad = head.speed_rad_s * reach_s
                pan, tilt = _near(pan, aim.pan_rad, reach_rad), _near(tilt, aim.tilt_rad, reach_rad)
            return HeadPlace(head.kinematics, T_mount_camera, pan, tilt)
        case DroneMount(drone=name, T_body_camera=T_body_camera):
            drone = rig.drones[name]
            if not isinstance(aim, DroneAim):
                return DronePlace(T_body_camera, drone.box_m, drone.min_separation_m)
            axes = zip(*drone.box_m, aim.position_m, strict=True)
            low, high = zip(*(_near((a, b), at, drone.speed_m_s * reach_s) for a, b, at in axes), strict=True)
            return DronePlace(T_body_camera, (low, high), drone.min_separation_m, aim.yaw_rad)
        case FixedMount(T_world_camera=T_world_camera):
            return FixedPlace(T_world_camera)
        case _:
            return None


def _near(limits: Interval, at: float, reach: float) -> Interval:
    """Return the part of an interval within reach of a place; where nothing is, the end that is nearest."""
    low, high = limits
    return min(max(low, at - reach), high), max(min(high, at + reach), low)


def _scene_target(target: PlanTarget) -> SceneTarget:
    return SceneTarget(
        target.id,
        target.position_m,
        target.tag_size_m,
        target.normal,
        weight=target.weight,
        reach_m=target.reach_m,
    )
