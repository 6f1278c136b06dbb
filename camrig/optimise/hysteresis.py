"""Whether moving is worth it: running aims stay unless a plan is clearly better; no camera moves for nothing. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from camrig.geometry.arrays import Array
from camrig.optimise.configuration import Configuration, Task, configuration, permitted
from camrig.optimise.kernels.problem import PAN, ZOOM, Z
from camrig.optimise.objective import better
from camrig.optimise.scene import DronePlace, SceneCamera
from camrig.optimise.search import Expired

_REVERTED_SHARE = 0.5
"""The share of ``gain`` that may be given back to let cameras stay where they are."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The share of the objective that a second of motion must bring; how fast cameras turn (rad/s) or fly (m/s)."""

    cost_per_s: float = 0.0
    speeds: Mapping[str, float] = field(default_factory=dict)

    def cost(self, camera: SceneCamera, way: Array) -> float:
        """Return the share of the objective that a camera's way (6,) must bring; an unknown speed is 1."""
        drone = isinstance(camera.place, DronePlace)
        distance = np.linalg.norm(way[: Z + 1]) if drone else np.abs(way[PAN:ZOOM]).max()
        return self.cost_per_s * float(distance) / self.speeds.get(camera.id, 1.0)


def settle(
    task: Task,
    cameras: Sequence[SceneCamera],
    running: Configuration,
    found: Configuration,
    gain: float,
    motion: Motion,
    expired: Expired,
) -> Configuration:
    """Return the running configuration, or the found one with every camera put back whose move hardly matters.

    A found configuration is taken when it covers more weight, or is better by more than ``gain`` and what its motion
    costs. Putting cameras back never uncovers a target, gives back at most half of ``gain`` and what the spared motion
    costs, and leaves a gain of more than ``gain``.
    """
    ways = found.vectors - running.vectors
    moved = [i for i in range(len(ways)) if ways[i].any()]
    costs = {i: motion.cost(cameras[i], ways[i]) for i in moved}
    if not better(found.score, running.score, gain + sum(costs.values())):
        return running
    kept, spared = found, 0.0
    while moved:
        options: dict[int, Configuration] = {}
        for i in moved:
            if expired():
                return kept
            option = _put_back(task, running, kept, i)
            share = 1.0 + _REVERTED_SHARE * gain + spared + costs[i]
            worst = found.score._replace(quality_m=found.score.quality_m * share)
            if (
                not better(worst, option.score)
                and better(option.score, running.score, gain)
                and permitted(task.problem, option.vectors)
            ):
                options[i] = option
        if not options:
            return kept
        i = min(options, key=lambda each: options[each].score)
        kept, spared = options[i], spared + costs[i]
        moved.remove(i)
    return kept


def _put_back(task: Task, running: Configuration, kept: Configuration, i: int) -> Configuration:
    vectors = kept.vectors.copy()
    vectors[i] = running.vectors[i]
    return configuration(task, vectors)
