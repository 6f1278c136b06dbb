"""What devices measure: frames and their tags, angles of heads, poses of drones, the state of links."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from camrig.errors import LinkLoss
from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.rig import TagKey


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
    note: str = ""
    """What an operator should know of the picture: that light is missing."""


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
    refined: tuple[bool, bool, bool, bool] = (False, False, False, False)
    """Which corners were refined through the lens (geometry.refine_corners); the others are the detector's."""


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
class Window:
    """A region of one picture in which a tag is expected, and how long its shortest side is there; NaN: unknown."""

    region: Region
    key: TagKey | None = None
    side_px: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where n tags are expected in one camera's pictures, for frames stamped ``from_s`` to ``until_s``.

    ``edges_px`` (3, n, 4) are left, top, right and bottom of the region that surely holds a tag and its rim at
    ``from_s``, half way and at ``until_s``; in between they move evenly. ``sides_px`` (n,) is a tag's shortest side.
    """

    camera_id: str
    from_s: float
    until_s: float
    keys: tuple[TagKey, ...]
    edges_px: Array
    sides_px: Array

    def holds_at(self, stamp_s: float) -> bool:
        """Tell whether a frame of this stamp may be searched there alone."""
        return self.from_s <= stamp_s <= self.until_s

    def windows_at(self, stamp_s: float) -> tuple[Window, ...]:
        """Return the regions at a stamp, in whole pixels; also those outside the picture."""
        way = min(max(2.0 * (stamp_s - self.from_s) / max(self.until_s - self.from_s, 1e-9), 0.0), 2.0)
        part = int(min(way, 1.0))
        edges = self.edges_px[part] + (way - part) * (self.edges_px[part + 1] - self.edges_px[part])
        whole = np.concatenate([np.floor(edges[:, :2]), np.ceil(edges[:, 2:]) + 1.0], axis=1).astype(np.int64)
        return tuple(
            Window((left, top, right, bottom), key, side_px)
            for key, (left, top, right, bottom), side_px in zip(
                self.keys, whole.tolist(), self.sides_px.tolist(), strict=True
            )
        )


@dataclass(frozen=True, slots=True)
class AxisReading:
    """One axis of one head as the head sampled it at ``stamp_s`` (plus or minus ``stamp_sigma_s``)."""

    head_id: str
    axis: Literal["pan", "tilt"]
    angle_rad: float
    stamp_s: float
    sigma_rad: float
    stamp_sigma_s: float
    noise_rad: float = 0.0
    """The part of ``sigma_rad`` that is another for each reading of a moving axis: rounding and noise. One at rest is
    rounded alike each time; the rest of ``sigma_rad`` (a zero, the play) all readings share.
    """


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


@dataclass(frozen=True, slots=True, eq=False)
class BodyPose:
    """Where a drone was at ``stamp_s`` by what its camera saw alone; covariance (6, 6) as in geometry.pose."""

    drone_id: str
    stamp_s: float
    T_world_body: Transform
    covariance: Array


@dataclass(frozen=True, slots=True)
class DroneHealth:
    """How a drone is, for its operator."""

    activity: str
    """What we do with it, in one word; ``passive`` is nothing."""
    obeys: bool
    """Whether it takes hover points now."""
    begins: bool = False
    """Whether it will, once it has been taken over, is armed, has climbed."""
    lands: bool = False
    """Whether it is on its way down, by an operator's order or for a fault."""
    reason: str = ""
    """Why the last order ended otherwise than ordered, or what was done about a fault."""
    unfit: tuple[str, ...] = ()
    """Why it would not be armed or resumed now, each with its cure."""
    advice: tuple[str, ...] = ()
    """What should be otherwise, though it may fly so."""
    battery: float | None = None
    """Charge left, 0 to 1."""
    pose_age_s: float | None = None
    software: str = ""


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
    loss: LinkLoss | None = None
    """Why it is lost, in one word; None where it is not."""
