"""The Protocols between camrig and its devices. Drivers implement them; camrig never imports a driver.

An entry point (``camrig.cameras``, ``.detectors``, ``.heads``, ``.drones``, ``.sinks``, ``.worlds``) names a
``Driver``: the model of its section of the YAML, and a function that builds its devices from all its sections.

Life cycle of everything here: build (no I/O) -> ``open`` (reads only; never moves anything) -> work -> ``close``
(twice is allowed). Trouble with a link raises ``LinkLost``, after which ``close`` and ``open`` may bring it back.
Unless a docstring says otherwise a device is used by one thread: its worker.
"""

from __future__ import annotations

from camrig.interfaces.devices import (
    Actuator,
    Camera,
    CountsItsLink,
    Drone,
    FliesByPoses,
    Guard,
    Head,
    LearnsItsAngles,
    SearchesCoarser,
    TagDetector,
    TellsItsHealth,
    TurnsByStep,
)
from camrig.interfaces.emulated import Emulator, Instant, Painter, World
from camrig.interfaces.outputs import Published, Sink
from camrig.interfaces.plugins import (
    Driver,
    Found,
    HeadTuning,
    Plugin,
    WorldPlugin,
)

__all__ = [
    "Actuator",
    "Camera",
    "CountsItsLink",
    "Driver",
    "Drone",
    "Emulator",
    "FliesByPoses",
    "Found",
    "Guard",
    "Head",
    "HeadTuning",
    "Instant",
    "LearnsItsAngles",
    "Painter",
    "Plugin",
    "Published",
    "SearchesCoarser",
    "Sink",
    "TagDetector",
    "TellsItsHealth",
    "TurnsByStep",
    "World",
    "WorldPlugin",
]
