"""What we are doing with a vehicle, and what follows from that.

           arm           mode taken   armed        height reached       stop
PASSIVE ────────▶ ENTERING ─▶ ARMING ─▶ CLIMBING ────────▶ FLYING ────────▶ HOLDING
                     └────────── in the air already ──────────▲ ◀─────arm─────┘
any state ──land──▶ LANDING ─▶ DESCENDING ─▶ PASSIVE       while landing ──stop──▶ BRAKING
"""

from __future__ import annotations

from enum import Enum, auto

from camrig.messages import FlightState
from camrig_drivers.mavlink import packets
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
ENDS_DISARMED = {Phase.CLIMBING, Phase.FLYING, Phase.HOLDING}
TAKING_OVER = {Phase.ENTERING, Phase.ARMING, Phase.CLIMBING, Phase.FLYING}
REFUSABLE = {Phase.ENTERING: packets.DO_SET_MODE, Phase.ARMING: packets.ARM_DISARM, Phase.CLIMBING: packets.NAV_TAKEOFF}


def allowed_modes(phase: Phase, flavour: Flavour, mode_before: int) -> set[int]:
    """Return the modes in which the vehicle is still doing what we asked of it in ``phase``."""
    match phase:
        case Phase.ENTERING:
            return {mode_before, flavour.ours}
        case Phase.BRAKING:
            return {mode_before, flavour.ours, flavour.brake}
        case Phase.LANDING:
            return {mode_before, flavour.ours, flavour.land}
        case Phase.DESCENDING:
            return {flavour.land}
    return {flavour.ours}


def flight_state(phase: Phase, flavour: Flavour, seen: Telemetry) -> FlightState:
    """Return what the vehicle is doing, by its own word."""
    if seen.on_ground:
        return FlightState.GROUND
    if not seen.airborne:
        return FlightState.UNKNOWN
    if seen.landed_state == 3 or phase is Phase.CLIMBING:
        return FlightState.TAKING_OFF
    landing = seen.landed_state == 4 or seen.mode == flavour.land
    return FlightState.LANDING if landing else FlightState.FLYING


def set_points_flow(phase: Phase, flavour: Flavour, mode: int) -> bool:
    """Whether we stream set-points: PX4 before, in and until after its mode; ArduCopter never before lift-off."""
    match phase:
        case Phase.FLYING | Phase.HOLDING:
            return True
        case Phase.ENTERING | Phase.ARMING | Phase.CLIMBING:
            return flavour.set_points_must_flow
        case Phase.BRAKING | Phase.LANDING:
            return flavour.set_points_must_flow and mode == flavour.ours
    return False
