"""What a running rig asks of the planner: the next plan, which also looks for the targets that are lost. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from camrig.errors import InputError
from camrig.messages import Aim, LostTarget, PlanRequest, PlanStatus, RigPlan, TargetQuality
from camrig.optimise.hysteresis import Motion
from camrig.optimise.objective import score
from camrig.optimise.planner import plan, quality_at
from camrig.optimise.promise import with_covariances
from camrig.optimise.scene import PlannerSettings, Scene, SceneTarget, scene_of, speeds_of
from camrig.rig import Rig

_LOST_SHARE = 0.4
"""The weight of all lost targets together, beside the lightest tracked one: no tracked target is given up for them."""

_SPACING_M = 0.55
_REACH_SIGMAS = 2.0
_LOOKS = 2
"""How many plans a place is looked at before the search moves on."""

_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
_LOST = "lost:"


def plan_for(
    rig: Rig,
    request: PlanRequest,
    settings: PlannerSettings,
    now: Callable[[], float],
    proposals: Sequence[Mapping[str, Aim]] = (),
) -> RigPlan:
    """Answer a running rig at once: plan about its present aims and the ``proposals``, within the request's deadline.

    A lost target is searched for at a place that moves outwards from where it is thought to be, plan by plan. The
    place counts as one more target, lighter than any tracked one, so the camera goes that can best be spared. Where
    no permitted plan exists the rig stays as it is.
    """
    scene = _with_searches(scene_of(rig, request, settings), request, rig)
    try:
        found = plan(
            scene,
            start=request.aims,
            proposals=proposals,
            quick=True,
            motion=Motion(settings.motion_cost_per_s, speeds_of(rig)),
            deadline_s=request.deadline_s,
            seed=request.request_id,
            now=now,
        )
    except InputError:
        found = quality_at(scene, request.aims)
    return _without_searches(with_covariances(found, scene), scene, request)


def proposal_for(
    rig: Rig, request: PlanRequest, settings: PlannerSettings, now: Callable[[], float]
) -> Mapping[str, Aim]:
    """Return where a thorough search from anywhere would aim: something to try in the next plan, which may be
    far better than what lies about the running aims. Empty where nothing is permitted.
    """
    scene = _with_searches(scene_of(rig, request, settings), request, rig)
    try:
        return plan(scene, deadline_s=request.deadline_s, seed=request.request_id, prove=False, now=now).aims
    except InputError:
        return {}


def search_place(lost: LostTarget, rig: Rig, request_id: int) -> tuple[float, float, float]:
    """Return where to look now: a sunflower spiral about the predicted position, on the floor, again and again."""
    (low_x, low_y), (high_x, high_y) = rig.space.floor_m
    x, y, z = lost.position_m
    reach_m = _REACH_SIGMAS * lost.sigma_m
    places = []
    for k in range(1 + int((reach_m / _SPACING_M) ** 2)):
        radius_m, angle_rad = _SPACING_M * math.sqrt(k), k * _GOLDEN_RAD
        place = (x + radius_m * math.cos(angle_rad), y + radius_m * math.sin(angle_rad), z)
        if k == 0 or (low_x <= place[0] <= high_x and low_y <= place[1] <= high_y):
            places.append(place)
    return places[(request_id // _LOOKS) % len(places)]


def _with_searches(scene: Scene, request: PlanRequest, rig: Rig) -> Scene:
    if not request.lost:
        return scene
    lightest = min((target.weight for target in scene.targets), default=1.0)
    weight = _LOST_SHARE * lightest / len(request.lost)
    places = tuple(
        SceneTarget(_LOST + lost.id, search_place(lost, rig, request.request_id), lost.tag_size_m, weight=weight)
        for lost in request.lost
    )
    return replace(scene, targets=scene.targets + places)


def _without_searches(found: RigPlan, scene: Scene, request: PlanRequest) -> RigPlan:
    """Return the plan as the rig's: its objective over tracked targets, lost ones as searches or as uncovered."""
    tracked = {name: quality for name, quality in found.targets.items() if not name.startswith(_LOST)}
    searching = {
        lost.id: found.targets[_LOST + lost.id].seen_by[0]
        for lost in request.lost
        if found.targets[_LOST + lost.id].seen_by
    }
    missed = [name for name in found.uncovered if name in tracked]
    missed += [lost.id for lost in request.lost if lost.id not in searching]
    return replace(
        found,
        request_id=request.request_id,
        stamp_s=request.stamp_s,
        status=PlanStatus.PARTIAL if missed else PlanStatus.OPTIMISED,
        objective_m=_objective_m(tracked, scene),
        targets=tracked,
        uncovered=tuple(missed),
        searching=searching,
    )


def _objective_m(tracked: Mapping[str, TargetQuality], scene: Scene) -> float | None:
    """Return the objective over the tracked targets alone; None where none is covered."""
    weights = np.array([target.weight for target in scene.targets if target.id in tracked])
    quality_m = np.array([math.inf if each.quality_m is None else each.quality_m for each in tracked.values()])
    if not np.isfinite(quality_m).any():
        return None
    return score(quality_m, weights, worst=scene.settings.objective == "worst").quality_m
