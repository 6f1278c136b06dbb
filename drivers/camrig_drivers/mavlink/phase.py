"""What we are doing with a vehicle, and what follows from that.

           arm           mode taken   armed        height reached       stop
PASSIVE ────────▶ ENTERING ─▶ ARMING ─▶ CLIMBING ────────▶ FLYING ──fault─▶ HOLDING
PASSIVE ─resume─▶ ENTERING ───── in the air already ─────────▲ ◀──resume─────┘
any state ──land, fault──▶ LANDING ─▶ DESCENDING ─▶ PASSIVE       while landing ──stop──▶ BRAKING
any state ──its mode was changed by somebody else, it was disarmed, it has rebooted──▶ PASSIVE
"""

from __future__ import annotations

from enum import Enum, auto

from camrig.messages import FlightState
from camrig_drivers.mavlink import commands
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.telemetry import Telemetry


class Phase(Enum):
    """The module's docstring draws it."""

    PASSIVE = auto()
    """Commanding nothing."""
    ENTERING = auto()
    """Asking for the mode that follows set-points."""
    ARMING = auto()
    CLIMBING = auto()
    """To the lowest height of the box."""
    FLYING = auto()
    """Following ``go_to``."""
    HOLDING = auto()
    """Stopped: set-points keep it where it is."""
    BRAKING = auto()
    """Asking for the mode that stands still without set-points."""
    LANDING = auto()
    """Asking for the landing."""
    DESCENDING = auto()
    """Landing; nothing more is asked."""


IN_OUR_MODE = {Phase.ARMING, Phase.CLIMBING, Phase.FLYING, Phase.HOLDING}
_DISARMED_GRACE_S = 2.0
"""After a stop while arming, the autopilot may still arm; its heartbeat then says so."""
WATCHED = IN_OUR_MODE
"""In these a fault is acted on."""
ENDS_DISARMED = {Phase.CLIMBING, Phase.FLYING, Phase.HOLDING}
SETTLED = {Phase.FLYING, Phase.HOLDING}
TAKING_OVER = {Phase.ENTERING, Phase.ARMING, Phase.CLIMBING, Phase.FLYING}
REFUSABLE = {
    Phase.ENTERING: commands.DO_SET_MODE,
    Phase.ARMING: commands.ARM_DISARM,
    Phase.CLIMBING: commands.NAV_TAKEOFF,
}


def allowed_modes(phase: Phase, flavour: Flavour, mode_before: int) -> set[int]:
    """Return the modes in which the vehicle is still doing what we asked of it in ``phase``."""
    match phase:
        case Phase.ENTERING:
            return {mode_before, flavour.ours}
        case Phase.BRAKING:
            return {mode_before, flavour.ours, flavour.brake}
        case Phase.LANDING:
            return {mode_before, flavour.ours, flavour.land, *flavour.failsafes}
        case Phase.DESCENDING:
            return {flavour.land}
    return {flavour.ours}


def flight_state(phase: Phase, flavour: Flavour, seen: Telemetry) -> FlightState:
    """Return what the vehicle is doing, by its own word; armed and sent up, it may rise before that is heard."""
    if phase is Phase.CLIMBING:
        return FlightState.TAKING_OFF
    if seen.on_ground:
        return FlightState.GROUND
    if not seen.airborne:
        return FlightState.UNKNOWN
    if seen.landed_state == 3:
        return FlightState.TAKING_OFF
    landing = seen.landed_state == 4 or seen.mode == flavour.land
    return FlightState.LANDING if landing else FlightState.FLYING


def set_points_flow(phase: Phase, flavour: Flavour, mode: int) -> bool:
    """Whether we stream set-points: PX4 before, in and until after its mode; ArduCopter never before lift-off.

    None while it is told to land: should it not hear that, the end of the stream brings it down.
    """
    match phase:
        case Phase.FLYING | Phase.HOLDING:
            return True
        case Phase.ENTERING | Phase.ARMING | Phase.CLIMBING:
            return flavour.set_points_must_flow
        case Phase.BRAKING:
            return flavour.set_points_must_flow and mode == flavour.ours
    return False


def taken_away(phase: Phase, flavour: Flavour, seen: Telemetry, mode_before: int, elapsed_s: float) -> str:
    """Return why the vehicle is no longer ours, ``elapsed_s`` into a phase; empty where it is, or never was."""
    landed = phase is Phase.DESCENDING and not seen.heartbeat.armed
    if phase is Phase.PASSIVE or landed:
        return ""
    if seen.mode not in allowed_modes(phase, flavour, mode_before):
        return f"a pilot, a failsafe or another station has changed its mode to {seen.mode:#x}"
    grace_s = _DISARMED_GRACE_S if phase is Phase.HOLDING else 0.0
    disarmed = phase in ENDS_DISARMED and not seen.heartbeat.armed and elapsed_s >= grace_s
    return "it has been disarmed" if disarmed else ""
