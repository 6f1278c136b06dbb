"""Why a vehicle must not be armed or taken over now: read-only checks, each with its cure."""

from __future__ import annotations

from camrig.rig import Box, DroneSpec
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.telemetry import Telemetry

BOX_MARGIN_M = 0.5
"""How far outside its box a drone may start: it then moves inside."""
_ROUNDING_M = 1e-9
_LOWEST_GROUND_M = -1.5
"""PX4 has read 489 m on the ground after a change of estimator; every set-point in the room is a climb then."""


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


def unfit(spec: DroneSpec, flavour: Flavour, seen: Telemetry, now_s: float) -> str | None:
    """Return why ``arm`` is refused, or None; the autopilot's own checks come on top."""
    if seen.silent(now_s):
        return f"no heartbeat for {now_s - seen.heartbeat_s:.1f} s; check its power and link"
    if seen.position_m is None or seen.yaw_rad is None or not seen.position_fresh(now_s):
        return f"{flavour.name} reports no local position; give it GPS or an external pose and wait for its estimator"
    if not seen.on_ground and not seen.airborne:
        return "it does not say whether it flies (EXTENDED_SYS_STATE); wait, then try again"
    if seen.system and seen.system.prearm_failing and not seen.heartbeat.armed:
        said = f"it says '{seen.last_warning}'" if seen.last_warning else "it gives no reason"
        return f"{flavour.name}'s pre-arm checks fail: {said}"
    return _misplaced(spec, seen.position_m, on_ground=seen.on_ground)


def _misplaced(spec: DroneSpec, position_m: Vector, *, on_ground: bool) -> str | None:
    x, y, z = position_m
    (low_x, low_y, low_z), (high_x, high_y, high_z) = spec.box_m
    highest = low_z if on_ground else high_z + BOX_MARGIN_M
    if not _LOWEST_GROUND_M <= z <= highest:
        state = "on the ground" if on_ground else "in the air"
        return (
            f"it reports a height of {z:.2f} m {state}, {_LOWEST_GROUND_M:g} to {highest:g} m is plausible; "
            "check origin_m, restart its estimator"
        )
    floor = ((low_x - BOX_MARGIN_M, low_y - BOX_MARGIN_M), (high_x + BOX_MARGIN_M, high_y + BOX_MARGIN_M))
    if not all(low <= value <= high for value, low, high in zip((x, y), *floor, strict=True)):
        return (
            f"it stands at ({x:.2f}, {y:.2f}) m, outside its box {box_text(spec.box_m)}; put it below its box, "
            "or correct box_m or origin_m"
        )
    return None
