"""What differs between ArduCopter and PX4, as data; measured on ArduCopter 4.7 and PX4 1.17."""

from __future__ import annotations

import math
from dataclasses import dataclass

from camrig_drivers.mavlink.commands import set_mode
from camrig_drivers.mavlink.packets import Command


@dataclass(frozen=True, slots=True)
class Flavour:
    """One autopilot's habits.

    ``ours`` is the mode in which it follows set-points. ``brake`` is a mode in which it stands still without any.
    ``lead_s`` is how long set-points must flow before it takes that mode, ``set_point_loss_s`` after which gap between
    two of them it may leave it. ``set_points_must_flow``: it needs them all the time, and takes off when they rise.
    ``raw_integers``: PARAM_VALUE carries an integer's bits. ``keeps_speed``: it flies to a set-point at a speed of its
    own, which it forgets when it enters the mode.
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
    raw_integers: bool
    keeps_speed: bool
    estimator_message: int
    """EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
    takes_odometry: bool
    """Poses from outside come as ODOMETRY; else as VISION_POSITION_ESTIMATE."""
    failsafes: frozenset[int]
    """Modes that it enters by itself: while it is told to land they take it away from nobody."""
    wants_origin: bool
    """Without GPS it arms only once it has been told a place on the globe."""

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
    raw_integers=False,
    keeps_speed=True,
    estimator_message=193,
    failsafes=frozenset({6, 9, 17}),  # RTL, LAND, BRAKE
    takes_odometry=False,  # it would want frames LOCAL_FRD and BODY_FRD
    wants_origin=True,
)
PX4 = Flavour(
    name="PX4",
    autopilot=12,
    ours=0x00060000,  # OFFBOARD
    brake=0x03040000,  # HOLD
    land=0x06040000,
    set_point_period_s=0.05,
    lead_s=1.0,
    set_point_loss_s=0.8,  # COM_OF_LOSS_T is 1 s, between arrivals: a link adds its jitter to our gaps
    set_points_must_flow=True,  # NAV_TAKEOFF's height would be above sea level
    raw_integers=True,
    keeps_speed=False,
    estimator_message=230,
    failsafes=frozenset({0x03040000, 0x05040000, 0x06040000}),  # HOLD, RTL, LAND
    takes_odometry=True,
    wants_origin=False,
)
FLAVOURS = {flavour.autopilot: flavour for flavour in (ARDUCOPTER, PX4)}
