"""Where the cameras of a drawn room look or hover: nobody's plan, others' planners, the paper's, camrig's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

from camrig.config.models import PlannerModel
from camrig.config.settings import MAX_INCIDENCE_RAD, MIN_TAG_PX
from camrig.errors import InputError
from camrig.experiments.rooms import TAG_SIZE_M, Room
from camrig.experiments.scenes import FLOOR_M, PAPER
from camrig.messages import DroneAim, HeadAim, PlanRequest, PlanTarget, RigPlan
from camrig.optimise import PlannerSettings, Scene, SceneTarget
from camrig.optimise.scene import Quality, scene_of
from camrig.optimise.solvers import Solver, solve

Configuration = Literal["hold", "arslan", "paper-sqp", "paper-ipopt", "camrig-pixel", "camrig-fisher"]
CONFIGURATIONS: tuple[Configuration, ...] = get_args(Configuration)
PAPERS: tuple[Configuration, ...] = ("paper-sqp", "paper-ipopt")
CAMRIGS: dict[Configuration, Quality] = {"camrig-pixel": "pixel", "camrig-fisher": "fisher"}

_SOLVERS: dict[Configuration, Solver] = {
    "hold": "hold",
    "arslan": "arslan",
    "paper-sqp": "slsqp",
    "paper-ipopt": "ipopt",
    "camrig-pixel": "camrig",
    "camrig-fisher": "camrig",
}


def planned(name: Configuration, room: Room, now: Callable[[], float]) -> RigPlan:
    """Return a configuration of a room, planned from nothing with its seed, without a deadline.

    The paper's problem (pixel quality, cone, mean) is that of all but camrig, which plans as a running rig does unless
    its file says otherwise. Raises InputError where a solver is not installed.
    """
    return solve(_SOLVERS[name], scene_for(name, room), seed=room.place.seed, now=now).plan


def scene_for(name: Configuration, room: Room) -> Scene:
    """Return the problem that a configuration solves."""
    if name in CAMRIGS:
        return scene_of(room.rig, _request(room), running_settings(CAMRIGS[name]))
    scene = _paper_scene(room)
    if name == "hold":
        return replace(scene, targets=(SceneTarget("middle", (FLOOR_M[0] / 2.0, FLOOR_M[1] / 2.0, 0.0)),))
    return scene


def of_quality(quality: Quality) -> Configuration:
    """Return camrig's configuration by a quality model; raises InputError for one that is not compared."""
    for name, theirs in CAMRIGS.items():
        if theirs == quality:
            return name
    raise InputError(f"no configuration of the tables is planned by {quality}")


def running_settings(quality: Quality) -> PlannerSettings:
    """Return what a running rig plans by where its file says nothing but the quality, at decimate 1."""
    said = PlannerModel(quality=quality)
    return PlannerSettings(
        quality=said.quality,
        visibility=said.visibility,
        objective=said.objective,
        margin_rad=math.radians(said.margin_deg),
        min_separation_m=said.min_separation_m,
        min_tag_px=MIN_TAG_PX,
        max_incidence_rad=MAX_INCIDENCE_RAD,
        refined_corners=True,
    )


def _paper_scene(room: Room) -> Scene:
    """Return the paper's problem: bodies are points, and nothing keeps drones apart."""
    scene = scene_of(room.rig, _request(room), PAPER)
    return replace(scene, targets=tuple(replace(each, tag_size_m=None) for each in scene.targets), anchors=())


def _request(room: Room) -> PlanRequest:
    targets = tuple(
        PlanTarget(name, (float(T[0, 3]), float(T[1, 3]), float(T[2, 3])), TAG_SIZE_M)
        for name, T in room.bodies.items()
    )
    aims = {
        name: HeadAim(0.0, 0.0) if name in room.rig.heads else DroneAim((0.0, 0.0, 0.0)) for name in room.rig.cameras
    }
    return PlanRequest(0, 0.0, targets, aims, tuple(room.rig.cameras), math.inf)
