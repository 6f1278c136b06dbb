"""Whether a drone may climb where it stands: who is on the ground is in nobody's way, and then suddenly is. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from camrig.rig import Rig

LEAD_S = 1.5
"""A drone in the air may fly on to its set-point for so long before it is told to wait."""


def take_off_obstacle(name: str, place_m: tuple[float, ...], aloft_m: Mapping[str, tuple[float, ...]], rig: Rig) -> str:
    """Return which drone in the air is too near to the place where one is to take off, or an empty text."""
    drone = rig.drones[name]
    for other, there_m in sorted(aloft_m.items()):
        least_m = max(drone.min_separation_m, rig.drones[other].min_separation_m)
        least_m += LEAD_S * rig.drones[other].speed_m_s
        gap_m = math.dist(place_m[:2], there_m[:2])
        if other != name and gap_m < least_m:
            return (
                f"drone {other} flies {gap_m:.2f} m beside it, {least_m:.2f} m is the least; land or move one of them"
            )
    return ""
