"""What the daemon's process and the world's process tell each other, pickled over one socket pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from camrig.rig import Rig
from camrig_emulators.robots import Motion
from camrig_emulators.world_section import WorldSection


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """The first message to the world: what to emulate, and the folder for its sockets and ports."""

    rig: Rig
    section: WorldSection
    devices: Mapping[str, Mapping[str, Any]]
    motions: Mapping[str, Motion]
    folder: str


@dataclass(frozen=True, slots=True)
class Ready:
    """The answer to ``Job``: the port or url of each device, and the stamp at which ``section.start_s`` was."""

    ports: Mapping[str, str]
    epoch_s: float


FaultName = Literal[
    "silent",
    "freeze",
    "echo",
    "latency_s",
    "unplug",
    "replug",
    "drop_next",
    "garble",
    "truncate_reply",
    "happen",
    "clear",
]


@dataclass(frozen=True, slots=True)
class SetFault:
    """Set a fault of a device or call it, as ``camrig_emulators.faults`` names it; a drone's ``happen``."""

    device_id: str
    name: FaultName
    arguments: tuple[float | bool | str, ...]


@dataclass(frozen=True, slots=True)
class AskCameraPose:
    """Ask for the true ``T_world_camera`` of a rendered camera at a stamp of the last seconds."""

    camera_id: str
    stamp_s: float


@dataclass(frozen=True, slots=True)
class Stop:
    """End the world; there is no answer but the end of the process."""


@dataclass(frozen=True, slots=True)
class Failed:
    """What was asked could not be done: a sentence for the user; ``input_error`` where the input is to blame."""

    text: str
    input_error: bool


Request = SetFault | AskCameraPose | Stop
