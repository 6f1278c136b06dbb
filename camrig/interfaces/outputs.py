"""What is published, and where it goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from camrig.messages import CameraPose, Event, LinkReport, RigPlan, Sighting, Target
from camrig.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What one control tick publishes."""

    stamp_s: float
    targets: tuple[Target, ...]
    events: tuple[Event, ...] = ()
    links: tuple[LinkReport, ...] = ()
    plan: RigPlan | None = None
    sightings: tuple[Sighting, ...] = ()
    camera_poses: tuple[CameraPose, ...] = ()


class Sink(Protocol):
    """Where results go; called from the control thread, so it must not block."""

    def open(self, rig: Rig) -> None:
        """Open the output; raises InputError where it cannot be written."""
        ...

    def write(self, published: Published) -> None:
        """Take one tick's results."""
        ...

    def close(self) -> None:
        """Flush and release."""
        ...
