"""Targets and rig -> RigPlan: where every camera should look or hover. Pure; numpy and scipy.

What describes a scene costs nothing to import; the planner, with SciPy and compiled kernels, is loaded when it is first
asked for: a daemon, whose planner is a process of its own, starts and stops without it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from camrig.optimise.hysteresis import Motion
    from camrig.optimise.plan_views import View, quality_map, views
    from camrig.optimise.planner import plan, quality_at
    from camrig.optimise.running import plan_for, proposal_for
    from camrig.optimise.scan import scan_for
    from camrig.optimise.warming_up import warm_up

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

_LOADED_WHEN_USED = {
    "Motion": "hysteresis",
    "View": "plan_views",
    "quality_map": "plan_views",
    "views": "plan_views",
    "plan": "planner",
    "quality_at": "planner",
    "plan_for": "running",
    "proposal_for": "running",
    "scan_for": "scan",
    "warm_up": "warming_up",
}


def __getattr__(name: str) -> object:
    if name in _LOADED_WHEN_USED:
        return getattr(import_module(f"{__name__}.{_LOADED_WHEN_USED[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
