"""What devices measure: frames and their tags, angles of heads, poses of drones, the state of links."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

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
