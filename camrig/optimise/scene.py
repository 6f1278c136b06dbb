"""What is planned: cameras with their places and limits, targets, settings. Frozen, SI and radians, world frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.tags import tag_corners
from camrig.messages import Aim, DroneAim, HeadAim, PlanRequest, PlanTarget
from camrig.rig import Anchor, Box, CameraSpec, DroneMount, FixedMount, HeadMount, Interval, Rig

Quality = Literal["pixel", "fisher", "perspective"]
Visibility = Literal["cone", "image"]
Objective = Literal["mean", "worst"]


@dataclass(frozen=True, slots=True, eq=False)
class HeadPlace:
    """A camera on a pan-tilt head; plans choose (pan, tilt) within the limits.

    ``mount_m``: a box, as thin as a wall or a ceiling, in which plans also choose where the head is mounted.
    """

    kinematics: PanTilt
    T_mount_camera: Transform
    pan_limits_rad: Interval
    tilt_limits_rad: Interval
    mount_m: Box | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DronePlace:
    """A camera under a drone; plans choose its (x, y, z) in the box, and its body's yaw where the limits leave it free.

    Without limits the yaw stays ``yaw_rad``.
    """

    T_body_camera: Transform
    box_m: Box
    min_separation_m: float = 0.0
    yaw_rad: float = 0.0
    yaw_limits_rad: Interval | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FixedPlace:
    """A camera bolted to the room; it counts, and plans choose nothing."""

    T_world_camera: Transform


Place = HeadPlace | DronePlace | FixedPlace


@dataclass(frozen=True, slots=True)
class PoseSigma:
    """One sigma of what a camera's pose is uncertain by: place, turn about any axis, and its head's pan and tilt."""

    position_m: float = 0.001
    attitude_rad: float = 0.0005
    pan_rad: float = 0.0
    tilt_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ZoomStep:
    """One row of a zoom table: the lens at a position of the zoom."""

    position: float
    lens: Lens


@dataclass(frozen=True, slots=True, eq=False)
class SceneCamera:
    """A camera of a scene; ``alpha_rad`` is its half angle under ``cone`` where it is not the lens's own.

    ``zoom``: plans also choose the zoom, anywhere in this table; ``lens`` is then its first row's.
    ``needs_anchor``: it must have an anchor in view wherever it looks or hovers.
    """

    id: str
    lens: Lens
    place: Place
    alpha_rad: float | None = None
    pose_sigma: PoseSigma = PoseSigma()
    zoom: tuple[ZoomStep, ...] = ()
    needs_anchor: bool = False


@dataclass(frozen=True, slots=True)
class SceneTarget:
    """A point, or with ``tag_size_m`` a square tag turned by ``facing_rad`` about its normal (geometry.tags)."""

    id: str
    position_m: tuple[float, float, float]
    tag_size_m: float | None = None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    facing_rad: float = 0.0
    weight: float = 1.0
    reach_m: float = 0.0
    """A tag counts as seen under ``image`` only if the picture also shows this much around it: it may move."""


@dataclass(frozen=True, slots=True)
class SceneAnchor:
    """A tag fixed in the room: cameras that see it know their pose better."""

    position_m: tuple[float, float, float]
    tag_size_m: float
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    facing_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How a scene is planned; the defaults are the paper's problem.

    ``min_tag_px``, ``max_incidence_rad`` and ``max_range_m`` say when a target counts as detectable. A plan that starts
    from running aims moves cameras only for ``gain``, a share of the objective, or for more coverage; a second of a
    camera's motion must besides bring ``motion_cost_per_s`` of the objective.
    """

    quality: Quality = "pixel"
    visibility: Visibility = "cone"
    objective: Objective = "mean"
    margin_rad: float = 0.0
    min_separation_m: float = 0.0
    min_tag_px: float = 0.0
    max_incidence_rad: float = math.pi / 2.0
    max_range_m: float = math.inf
    gain: float = 0.0
    motion_cost_per_s: float = 0.0
    refined_corners: bool = False
    """Whether tags' corners are refined through the lens, as those of a running rig are unless its file says no: what
    their noise is (quality ``fisher``).
    """
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
    anchors: tuple[SceneAnchor, ...] = ()


