"""Which of several identical drones flies to which of their places. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from camrig.geometry.assignment import least_travel
from camrig.messages import Aim
from camrig.optimise.configuration import Configuration, Task, configuration, permitted
from camrig.optimise.kernels.problem import PAN, Z
from camrig.optimise.objective import better
from camrig.optimise.places import vector_of
from camrig.optimise.scene import DronePlace, Scene, kind

_SAME_SHARE = 0.005
"""Drones of one kind may differ in yaw, and then in what they see from one place: it must not matter by more."""


def dealt(task: Task, scene: Scene, start: Mapping[str, Aim], found: Configuration) -> Configuration:
    """Deal the places of identical drones out so that none flies past another (geometry.assignment)."""
    groups: dict[object, list[int]] = {}
    for i, camera in enumerate(scene.cameras):
        if isinstance(camera.place, DronePlace) and vector_of(camera, start.get(camera.id)) is not None:
            groups.setdefault(kind(camera), []).append(i)
    order = np.arange(len(scene.cameras))
    for group in groups.values():
        present = [vector_of(scene.cameras[i], start[scene.cameras[i].id]) for i in group]
        positions = np.array([x[: Z + 1] for x in present if x is not None])
        order[group] = np.array(group)[least_travel(positions, found.vectors[group][:, : Z + 1])]
    if np.array_equal(order, np.arange(len(order))):
        return found
    vectors = found.vectors[order]
    vectors[:, PAN] = np.clip(vectors[:, PAN], task.problem.low[:, PAN], task.problem.high[:, PAN])
    exchanged = configuration(task, vectors)
    if better(found.score, exchanged.score, _SAME_SHARE) or not permitted(task.problem, vectors):
        return found
    return exchanged
