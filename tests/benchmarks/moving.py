"""Targets that walk at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camrig.experiments.scenes import FLOOR_M
from camrig.optimise import Scene, SceneTarget


def moved(scene: Scene, distance_m: float, rng: np.random.Generator) -> Scene:
    """Return the scene with every target so far from where it was, in any direction that keeps it in the room."""

    def step(target: SceneTarget) -> SceneTarget:
        x, y, z = target.position_m
        turn = rng.uniform(0.0, 2.0 * np.pi)
        x, y = np.clip((x + distance_m * np.cos(turn), y + distance_m * np.sin(turn)), (0.0, 0.0), FLOOR_M)
        return replace(target, position_m=(float(x), float(y), z))

    return replace(scene, targets=tuple(step(target) for target in scene.targets))
