"""Why a vehicle must not be armed, or taken over in the air, now: read-only checks, each with its cure."""

from __future__ import annotations

from collections.abc import Iterator

from camrig.rig import DroneSpec
from camrig_drivers.mavlink.box import LEAST_CLIMB_M, box_text
from camrig_drivers.mavlink.commands import GIMBAL_CONFIGURE, GIMBAL_PITCHYAW
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.telemetry import Telemetry
from camrig_drivers.mavlink.vehicle import Vehicle
from camrig_drivers.mavlink.watch import STALE_S, Needs, estimator_trouble

BOX_MARGIN_M = 0.5
"""How far outside its box a drone may start: it then moves inside."""
_FRESH_LANDED_S = 3.0
_FRESH_SYSTEM_S = 3.0
_LOWEST_GROUND_M = -1.5
"""PX4 has read 489 m on the ground after a change of estimator; every set-point in the room is a climb then."""
_RESERVE = 0.1
"""Of the battery: what a flight must have above that at which it is ended."""


def unfit(vehicle: Vehicle, now_s: float) -> Iterator[str]:
    """Yield every reason why it must not be taken over now; the autopilot's own checks come on top."""
    seen, name, needs = vehicle.seen, vehicle.flavour.name, vehicle.settings.needs
    if seen.silent(now_s):
        yield f"no heartbeat for {now_s - seen.heartbeat_s:.1f} s; check its power and link"
        return
    yield from _unknown(name, seen, now_s)
    if needs.vision and now_s - vehicle.watch.seen_from_outside_s > STALE_S:
        yield "its camera sees no anchors; put it where one is in view, or take off by hand and resume it in the air"
    if needs.vision and (gap_m := vehicle.watch.disagreement_m(seen, now_s)) > BOX_MARGIN_M:
        yield f"its estimate is {gap_m:.1f} m from where its anchors put it; check origin_m, restart its estimator"
    if seen.system and seen.system.prearm_failing and not seen.heartbeat.armed:
        said = f"it says '{seen.last_warning}'" if seen.last_warning else "it gives no reason"
        yield f"{name}'s pre-arm checks fail: {said}"
    if trouble := estimator_trouble(seen, now_s):
        yield f"{trouble}; wait, or restart it"
    yield from _exhausted(seen, needs)
    if seen.position_m is not None:
        yield from _misplaced(vehicle.spec, seen.position_m, on_ground=seen.on_ground)
    if vehicle.settings.origin is not None and seen.global_origin is None:
        yield f"{name} has not taken a global origin yet; it takes one once poses arrive"
    yield from vehicle.upkeep.parameters.mismatches(needed=True)


def advice(vehicle: Vehicle) -> Iterator[str]:
    """Yield what should be otherwise, though it may fly so."""
    yield from vehicle.upkeep.parameters.mismatches(needed=False)
    if vehicle.seen.system is None or vehicle.seen.system.battery is None:
        yield "it does not tell the charge of its battery; camrig cannot land it in time"
    if vehicle.seen.estimator is None:
        yield "it does not tell how its estimator does; camrig cannot land it where that fails"
    if vehicle.settings.gimbal:
        for number, what in vehicle.errands.refused.items():
            if number in {GIMBAL_CONFIGURE, GIMBAL_PITCHYAW}:
                yield f"its gimbal's command {number} was {what}; set the mount's parameters"


def _unknown(name: str, seen: Telemetry, now_s: float) -> Iterator[str]:
    if seen.position_m is None or not (seen.position_fresh(now_s) and seen.yaw_fresh(now_s)):
        yield (
            f"{name} reports no local position and attitude; give it GPS or an external pose and wait for its "
            "estimator, and see that it takes commands from this link"
        )
    stale = seen.landed_state != 0 and now_s - seen.landed_state_s > _FRESH_LANDED_S
    if stale or not (seen.on_ground or seen.airborne):
        yield "it does not say whether it flies (EXTENDED_SYS_STATE); wait, then try again"
    if seen.system is None or now_s - seen.system_s > _FRESH_SYSTEM_S:
        yield "it does not say how it is (SYS_STATUS: battery, pre-arm checks, fence); wait, then try again"
    if seen.version is not None and not seen.version.takes_local_targets:
        yield f"{name} {seen.version.number} does not take local position targets; update its firmware"


def _exhausted(seen: Telemetry, needs: Needs) -> Iterator[str]:
    least = needs.battery + _RESERVE
    battery = seen.system.battery if seen.system else None
    if battery is not None and battery < least:
        yield f"its battery is at {100.0 * battery:.0f} %, {100.0 * least:.0f} % is the least; charge it"
    if seen.system is not None and seen.system.fence_breached:
        yield "it is outside its own fence; put it inside, or correct the fence"


def _misplaced(spec: DroneSpec, position_m: Vector, *, on_ground: bool) -> Iterator[str]:
    x, y, z = position_m
    (low_x, low_y, low_z), (high_x, high_y, high_z) = spec.box_m
    highest = min(low_z, high_z - LEAST_CLIMB_M) if on_ground else high_z + BOX_MARGIN_M
    if not _LOWEST_GROUND_M <= z <= highest:
        state = "on the ground" if on_ground else "in the air"
        yield (
            f"it reports a height of {z:.2f} m {state}, {_LOWEST_GROUND_M:g} to {highest:g} m is plausible; "
            "check origin_m, restart its estimator"
        )
    floor = ((low_x - BOX_MARGIN_M, low_y - BOX_MARGIN_M), (high_x + BOX_MARGIN_M, high_y + BOX_MARGIN_M))
    if not all(low <= value <= high for value, low, high in zip((x, y), *floor, strict=True)):
        yield (
            f"it stands at ({x:.2f}, {y:.2f}) m, outside its box {box_text(spec.box_m)}; put it below its box, "
            "or correct box_m or origin_m"
        )
