"""Planning and steering: what the planner is asked and answers, and the commands that come of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from camrig.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class HeadAim:
    """Where a head looks: angles of docs/frames-and-units.md; ``zoom`` is a position of its lens's zoom table."""

    pan_rad: float
    tilt_rad: float
    zoom: float | None = None


@dataclass(frozen=True, slots=True)
class DroneAim:
    """Where a drone hovers: world metres, yaw of its body (0 = nose along world x)."""

    position_m: tuple[float, float, float]
    yaw_rad: float = 0.0


Aim = HeadAim | DroneAim


@dataclass(frozen=True, slots=True)
class PlanTarget:
    """A target as the planner sees it: a tag's centre, its side and the normal of its face, in the world."""

    id: str
    position_m: tuple[float, float, float]
    tag_size_m: float | None = None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    weight: float = 1.0
    reach_m: float = 0.0
    """How far it may be from there while the plan holds: it must be in the picture wherever it is."""


@dataclass(frozen=True, slots=True)
class LostTarget:
    """A target to be searched for: where it is thought to be, and how uncertain that is."""

    id: str
    position_m: tuple[float, float, float]
    sigma_m: float
    tag_size_m: float


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Ask the planner for a plan; ``aims`` is where the cameras that can take part aim now, by camera id."""

    request_id: int
    stamp_s: float
    targets: tuple[PlanTarget, ...]
    aims: Mapping[str, Aim]
    available: tuple[str, ...]
    deadline_s: float
    lost: tuple[LostTarget, ...] = ()
    fixed: tuple[str, ...] = ()
    """Cameras among the available ones that may not be moved now (their head is not enabled)."""


@dataclass(frozen=True, slots=True)
class ScanRequest:
    """Ask the planner for the stops of a scan of the whole floor."""

    request_id: int
    stamp_s: float
    aims: Mapping[str, Aim]
    available: tuple[str, ...]
    deadline_s: float


PlannerRequest = PlanRequest | ScanRequest


@dataclass(frozen=True, slots=True)
class TargetQuality:
    """What a plan promises for one target; ``quality_m`` is None where nothing sees it.

    ``covariance_m2`` (3, 3) is that of its place from one picture of each of these cameras, whatever the plan was made
    by: what fusion reports may be held against it. None where nobody asked for it.
    """

    quality_m: float | None
    seen_by: tuple[str, ...]
    covariance_m2: Array | None = field(default=None, compare=False)


class PlanStatus(StrEnum):
    """``infeasible`` is said only with a certificate."""

    OPTIMISED = "optimised"
    PARTIAL = "partial"
    INFEASIBLE = "infeasible"


@dataclass(frozen=True, slots=True)
class RigPlan:
    """The planner's answer; ``aims`` and ``targets`` by id, ``objective_m`` over the covered targets."""

    request_id: int
    stamp_s: float
    status: PlanStatus
    objective_m: float | None
    aims: Mapping[str, Aim]
    targets: Mapping[str, TargetQuality]
    uncovered: tuple[str, ...]
    solve_s: float
    searching: Mapping[str, str] = field(default_factory=dict)
    """Which camera looks for which lost target: camera id by target id."""
    mounts: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Where to mount the cameras that are not mounted yet, by camera id, in world metres."""


@dataclass(frozen=True, slots=True)
class ScanPlan:
    """The stops of a scan, in order: aims by camera id; ``covered`` is the share of floor cells they show."""

    request_id: int
    stamp_s: float
    stops: tuple[Mapping[str, Aim], ...]
    covered: float
    solve_s: float


PlannerAnswer = RigPlan | ScanPlan


@dataclass(frozen=True, slots=True)
class HeadCommand:
    """Move a head to an aim, as fast as its limits allow."""

    head_id: str
    aim: HeadAim


@dataclass(frozen=True, slots=True)
class DroneCommand:
    """Fly a drone to a hover point."""

    drone_id: str
    aim: DroneAim


Command = HeadCommand | DroneCommand


@dataclass(frozen=True, slots=True)
class RigPose:
    """Where heads and drones are now, as far as is known; what is missing is unknown."""

    heads: Mapping[str, HeadAim] = field(default_factory=dict)
    drones: Mapping[str, DroneAim] = field(default_factory=dict)
    """Drones that fly."""
    aloft: Mapping[str, DroneAim] = field(default_factory=dict)
    """The other drones that need room, where they were last: sent up, taking off, landing, not heard of."""
