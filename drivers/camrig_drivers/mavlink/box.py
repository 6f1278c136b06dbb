"""Where a drone may be sent."""

from __future__ import annotations

from camrig.rig import Box
from camrig_drivers.mavlink.frames import Vector

_ROUNDING_M = 1e-9
LEAST_CLIMB_M = 0.7
"""Less is no take-off: it would count as done before the vehicle has left the ground."""


def inside(position_m: Vector, box_m: Box) -> bool:
    """Whether a point lies in the box or, but for rounding, on its faces. False for NaN."""
    return all(
        low - _ROUNDING_M <= value <= high + _ROUNDING_M for value, low, high in zip(position_m, *box_m, strict=True)
    )


def clamped(position_m: Vector, box_m: Box) -> Vector:
    """Return the point of the box that is nearest."""
    x, y, z = (min(max(value, low), high) for value, low, high in zip(position_m, *box_m, strict=True))
    return x, y, z


def box_text(box_m: Box) -> str:
    """Print a box as people write it."""
    low, high = (", ".join(f"{value:g}" for value in corner) for corner in box_m)
    return f"[{low}] to [{high}] m"
