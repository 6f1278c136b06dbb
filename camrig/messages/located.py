"""What camrig makes of it: where cameras were, what they saw, where targets are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from camrig.geometry.arrays import Array, Transform


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
