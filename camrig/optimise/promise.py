"""What a plan promises for each target, as a covariance: by Fisher information, whatever it was made by. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig.messages import Aim, RigPlan
from camrig.optimise.configuration import empty_rows, empty_sums, task_of
from camrig.optimise.kernels.compass import fill
from camrig.optimise.places import vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Scene


def with_covariances(found: RigPlan, scene: Scene) -> RigPlan:
    """Return a plan of the scene with the (3, 3) covariance of each target's place that it promises."""
    covariances = promised_covariances(scene, found.aims)
    targets = {
        name: replace(quality, covariance_m2=covariances.get(name)) if quality.seen_by else quality
        for name, quality in found.targets.items()
    }
    return replace(found, targets=targets)


def promised_covariances(scene: Scene, aims: Mapping[str, Aim]) -> dict[str, Array]:
    """Return the (3, 3) covariance in m2 of the place of every target that cameras with these aims see, by id, from
    one picture of each: their corners' noise and what is uncertain of their poses, anchors in view included.

    Empty where an aim is unknown, or a target has no tag of known size.
    """
    if not scene.targets or any(target.tag_size_m is None for target in scene.targets):
        return {}
    vectors = [vector_of(camera, aims.get(camera.id)) for camera in scene.cameras]
    known = [vector for vector in vectors if vector is not None]
    if not known or len(known) < len(vectors):
        return {}
    task = task_of(problem_of(replace(scene, settings=replace(scene.settings, quality="fisher"))), worst=False)
    rows, sums = empty_rows(task), empty_sums(task, 0.0)
    fill(task.problem, rows, sums, np.array(known))
    return {
        target.id: np.asarray(np.linalg.inv(_symmetric(sums.total[j])), float)
        for j, target in enumerate(scene.targets)
        if sums.watching[j] > 0
    }


def _symmetric(channels: Array) -> Array:
    """Return the (3, 3) matrix of the six numbers that are added up (kernels.worth)."""
    xx, xy, xz, yy, yz, zz = channels
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
