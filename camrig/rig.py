"""What a rig is: cameras and their lenses, what carries them and within which limits, what they look at.

Frozen, in SI units and radians; ``config`` builds it from YAML. Frames: docs/frames-and-units.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date

from camrig.geometry.arrays import Transform
from camrig.geometry.lens import Lens
from camrig.geometry.lens.errors import TYPICAL_SIGMA, LensSigma
from camrig.geometry.pan_tilt import PanTilt

Interval = tuple[float, float]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Axis-aligned box in world metres: its lowest and its highest corner."""


@dataclass(frozen=True, slots=True)
class HeadMount:
    """The camera sits on a pan-tilt head, ``T_mount_camera`` from its tilted frame (see geometry.pan_tilt)."""

    head: str
    T_mount_camera: Transform


@dataclass(frozen=True, slots=True)
class DroneMount:
    """The camera hangs under a drone; at body yaw 0 an identity-rpy mount has image right = world +x."""

    drone: str
    T_body_camera: Transform


@dataclass(frozen=True, slots=True)
class FixedMount:
    """The camera is bolted to the room."""

    T_world_camera: Transform


@dataclass(frozen=True, slots=True)
class FreeMount:
    """Nobody knows where the camera is (hand-carried): its pose comes from anchors in view alone."""


Mount = HeadMount | DroneMount | FixedMount | FreeMount


@dataclass(frozen=True, slots=True, eq=False)
class CameraSpec:
    """One camera: its lens, what carries it, and its rolling-shutter read-out time (0 = global shutter).

    ``lens_sigma`` is what its calibration left wrong, one sigma (geometry.lens.errors); ``refine_lens`` whether that is
    estimated in service.
    """

    id: str
    lens: Lens
    mount: Mount
    readout_s: float = 0.0
    refine_lens: bool = False
    lens_sigma: LensSigma = TYPICAL_SIGMA
    calibrated: date | None = None
    """When its place, or that of its head, was."""


@dataclass(frozen=True, slots=True, eq=False)
class HeadSpec:
    """One pan-tilt head; limits and the start aim are angles of docs/frames-and-units.md."""

    id: str
    kinematics: PanTilt
    pan_limits_rad: Interval
    tilt_limits_rad: Interval
    speed_rad_s: float
    auto_enable: bool = False
    bias_sigma_rad: float = 0.002
    """One sigma per axis of what read-back cannot see: backlash, mounting, zero error; shared by all frames."""
    needs_anchor: bool = False
    """Plans keep an anchor in its camera's view."""


@dataclass(frozen=True, slots=True, eq=False)
class DroneSpec:
    """One camera drone and the box it never leaves."""

    id: str
    box_m: Box
    min_separation_m: float
    speed_m_s: float
    position_sigma_m: float = 0.01
    attitude_sigma_rad: float = 0.005
    yaw_limits_rad: Interval | None = None
    """Plans choose its yaw within these; None: it keeps the yaw it has."""
    needs_anchor: bool = False
    """It navigates by what its camera sees: plans keep an anchor in view."""


@dataclass(frozen=True, slots=True, order=True)
class TagKey:
    """What a detector reads from a tag."""

    family: str
    id: int

    def __str__(self) -> str:
        return f"{self.family}:{self.id}"


@dataclass(frozen=True, slots=True, eq=False)
class BodyTag:
    """A tag on a body; ``size_m`` is the side of its black square."""

    key: TagKey
    size_m: float
    T_body_tag: Transform


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A target: a named rigid body carrying one or more tags."""

    id: str
    tags: tuple[BodyTag, ...]
    motion: str = "floor"
    """``floor`` (moves in the plane as it likes), ``drives`` (in the plane, its way turning with its heading, as wheels
    that do not slide sideways make it), ``free`` (moves in space) or ``static``.
    """
    weight: float = 1.0
    height_m: float | None = None
    """Of one on the floor: where its frame's origin always is over the plane z = 0, as far as the floor is flat."""

    @property
    def on_floor(self) -> bool:
        """Whether it stands upright on the floor and moves in its plane."""
        return self.motion in ("floor", "drives")


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A tag fixed in the room at a known pose."""

    key: TagKey
    size_m: float
    T_world_tag: Transform


@dataclass(frozen=True, slots=True)
class Space:
    """Where targets live and what stands in the way."""

    floor_m: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (5.0, 3.0))
    keep_out_m: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The whole rig; every mapping is keyed by id."""

    name: str
    space: Space
    cameras: dict[str, CameraSpec]
    heads: dict[str, HeadSpec] = field(default_factory=dict)
    drones: dict[str, DroneSpec] = field(default_factory=dict)
    targets: dict[str, Body] = field(default_factory=dict)
    anchors: tuple[Anchor, ...] = ()

    def camera_on(self, carrier: str) -> CameraSpec | None:
        """Return the camera that the head or drone ``carrier`` carries; a carrier has at most one."""
        for camera in self.cameras.values():
            match camera.mount:
                case HeadMount(head=name) | DroneMount(drone=name) if name == carrier:
                    return camera
        return None
