"""Poses that somebody sends to the emulated autopilot: which messages count, in which frames, at which time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from camrig_emulators.mavlink.estimator import VisionPose
from camrig_emulators.mavlink.frames import swap_yaw, yaw_of
from camrig_emulators.mavlink.vehicle import Vehicle

_LOCAL_NED, _BODY_FRD, _LOCAL_FRD = 1, 12, 20  # MAV_FRAME
_CONVERGED_AFTER = 500  # answers to PX4's TIMESYNC
_UNIT_SLACK = 0.1


class PeerClock:
    """PX4's idea of another clock, learnt from answers to its TIMESYNC."""

    def __init__(self) -> None:
        self._answers = 0
        self._ahead_ns = 0.0

    @property
    def converged(self) -> bool:
        """Whether stamps of that clock are believed."""
        return self._answers >= _CONVERGED_AFTER

    def answered(self, theirs_ns: int, asked_ns: int, now_ns: int) -> None:
        """Take an answer; it was given halfway between question and receipt."""
        ahead_ns = theirs_ns - (asked_ns + now_ns) / 2.0
        self._answers += 1
        self._ahead_ns += (ahead_ns - self._ahead_ns) / min(self._answers, _CONVERGED_AFTER)

    def mine_ns(self, theirs_ns: float) -> float:
        """Turn a stamp of theirs into one of the vehicle's."""
        return theirs_ns - self._ahead_ns


def vision_pose(message: Any, vehicle: Vehicle, clock: PeerClock, now_s: float) -> VisionPose | None:
    """Return what VISION_POSITION_ESTIMATE or ODOMETRY tells the firmware; None where it tells nothing.

    ArduPilot takes ODOMETRY in LOCAL_FRD alone and reckons every pose to be VISO_DELAY_MS old, whatever its stamp;
    PX4 takes it in LOCAL_NED and believes stamps once the clocks are known to each other, before that the time of
    arrival. Both want the body in FRD.
    """
    px4 = vehicle.settings.flavour == "px4"
    if message.get_type() == "ODOMETRY":
        frame = _LOCAL_NED if px4 else _LOCAL_FRD
        if (message.frame_id, message.child_frame_id) != (frame, _BODY_FRD):
            return None
        if abs(math.hypot(*message.q) - 1.0) > _UNIT_SLACK or message.quality < 0:
            return None
        stamp_us, yaw_rad = message.time_usec, yaw_of(*message.q)
    else:
        stamp_us, yaw_rad = message.usec, message.yaw
    position_ned = np.array([message.x, message.y, message.z], dtype=float)
    if not (np.all(np.isfinite(position_ned)) and math.isfinite(yaw_rad)):
        return None
    place_m = vehicle.cockpit.frame.to_world(position_ned)
    stamp_s = now_s - vehicle.params["EKF2_EV_DELAY" if px4 else "VISO_DELAY_MS"] / 1e3
    if px4 and clock.converged:
        stamp_s = vehicle.boot_s + clock.mine_ns(stamp_us * 1e3) / 1e9
    return VisionPose(stamp_s, place_m, swap_yaw(yaw_rad), message.reset_counter)
