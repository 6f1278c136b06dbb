"""Have every kernel compiled, or loaded from where it is kept, before the first plan is asked for. Pure."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.optimise.planner import plan
from camrig.optimise.scene import DronePlace, HeadPlace, PlannerSettings, Scene, SceneAnchor, SceneCamera, SceneTarget


def warm_up(settings: PlannerSettings) -> None:
    """Plan a head and a drone over two tags, thoroughly and quickly: about two minutes, once after an installation."""
    scene = small_scene(settings)
    found = plan(scene, prove=False, now=lambda: 0.0)
    plan(scene, start=found.aims, quick=True, now=lambda: 0.0)


def small_scene(settings: PlannerSettings) -> Scene:
    """Return a scene that has something for every kernel to do."""
    lens = BrownLens((1280, 720), (900.0, 900.0), (640.0, 360.0))
    kinematics, down = PanTilt(transform(np.eye(3), np.array([0.0, 0.0, 2.5]))), -math.pi / 2.0
    head = HeadPlace(kinematics, transform(R_MOUNT_OPTICAL, np.zeros(3)), (-math.pi, math.pi), (down, 0.0))
    drone = DronePlace(transform(R_BODY_OPTICAL_DOWN, np.zeros(3)), ((0.0, 0.0, 1.0), (1.0, 1.0, 2.0)))
    return Scene(
        cameras=(SceneCamera("head", lens, head), SceneCamera("drone", lens, drone, needs_anchor=True)),
        # Two targets, one of them out of most views: pairs, and what is nearly seen, have kernels of their own.
        targets=(SceneTarget("tag", (0.5, 0.5, 0.0), 0.2), SceneTarget("far", (4.0, 0.5, 0.0), 0.2)),
        settings=PlannerSettings(settings.quality, settings.visibility, settings.objective),
        keep_out_m=(((5.0, 5.0, 0.0), (6.0, 6.0, 1.0)),),
        anchors=(SceneAnchor((0.5, 0.6, 0.0), 0.2),),
    )
