"""What the pipeline remembers between ticks, what goes into a tick, and what comes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig import fuse
from camrig.interfaces import Published
from camrig.locate import AS_CALIBRATED, Drift, Histories, Lenses, View
from camrig.messages import (
    AxisReading,
    CameraPose,
    Command,
    DroneReading,
    Event,
    Expected,
    FlightState,
    LinkReport,
    PlannerAnswer,
    PlannerRequest,
    TagDetections,
)
from camrig.optimise import PlannerSettings
from camrig.pipeline.mission import Mission, MissionSettings
from camrig.steer import SteerSettings, SteerState


@dataclass(frozen=True)
class Settings:
    """How the rig is planned, fused and steered."""

    planner: PlannerSettings
    mission: MissionSettings = field(default_factory=MissionSettings)
    fuse: fuse.Settings = field(default_factory=fuse.Settings)
    steer: SteerSettings = field(default_factory=SteerSettings)


@dataclass(frozen=True)
class Inputs:
    """Everything that arrived since the last tick."""

    detections: tuple[TagDetections, ...] = ()
    axis_readings: tuple[AxisReading, ...] = ()
    drone_readings: tuple[DroneReading, ...] = ()
    links: tuple[LinkReport, ...] = ()
    answer: PlannerAnswer | None = None
    enabled: frozenset[str] = frozenset()
    """Heads that may move, and drones that obey us."""
    begin: frozenset[str] = frozenset()
    """Drones that an operator has sent up: still on the ground, each needs the room above its place already."""
    events: tuple[Event, ...] = ()


@dataclass(frozen=True)
class Outputs:
    """Everything a tick wants done."""

    published: Published
    request: PlannerRequest | None = None
    commands: tuple[Command, ...] = ()
    expected: tuple[Expected, ...] | None = None
    """Where tags are expected; a camera that is not among them looks at its whole pictures. None: as before."""
    head_angles: tuple[AxisReading, ...] = ()
    """What cameras saw of their heads' angles by anchors: for drivers that have no better way to know them."""


@dataclass(frozen=True)
class State:
    """The pipeline's whole memory."""

    mission: Mission
    tracks: fuse.Tracks
    histories: Histories = field(default_factory=Histories)
    pending: tuple[TagDetections, ...] = ()
    """Frames whose camera's pose is not bracketed by readings yet."""
    views: Mapping[str, View] = field(default_factory=dict)
    """What each camera's newest frame showed."""
    camera_poses: Mapping[str, CameraPose] = field(default_factory=dict)
    """The last known pose of each camera."""
    drifts: Mapping[str, Drift] = field(default_factory=dict)
    """How far each fixed camera, or camera on a head, is from where its calibration puts it."""
    lenses: Lenses = AS_CALIBRATED
    """What was learnt of the cameras' lenses since the start."""
    steer: SteerState = field(default_factory=SteerState)
    flight: Mapping[str, FlightState] = field(default_factory=dict)
    links: Mapping[str, LinkReport] = field(default_factory=dict)
    said_s: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """When each event was last published, by subject and text: a lasting cause is not repeated in every frame."""


def begin(now_s: float) -> State:
    """Return the state before anything has been seen."""
    return State(mission=Mission(started_s=now_s), tracks=fuse.Tracks())
