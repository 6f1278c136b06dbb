"""What differs between ArduCopter and PX4, as data; measured on ArduCopter 4.7 and PX4 1.17."""

from __future__ import annotations

import math
from dataclasses import dataclass

from camrig_drivers.mavlink.packets import Command, set_mode


@dataclass(frozen=True, slots=True)
class Flavour:
    """One autopilot's habits.

    ``ours`` is the mode in which it follows set-points. ``brake`` is a mode in which it stands still without any.
    ``lead_s`` is how long set-points must flow before it takes that mode, ``set_point_loss_s`` after which gap between
    two of them it leaves it. ``set_points_must_flow``: it needs them all the
    time, and takes off when they rise.
    """

    name: str
    autopilot: int
    ours: int
    brake: int
    land: int
    set_point_period_s: float
    lead_s: float
    set_point_loss_s: float
    set_points_must_flow: bool

    def set_mode(self, custom_mode: int) -> Command:
        """Ask for a mode: ArduPilot's are plain numbers, PX4's a main and a sub mode in the upper half."""
        if custom_mode < 1 << 16:
            return set_mode(float(custom_mode), 0.0)
        return set_mode(float(custom_mode >> 16 & 0xFF), float(custom_mode >> 24))


ARDUCOPTER = Flavour(
    name="ArduCopter",
    autopilot=3,
    ours=4,  # GUIDED
    brake=4,  # GUIDED without a target stands; BRAKE would do too, LOITER without RC descends
    land=9,
    set_point_period_s=0.2,  # a position target never times out; repeated against lost packets
    lead_s=0.0,
    set_point_loss_s=math.inf,
    set_points_must_flow=False,  # and a set-point before lift-off cancels NAV_TAKEOFF silently
)
PX4 = Flavour(
    name="PX4",
    autopilot=12,
    ours=0x00060000,  # OFFBOARD
    brake=0x03040000,  # HOLD
    land=0x06040000,
    set_point_period_s=0.05,
    lead_s=1.0,
    set_point_loss_s=1.0,  # COM_OF_LOSS_T
    set_points_must_flow=True,  # NAV_TAKEOFF's height would be above sea level
)
FLAVOURS = {flavour.autopilot: flavour for flavour in (ARDUCOPTER, PX4)}
