"""What steering goes by, and what it remembers from tick to tick."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camrig.geometry.arrays import Array
from camrig.messages import DroneAim, HeadAim


@dataclass(frozen=True, slots=True)
class SteerSettings:
    """Moves smaller than a dead band are not commanded; a drone's set-point leads by what it flies in ``lead_s``.

    What has not come to its aim is told again after ``retry_s``; so often, too, a way round is looked for.
    """

    dead_band_rad: float = math.radians(0.3)
    dead_band_m: float = 0.03
    lead_s: float = 1.0
    retry_s: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Where a drone is bound for, and the point that it flies straight to: the end, or a way round's corner."""

    end_m: Array
    point_m: Array
    going: bool = False
    """It was let go and has not arrived: who is on the way has the right of way."""
    rounded: bool = False
    """It was given a way round already: one for each end, or drones would dance round each other for ever."""

    @property
    def straight(self) -> bool:
        """Whether it flies straight to its end."""
        return self.point_m is self.end_m


@dataclass(frozen=True, slots=True)
class SteerState:
    """What was commanded last, by head and drone id, and which drones are held back now, with the reason."""

    head_aims: Mapping[str, tuple[HeadAim, float]] = field(default_factory=dict)
    """The aim, and when it was commanded."""
    setpoints: Mapping[str, tuple[DroneAim, float]] = field(default_factory=dict)
    """As far as this a drone flies without a new command, and when it was told; kept until it is on the ground."""
    legs: Mapping[str, Leg] = field(default_factory=dict)
    in_way: frozenset[str] = frozenset()
    """Who would make way for another by a move smaller than the dead band."""
    sought_s: float = -math.inf
    """When a way round was looked for last."""
    held: Mapping[str, str] = field(default_factory=dict)
