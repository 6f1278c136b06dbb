"""A plan looked at: where each of its cameras is and what lens it has there, and how well it would sense other places.

Pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.lens_row import ALPHA, R_MAX, lens_from_row
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.pose import transform
from camrig.messages import RigPlan
from camrig.optimise.configuration import configuration, task_of
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import NORMAL, POINT
from camrig.optimise.places import vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import HeadPlace, Scene, SceneTarget

_PAIRS = 4_000_000
"""Of a camera and a place, looked at together: what bounds the memory of a map."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera as a plan has it: its lens at the zoom it has, and the half angle of its cone."""

    id: str
    T_world_camera: Transform
    lens: Lens
    alpha_rad: float


def views(scene: Scene, plan: RigPlan) -> tuple[View, ...]:
    """Return the scene's cameras as the plan has them. Raises InputError for a camera that it has no aim for."""
    scene = mounted(scene, plan.mounts)
    problem, found = problem_of(scene), []
    for camera, row, vector in zip(scene.cameras, problem.cameras, _vectors(scene, plan), strict=True):
        lens = lens_of(row, problem.lenses, vector)
        alpha_rad = min(float(lens[ALPHA]), float(np.arctan(lens[R_MAX])))
        found.append(View(camera.id, transform(*pose_of(row, vector)), lens_from_row(lens), alpha_rad))
    return tuple(found)


def quality_map(scene: Scene, plan: RigPlan, xs: Array, ys: Array) -> Array:
    """Return (len(ys), len(xs)) metres: the fused quality of a target at each place; infinite where nobody sees it.

    It lies face up at the median height of the scene's targets and, if they have tags, has a tag of their median size.
    """
    scene = mounted(scene, plan.mounts)
    vectors = _vectors(scene, plan)
    problem = problem_of(replace(scene, targets=(_another(scene),)))
    x, y = (grid.ravel() for grid in np.meshgrid(xs, ys))
    quality_m = np.empty(len(x))
    step = max(1, _PAIRS // max(1, len(scene.cameras)))
    for first in range(0, len(x), step):
        part = slice(first, first + step)
        offset = np.column_stack([x[part], y[part], np.zeros(len(x[part]))])
        targets = np.repeat(problem.targets, len(offset), axis=0)
        # What stands before the normal are points: the centre, the tag's corners, those of the room about it.
        targets[:, POINT:NORMAL] += np.tile(offset, (NORMAL - POINT) // 3)
        task = task_of(problem._replace(targets=targets), worst=False)
        quality_m[part] = configuration(task, vectors).quality_m
    return quality_m.reshape(len(ys), len(xs))


def mounted(scene: Scene, mounts: Mapping[str, tuple[float, float, float]]) -> Scene:
    """Return the scene with the cameras of ``mounts`` mounted there."""
    cameras = []
    for camera in scene.cameras:
        at, place = mounts.get(camera.id), camera.place
        if at is not None and isinstance(place, HeadPlace):
            base = transform(place.kinematics.T_world_base[:3, :3], np.array(at))
            place = replace(place, kinematics=PanTilt(base, place.kinematics.T_arm_tilt), mount_m=None)
        cameras.append(replace(camera, place=place))
    return replace(scene, cameras=tuple(cameras))


def _vectors(scene: Scene, plan: RigPlan) -> Array:
    vectors = [vector_of(camera, plan.aims.get(camera.id)) for camera in scene.cameras]
    missing = [camera.id for camera, vector in zip(scene.cameras, vectors, strict=True) if vector is None]
    if missing:
        raise InputError(f"the plan has no aim for {', '.join(missing)}")
    return np.array(vectors)


def _another(scene: Scene) -> SceneTarget:
    sizes = [target.tag_size_m for target in scene.targets if target.tag_size_m is not None]
    height_m = float(np.median([target.position_m[2] for target in scene.targets]))
    return SceneTarget("another", (0.0, 0.0, height_m), float(np.median(sizes)) if sizes else None)