def scene_of(rig: Rig, request: PlanRequest, settings: PlannerSettings) -> Scene:
    """Return the scene of a running rig: the cameras that are available, the targets as the request has them.

    Hand-carried cameras take no part. A drone keeps the yaw of ``request.aims``. Raises InputError for a camera that
    the rig does not have.
    """
    unknown = sorted(set(request.available) - set(rig.cameras))
    if unknown:
        raise InputError(f"the plan request names cameras the rig does not have: {', '.join(unknown)}")
    cameras = [
        _camera(rig, rig.cameras[name], request.aims, 0.0 if name in request.fixed else settings.reach_s)
        for name in request.available
    ]
    return Scene(
        cameras=tuple(camera for camera in cameras if camera is not None),
        targets=tuple(_scene_target(target) for target in request.targets),
        settings=settings,
        keep_out_m=rig.space.keep_out_m,
        anchors=tuple(_scene_anchor(anchor) for anchor in rig.anchors),
    )


def kind(camera: SceneCamera) -> object:
    """Return what identical drones share, whatever their yaw; other cameras are of their own kind."""
    place = camera.place
    if not isinstance(place, DronePlace):
        return camera.id
    return (
        repr(camera.lens),  # a lens is a frozen dataclass: its repr is all it is
        camera.alpha_rad,
        camera.pose_sigma,
        repr(camera.zoom),
        camera.needs_anchor,
        place.min_separation_m,
        place.box_m,
        place.yaw_limits_rad,
        place.T_body_camera.tobytes(),
    )


def with_yaws(scene: Scene, aims: Mapping[str, Aim]) -> Scene:
    """Return the scene with every drone at the yaw that ``aims`` gives it, where plans do not choose it."""
    cameras = []
    for camera in scene.cameras:
        aim = aims.get(camera.id)
        if isinstance(camera.place, DronePlace) and isinstance(aim, DroneAim):
            cameras.append(replace(camera, place=replace(camera.place, yaw_rad=aim.yaw_rad)))
        else:
            cameras.append(camera)
    return replace(scene, cameras=tuple(cameras))


def speeds_of(rig: Rig) -> dict[str, float]:
    """Return how fast every camera that moves turns (rad/s) or flies (m/s), by its id."""
    speeds = {}
    for camera in rig.cameras.values():
        match camera.mount:
            case HeadMount(head=name):
                speeds[camera.id] = rig.heads[name].speed_rad_s
            case DroneMount(drone=name):
                speeds[camera.id] = rig.drones[name].speed_m_s
    return speeds


def _camera(rig: Rig, camera: CameraSpec, aims: Mapping[str, Aim], reach_s: float) -> SceneCamera | None:
    aim = aims.get(camera.id)
    match camera.mount:
        case HeadMount(head=name, T_mount_camera=T_mount_camera):
            head = rig.heads[name]
            pan, tilt = head.pan_limits_rad, head.tilt_limits_rad
            if isinstance(aim, HeadAim):
                reach_rad = head.speed_rad_s * reach_s
                pan, tilt = _near(pan, aim.pan_rad, reach_rad), _near(tilt, aim.tilt_rad, reach_rad)
            place: Place = HeadPlace(head.kinematics, T_mount_camera, pan, tilt)
            sigma = PoseSigma(pan_rad=head.bias_sigma_rad, tilt_rad=head.bias_sigma_rad)
            return SceneCamera(camera.id, camera.lens, place, pose_sigma=sigma, needs_anchor=head.needs_anchor)
        case DroneMount(drone=name, T_body_camera=T_body_camera):
            drone = rig.drones[name]
            yaw_limits_rad = drone.yaw_limits_rad if reach_s > 0.0 else None
            place = DronePlace(T_body_camera, drone.box_m, drone.min_separation_m, 0.0, yaw_limits_rad)
            if isinstance(aim, DroneAim):
                axes = zip(*drone.box_m, aim.position_m, strict=True)
                low, high = zip(*(_near((a, b), at, drone.speed_m_s * reach_s) for a, b, at in axes), strict=True)
                place = replace(place, box_m=(low, high), yaw_rad=aim.yaw_rad)
            sigma = PoseSigma(drone.position_sigma_m, drone.attitude_sigma_rad)
            return SceneCamera(camera.id, camera.lens, place, pose_sigma=sigma, needs_anchor=drone.needs_anchor)
        case FixedMount(T_world_camera=T_world_camera):
            return SceneCamera(camera.id, camera.lens, FixedPlace(T_world_camera))
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


def _scene_anchor(anchor: Anchor) -> SceneAnchor:
    R, (x, y, z) = anchor.T_world_tag[:3, :3], anchor.T_world_tag[:3, 3].tolist()
    a, b, c = R[:, 2].tolist()
    level = tag_corners(np.zeros(3), R[:, 2], 0.0, 1.0)
    x_axis, y_axis = level[1] - level[0], level[3] - level[0]
    facing_rad = math.atan2(float(R[:, 0] @ y_axis), float(R[:, 0] @ x_axis))
    return SceneAnchor((x, y, z), anchor.size_m, (a, b, c), facing_rad)
