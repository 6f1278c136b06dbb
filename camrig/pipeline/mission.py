"""What the rig is after: scan until the targets are found, then for ever ask for plans and follow them.

Algorithm 1 of Zhang et al. Pure: the mission before, what is known now and the planner's answer give the one after.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from camrig.geometry.rotation import wrap_angle
from camrig.messages import (
    Aim,
    DroneAim,
    Event,
    HeadAim,
    Level,
    LostTarget,
    PlannerAnswer,
    PlannerRequest,
    PlanRequest,
    PlanTarget,
    RigPlan,
    RigPose,
    ScanPlan,
    ScanRequest,
    Target,
    TargetStatus,
)
from camrig.rig import Body, Rig

ARRIVED_RAD = math.radians(1.0)
ARRIVED_M = 0.15
DWELL_S = 0.6
"""How long a scan looks at one stop: a few frames and their detection."""
STOP_TIMEOUT_S = 8.0
ASSEMBLE_S = 3.0
"""How long a scan waits at its start for devices that may still come up."""
SCAN_DEADLINE_S = 2.0
PLAN_DELAY_S = 0.3
"""From a request until the cameras have moved: solving, the command's way, the start of the motion."""
REACH_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """How often to plan, and whether to aim at all (``aim=False`` keeps every camera where it is)."""

    period_s: float = 1.0
    deadline_s: float = 0.5
    aim: bool = True


@dataclass(frozen=True, slots=True)
class Mission:
    """Where the mission stands; ``goal`` is the aim wanted of every camera that takes part, by camera id."""

    started_s: float
    scanning: bool = True
    scan: ScanPlan | None = None
    stop_index: int = -1
    stop_since_s: float = 0.0
    arrived_s: float | None = None
    plan: RigPlan | None = None
    goal: Mapping[str, Aim] = field(default_factory=dict)
    request_id: int = 0
    answered_id: int = 0
    next_plan_s: float = 0.0

    @property
    def waiting(self) -> bool:
        """Whether the planner still owes an answer."""
        return self.answered_id < self.request_id


@dataclass(frozen=True, slots=True)
class Knowledge:
    """What the mission decides by: targets, where cameras aim now, and which of them can be moved or used."""

    targets: tuple[Target, ...]
    aims: Mapping[str, Aim]
    pose: RigPose
    movable: frozenset[str]
    """Cameras on an enabled head or a flying drone."""
    usable: frozenset[str]
    """Cameras that deliver pictures and whose pose is known; fixed ones too, and those on a head that may not move."""
    complete: bool
    """Every camera that is to take part is there."""


Step = tuple[Mission, PlannerRequest | None, tuple[Event, ...]]


def advance(
    mission: Mission,
    rig: Rig,
    known: Knowledge,
    answer: PlannerAnswer | None,
    settings: MissionSettings,
    now_s: float,
) -> Step:
    """Return the mission after this tick, a request for the planner where one is due, and what to tell the operator."""
    mission = _without_stale_goals(_take(mission, answer), known)
    if not settings.aim or not (rig.heads or rig.drones):
        return replace(mission, scanning=False), None, ()
    if mission.scanning:
        return _scan(mission, known, settings, now_s)
    if now_s < mission.next_plan_s or mission.waiting or not known.movable:
        return mission, None, ()
    request = _plan_request(mission, rig, known, settings, now_s)
    return replace(mission, request_id=request.request_id, next_plan_s=now_s + settings.period_s), request, ()


def rescan(mission: Mission, now_s: float) -> Mission:
    """Begin a new scan of the whole floor (an operator's order)."""
    # What the planner still owes is waited for: it answers one request at a time. Its answer is then not followed.
    return Mission(started_s=now_s - ASSEMBLE_S, request_id=mission.request_id, answered_id=mission.answered_id)


def with_promises(targets: tuple[Target, ...], plan: RigPlan | None) -> tuple[Target, ...]:
    """Return the targets with what the plan in force promised for each: achieved and predicted, side by side."""
    if plan is None:
        return targets
    promised = {name: quality.covariance_m2 for name, quality in plan.targets.items()}
    return tuple(replace(target, planned_covariance_m2=promised.get(target.id)) for target in targets)


def _take(mission: Mission, answer: PlannerAnswer | None) -> Mission:
    """Accept the planner's answer unless the mission has moved on since it was asked."""
    if answer is None or answer.request_id != mission.request_id:
        return mission
    mission = replace(mission, answered_id=answer.request_id)
    if isinstance(answer, ScanPlan):
        return replace(mission, scan=answer, stop_index=-1) if mission.scanning else mission
    return mission if mission.scanning else replace(mission, plan=answer, goal={**mission.goal, **answer.aims})


def _without_stale_goals(mission: Mission, known: Knowledge) -> Mission:
    """Forget the goals of cameras that cannot move now: who comes back waits for a new plan, nothing is replayed."""
    if mission.goal.keys() <= known.movable:
        return mission
    return replace(mission, goal={camera: aim for camera, aim in mission.goal.items() if camera in known.movable})


