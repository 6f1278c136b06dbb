"""How well each pose of a camera sees each target: the gains V/Q that everything else adds up. Vectorised, pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camrig import sensing
from camrig.geometry.airspace import blocked
from camrig.geometry.arrays import Array
from camrig.optimise.places import camera_poses
from camrig.optimise.scene import PlannerSettings, Scene, SceneCamera, SceneTarget
from camrig.rig import Box
from camrig.sensing.visibility import Flags

Indices = npt.NDArray[np.intp]

NEAR_M = 0.05
"""Nothing nearer in front of a lens counts as seen; keeps Q away from 0."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetArrays:
    """The targets as arrays: points (m, 3), corners (m, 4, 3), unit normals (m, 3), weights and tagged (m,).

    A target without a tag's size has its point four times as its corners.
    """

    points_m: Array
    corners_m: Array
    room_m: Array
    """The corners of the square that must be in the picture: the tag, and as far around it as it may move."""
    normals: Array
    weights: Array
    tagged: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A scene made ready for evaluation."""

    cameras: tuple[SceneCamera, ...]
    targets: TargetArrays
    settings: PlannerSettings
    keep_out_m: tuple[Box, ...]


def problem_of(scene: Scene) -> Problem:
    """Prepare a scene; under ``cone`` a target is a point."""
    points = np.array([target.position_m for target in scene.targets], dtype=float).reshape(-1, 3)
    normals = np.array([target.normal for target in scene.targets], dtype=float).reshape(-1, 3)
    image = scene.settings.visibility == "image"
    arrays = TargetArrays(
        points_m=points,
        corners_m=np.array([_corners(target, 0.0) for target in scene.targets]).reshape(-1, 4, 3),
        room_m=np.array([_corners(target, target.reach_m) for target in scene.targets]).reshape(-1, 4, 3),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        weights=np.array([target.weight for target in scene.targets], dtype=float),
        tagged=np.array([image and target.tag_size_m is not None for target in scene.targets], dtype=bool),
    )
    return Problem(scene.cameras, arrays, scene.settings, scene.keep_out_m)


def gains(problem: Problem, camera: SceneCamera, vectors: Array) -> Array:
    """Return (K, m) gains V/Q in 1/m of (K, d) vectors of a camera: 0 where a target is not seen."""
    R, origins = camera_poses(camera.place, vectors)
    points = _in_camera(R, origins, problem.targets.points_m)
    pose, target = np.nonzero(_roughly_seen(problem, camera, points))
    seen = _seen(problem, camera, R[pose], origins[pose], points[pose, target], target)
    pose, target = pose[seen], target[seen]
    out = np.zeros(points.shape[:2])
    out[pose, target] = 1.0 / sensing.pixel_quality(camera.lens, points[pose, target])
    return out


def alpha_rad(camera: SceneCamera) -> float:
    """Return the half angle of the camera's cone."""
    return sensing.half_angle(camera.lens) if camera.alpha_rad is None else camera.alpha_rad


def _corners(target: SceneTarget, around_m: float) -> Array:
    position = np.array(target.position_m, dtype=float)
    if target.tag_size_m is None:
        return np.tile(position, (4, 1))
    side_m = target.tag_size_m + 2.0 * around_m
    return sensing.tag_corners(position, np.array(target.normal, dtype=float), target.facing_rad, side_m)


def _in_camera(R: Array, origins: Array, points_m: Array) -> Array:
    """Return (K, m, 3) optical-frame points of (m, 3) world points in K camera poses."""
    return np.asarray(points_m @ R - (origins[:, None, :] @ R))


def _roughly_seen(problem: Problem, camera: SceneCamera, points: Array) -> Flags:
    """Tell which (K, m) pairs may be seen: ahead, within r_max, and in the cone where that is the visibility."""
    radius2 = points[..., 0] ** 2 + points[..., 1] ** 2
    rough = (points[..., 2] > NEAR_M) & (radius2 <= (camera.lens.r_max * points[..., 2]) ** 2 * (1.0 + 1e-9))
    if problem.settings.visibility == "image":
        return np.asarray(rough)
    margin_rad = problem.settings.margin_rad
    pose, target = np.nonzero(rough)
    rough[pose, target] = sensing.in_cone(camera.lens, points[pose, target], alpha_rad(camera), margin_rad)
    return np.asarray(rough)


def _seen(problem: Problem, camera: SceneCamera, R: Array, origins: Array, points: Array, target: Indices) -> Flags:
    """Tell which of N roughly seen pairs are seen: R (N, 3, 3), origins and optical-frame points (N, 3)."""
    seen = np.ones(len(target), dtype=bool)
    if problem.settings.visibility == "image":
        seen = sensing.in_image(camera.lens, points)
        tagged = problem.targets.tagged[target]
        tags = np.flatnonzero(seen & tagged)
        seen[tags] = _tag_seen(problem, camera, R[tags], origins[tags], target[tags])
        if problem.settings.margin_rad > 0.0:
            lone = np.flatnonzero(seen & ~tagged)
            seen[lone] = sensing.in_image(camera.lens, points[lone], problem.settings.margin_rad)
    if problem.keep_out_m:
        seen &= ~blocked(origins, problem.targets.points_m[target], problem.keep_out_m)
    return seen


def _tag_seen(problem: Problem, camera: SceneCamera, R: Array, origins: Array, target: Indices) -> Flags:
    """Tell which of N tags are seen: from their front, wholly on the image wherever they may move, large enough."""
    settings, targets = problem.settings, problem.targets
    to_camera = origins - targets.points_m[target]
    facing = (to_camera * targets.normals[target]).sum(axis=1) / np.linalg.norm(to_camera, axis=1)
    room = (targets.room_m[target] - origins[:, None, :]) @ R
    inside = sensing.in_image(camera.lens, room, settings.margin_rad).all(axis=1)
    seen = (facing > np.cos(settings.max_incidence_rad)) & inside
    if settings.min_tag_px > 0.0:
        tags = np.flatnonzero(seen)
        corners = (targets.corners_m[target[tags]] - origins[tags, None, :]) @ R[tags]
        seen[tags] = sensing.tag_side_px(camera.lens, corners) >= settings.min_tag_px
    return np.asarray(seen)
