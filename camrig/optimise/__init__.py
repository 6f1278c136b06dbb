"""Targets and rig -> RigPlan: where every camera should look or hover. Pure; numpy and scipy."""

from camrig.optimise.hysteresis import Motion
from camrig.optimise.plan_views import View, quality_map, views
from camrig.optimise.planner import plan, quality_at
from camrig.optimise.running import plan_for, proposal_for
from camrig.optimise.scan import scan_for
from camrig.optimise.scene import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    PoseSigma,
    Scene,
    SceneAnchor,
    SceneCamera,
    SceneTarget,
    ZoomStep,
    scene_of,
)
from camrig.optimise.warm_up import warm_up

__all__ = [
    "DronePlace",
    "FixedPlace",
    "HeadPlace",
    "Motion",
    "PlannerSettings",
    "PoseSigma",
    "Scene",
    "SceneAnchor",
    "SceneCamera",
    "SceneTarget",
    "View",
    "ZoomStep",
    "plan",
    "plan_for",
    "proposal_for",
    "quality_at",
    "quality_map",
    "scan_for",
    "scene_of",
    "views",
    "warm_up",
]
