"""Targets and rig -> RigPlan: where every camera should look or hover. Pure; numpy and scipy."""

from camrig.optimise.planner import plan, quality_at
from camrig.optimise.running import plan_for
from camrig.optimise.scan import scan_for
from camrig.optimise.scene import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    Scene,
    SceneCamera,
    SceneTarget,
    scene_of,
)

__all__ = [
    "DronePlace",
    "FixedPlace",
    "HeadPlace",
    "PlannerSettings",
    "Scene",
    "SceneCamera",
    "SceneTarget",
    "plan",
    "plan_for",
    "quality_at",
    "scan_for",
    "scene_of",
]
