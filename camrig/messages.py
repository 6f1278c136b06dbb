"""The frozen messages that flow through camrig, in the order in which they arise.

Stamps are seconds of the one monotonic clock. Every position comes with its covariance; ``None`` is "unknown".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.rig import TagKey

# --- what devices measure -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One grey picture; ``stamp_s`` is mid-exposure of the centre row, ``stamp_known`` whether its origin is."""

    camera_id: str
    image: GreyImage
    stamp_s: float
    sequence: int
    stamp_known: bool = True
    source: str = ""
    """The file a frame came from, where it came from one."""


@dataclass(frozen=True, slots=True, eq=False)
class TagDetection:
    """One tag in one picture. Corners p0..p3 are AprilTag's (bottom-left, bottom-right, top-right, top-left
    of an upright tag), (4, 2) pixels in OpenCV's convention (the centre of the first pixel is 0, 0).
    """

    key: TagKey
    corners_px: Array
    centre_px: tuple[float, float]
    hamming: int
    margin: float


@dataclass(frozen=True, slots=True, eq=False)
class TagDetections:
    """All tags of one frame; ``whole`` is False where only the regions of expected tags were searched."""

    camera_id: str
    stamp_s: float
    sequence: int
    size_px: tuple[int, int]
    tags: tuple[TagDetection, ...]
    detect_s: float
    source: str = ""
    whole: bool = True


Region = tuple[int, int, int, int]
"""A part of a picture in pixels: left, top, right, bottom; the last two are not part of it any more."""


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the tags of one camera's pictures are expected, for frames stamped ``from_s`` to ``until_s``."""

    camera_id: str
    from_s: float
    until_s: float
    regions: tuple[Region, ...]

    def holds_at(self, stamp_s: float) -> bool:
        """Tell whether a frame of this stamp may be searched there alone."""
        return self.from_s <= stamp_s <= self.until_s


@dataclass(frozen=True, slots=True)
class AxisReading:
    """One axis of one head as the head sampled it at ``stamp_s`` (plus or minus ``stamp_sigma_s``)."""

    head_id: str
    axis: Literal["pan", "tilt"]
    angle_rad: float
    stamp_s: float
    sigma_rad: float
    stamp_sigma_s: float


class FlightState(StrEnum):
    """What a drone is doing, judged by its own telemetry."""

    UNKNOWN = "unknown"
    GROUND = "ground"
    TAKING_OFF = "taking_off"
    FLYING = "flying"
    LANDING = "landing"


@dataclass(frozen=True, slots=True, eq=False)
class DroneReading:
    """Where a drone says it was at ``stamp_s``; covariance (6, 6) in the convention of geometry.pose."""

    drone_id: str
    stamp_s: float
    T_world_body: Transform
    covariance: Array
    flight: FlightState


class LinkStatus(StrEnum):
    """The state of a device's link, as it is published."""

    CLOSED = "closed"
    UP = "up"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class LinkReport:
    """A device's link changed its state."""

    device_id: str
    status: LinkStatus
    stamp_s: float
    reason: str = ""


# --- what camrig makes of it ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Where a camera was at ``stamp_s``; covariance (6, 6) in the convention of geometry.pose."""

    camera_id: str
    stamp_s: float
    T_world_camera: Transform
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One body seen by one camera at one instant.

    ``covariance`` (6, 6) is of the corner noise, new in every frame; ``camera_covariance`` (6, 6) is what the
    camera's pose adds, shared by many frames, never to be averaged away. ``quality_m`` is the paper's Q.
    """

    target_id: str
    camera_id: str
    stamp_s: float
    T_world_body: Transform
    covariance: Array
    camera_covariance: Array
    quality_m: float
    tags: int


class TargetStatus(StrEnum):
    """How well a target is known now."""

    TRACKED = "tracked"
    LOST = "lost"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A target as published: position (3,) m, velocity (3,) m/s, covariance (3, 3) m2 at ``stamp_s``."""

    id: str
    stamp_s: float
    status: TargetStatus
    position_m: Array
    velocity_m_s: Array
    covariance_m2: Array
    R_world_body: Array
    seen_by: tuple[str, ...]
    last_seen_s: float
    quality_m: float | None = None


# --- planning and steering ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HeadAim:
    """Where a head looks: angles of docs/frames-and-units.md."""

    pan_rad: float
    tilt_rad: float


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
    """What a plan promises for one target; ``quality_m`` is None where nothing sees it."""

    quality_m: float | None
    seen_by: tuple[str, ...]


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


class Level(StrEnum):
    """How much an event matters."""

    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Event:
    """Something an operator should read: which thing, what happened, what it costs."""

    stamp_s: float
    level: Level
    about: str
    text: str