def _scan(mission: Mission, known: Knowledge, settings: MissionSettings, now_s: float) -> Step:
    if all(target.status is not TargetStatus.UNSEEN for target in known.targets):
        return _end_scan(mission, known, now_s)
    if mission.scan is None:
        assembled = known.complete or now_s >= mission.started_s + ASSEMBLE_S
        if mission.waiting or not assembled or not known.movable:
            return mission, None, ()
        request = ScanRequest(mission.request_id + 1, now_s, known.aims, tuple(sorted(known.movable)), SCAN_DEADLINE_S)
        return replace(mission, request_id=request.request_id), request, ()
    if not known.movable:  # on hold: the scan goes on where it stands
        return replace(mission, stop_since_s=now_s), None, ()
    if not _stop_done(mission, known, now_s):
        arrived = mission.arrived_s is None and _arrived(mission.goal, known)
        return replace(mission, arrived_s=now_s) if arrived else mission, None, ()
    following = mission.stop_index + 1
    if following >= len(mission.scan.stops):
        return _end_scan(mission, known, now_s)
    goal = {**mission.goal, **mission.scan.stops[following]}
    mission = replace(mission, stop_index=following, stop_since_s=now_s, arrived_s=None, goal=goal)
    return mission, None, ()


def _stop_done(mission: Mission, known: Knowledge, now_s: float) -> bool:
    if mission.stop_index < 0:
        return True
    dwelt = mission.arrived_s is not None and now_s >= mission.arrived_s + DWELL_S
    return dwelt or now_s >= mission.stop_since_s + STOP_TIMEOUT_S


def _end_scan(mission: Mission, known: Knowledge, now_s: float) -> Step:
    missing = sorted(target.id for target in known.targets if target.status is TargetStatus.UNSEEN)
    text = f"scan ended without finding {', '.join(missing)}" if missing else "scan ended: every target was found"
    event = Event(now_s, Level.WARNING if missing else Level.INFO, "scan", text)
    ended = replace(mission, scanning=False, scan=None, stop_index=-1, arrived_s=None, next_plan_s=now_s)
    return ended, None, (event,)


def _arrived(goal: Mapping[str, Aim], known: Knowledge) -> bool:
    return all(_near(goal[camera], known.aims.get(camera)) for camera in known.movable & goal.keys())


def _near(wanted: Aim, aim: Aim | None) -> bool:
    match wanted, aim:
        case HeadAim(), HeadAim():
            pan_rad = abs(wrap_angle(wanted.pan_rad - aim.pan_rad))
            return max(pan_rad, abs(wanted.tilt_rad - aim.tilt_rad)) <= ARRIVED_RAD
        case DroneAim(), DroneAim():
            return math.dist(wanted.position_m, aim.position_m) <= ARRIVED_M
    return False


def _plan_request(mission: Mission, rig: Rig, known: Knowledge, settings: MissionSettings, now_s: float) -> PlanRequest:
    # A plan arrives late and holds for a period: aim at where the targets will be in the middle of that time.
    lead_s = PLAN_DELAY_S + 0.5 * settings.period_s
    goals = {camera: mission.goal.get(camera) for camera in known.movable}
    aims = {camera: _planned_from(goals.get(camera), known.aims[camera]) for camera in known.usable & known.aims.keys()}
    return PlanRequest(
        request_id=mission.request_id + 1,
        stamp_s=now_s,
        targets=tuple(
            _plan_target(rig.targets[target.id], target, lead_s)
            for target in known.targets
            if target.status is TargetStatus.TRACKED
        ),
        aims=aims,
        available=tuple(sorted(known.usable)),
        deadline_s=settings.deadline_s,
        fixed=tuple(sorted(known.usable - known.movable)),
        lost=tuple(_lost_target(rig, target) for target in known.targets if target.status is not TargetStatus.TRACKED),
    )


def _planned_from(goal: Aim | None, present: Aim) -> Aim:
    """Return where a plan starts from: a head that moves from its goal, which it reaches soon; else where it is."""
    return goal if isinstance(goal, HeadAim) else present


def _plan_target(body: Body, target: Target, lead_s: float) -> PlanTarget:
    tag = body.tags[0]
    R = target.R_world_body
    centre = target.position_m + lead_s * target.velocity_m_s + R @ tag.T_body_tag[:3, 3]
    normal = R @ tag.T_body_tag[:3, 2]
    reach_m = lead_s * float(np.linalg.norm(target.velocity_m_s)) + REACH_SIGMAS * _sigma_m(target)
    return PlanTarget(body.id, _triple(centre), tag.size_m, _triple(normal), body.weight, reach_m)


def _sigma_m(target: Target) -> float:
    return math.sqrt(float(np.linalg.eigvalsh(target.covariance_m2)[-1]))


def _lost_target(rig: Rig, target: Target) -> LostTarget:
    tag = rig.targets[target.id].tags[0]
    low, high = np.array(rig.space.floor_m)
    sigma_m = 0.5 * float(np.linalg.norm(high - low))
    position = np.array([*(low + high) / 2.0, tag.T_body_tag[2, 3]])
    if target.status is TargetStatus.LOST:
        sigma_m = min(sigma_m, math.sqrt(float(np.trace(target.covariance_m2[:2, :2]))))
        position = np.array([*np.clip(target.position_m[:2], low, high), target.position_m[2] + tag.T_body_tag[2, 3]])
    return LostTarget(target.id, _triple(position), sigma_m, tag.size_m)


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z
