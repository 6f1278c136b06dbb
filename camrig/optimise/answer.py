"""Configuration -> RigPlan: what the planner says, in the words of the messages. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from camrig.messages import Aim, PlanStatus, RigPlan, TargetQuality
from camrig.optimise.configuration import Configuration
from camrig.optimise.kernels.problem import Z
from camrig.optimise.places import aim_of, vector_of
from camrig.optimise.scene import HeadPlace, Scene


def nothing_to_do(scene: Scene, start: Mapping[str, Aim], solve_s: float) -> RigPlan:
    """Return the plan that leaves the rig as it is: there is nothing to see, or nothing to see it with."""
    names = tuple(target.id for target in scene.targets)
    return RigPlan(
        request_id=0,
        stamp_s=0.0,
        status=PlanStatus.PARTIAL if names else PlanStatus.OPTIMISED,
        objective_m=None,
        aims={camera.id: start[camera.id] for camera in scene.cameras if camera.id in start},
        targets={name: TargetQuality(None, ()) for name in names},
        uncovered=names,
        solve_s=solve_s,
    )


def as_plan(scene: Scene, found: Configuration, start: Mapping[str, Aim], stamp_s: float, solve_s: float) -> RigPlan:
    """Return the plan of a configuration; a camera that stays gets exactly the aim it has in ``start``."""
    seen_by: list[list[str]] = [[] for _ in scene.targets]
    for camera, first, end in zip(scene.cameras, found.ends[:-1], found.ends[1:], strict=True):
        for j in found.targets[first:end]:
            seen_by[j].append(camera.id)
    targets = {
        target.id: TargetQuality(float(quality_m) if np.isfinite(quality_m) else None, tuple(cameras))
        for target, quality_m, cameras in zip(scene.targets, found.quality_m, seen_by, strict=True)
    }
    uncovered = tuple(name for name, quality in targets.items() if quality.quality_m is None)
    return RigPlan(
        request_id=0,
        stamp_s=stamp_s,
        status=PlanStatus.PARTIAL if uncovered else PlanStatus.OPTIMISED,
        objective_m=found.score.quality_m if len(uncovered) < len(targets) else None,
        aims=_aims(scene, found, start),
        targets=targets,
        uncovered=uncovered,
        solve_s=solve_s,
        mounts={
            camera.id: (float(vector[0]), float(vector[1]), float(vector[Z]))
            for camera, vector in zip(scene.cameras, found.vectors, strict=True)
            if isinstance(camera.place, HeadPlace) and camera.place.mount_m is not None
        },
    )


def _aims(scene: Scene, found: Configuration, start: Mapping[str, Aim]) -> dict[str, Aim]:
    aims: dict[str, Aim] = {}
    for camera, vector in zip(scene.cameras, found.vectors, strict=True):
        present = vector_of(camera, start.get(camera.id))
        stays = present is not None and np.array_equal(present, vector)
        aim = start.get(camera.id) if stays else aim_of(camera, vector)
        if aim is not None:
            aims[camera.id] = aim
    return aims
