"""Joins LOCAL_POSITION_NED and ATTITUDE, which arrive apart, into poses of one instant each."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp, rotation_log
from camrig_drivers.mavlink.boot_clock import BootClock
from camrig_drivers.mavlink.frames import LocalFrame, R_world_body, Vector
from camrig_drivers.mavlink.packets import Attitude, LocalPosition

_MAX_GAP_S = 0.2
"""Attitudes further apart than this are not interpolated: a copter turns by degrees in that time."""


@dataclass(frozen=True, slots=True, eq=False)
class StampedPose:
    """Where the body was at ``stamp_s`` of our clock."""

    stamp_s: float
    T_world_body: Transform


class PoseTrack:
    """Keeps positions until the attitudes on both sides of them are known."""

    def __init__(self, frame: LocalFrame) -> None:
        self.clock = BootClock()
        self._frame = frame
        self._attitudes: deque[tuple[float, Array]] = deque(maxlen=32)  # boot time, R_world_body
        self._waiting: deque[tuple[float, Vector]] = deque(maxlen=16)  # boot time, world position
        self._last_stamp_s = float("-inf")
        self.position_stamp_s = float("-inf")
        """When the last position was true, in our clock."""
        self.attitude_stamp_s = float("-inf")
        """When the last attitude was."""

    def hear(self, packet: Attitude | LocalPosition, arrival_s: float) -> tuple[list[StampedPose], bool]:
        """Take one message; return the poses it completes, oldest first, and whether the autopilot has rebooted."""
        boot_s, rebooted = self.clock.update(packet.time_boot_ms, arrival_s)
        if rebooted:
            self._attitudes.clear()
            self._waiting.clear()
        match packet:
            case Attitude(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw):
                self.attitude_stamp_s = self.clock.stamp_s(boot_s)
                if not self._attitudes or boot_s > self._attitudes[-1][0]:
                    self._attitudes.append((boot_s, R_world_body(roll, pitch, yaw)))
            case LocalPosition(position_ned_m=position):
                self._waiting.append((boot_s, self._frame.world(position)))
                self.position_stamp_s = self.clock.stamp_s(boot_s)
        return self._completed(), rebooted

    def _completed(self) -> list[StampedPose]:
        """Pair what can be paired; stamps ascend, so what a router repeats or a datagram overtakes is left out."""
        poses = []
        while self._waiting and self._attitudes and self._waiting[0][0] <= self._attitudes[-1][0]:
            boot_s, position = self._waiting.popleft()
            R, stamp_s = self._attitude_at(boot_s), self.clock.stamp_s(boot_s)
            if R is not None and stamp_s > self._last_stamp_s:
                self._last_stamp_s = stamp_s
                poses.append(StampedPose(stamp_s, transform(R, np.array(position))))
        return poses

    def _attitude_at(self, boot_s: float) -> Array | None:
        """Interpolate at ``boot_s``, at or before the newest attitude; None where no two attitudes enclose it."""
        for (before_s, R_before), (after_s, R_after) in pairwise([self._attitudes[0], *self._attitudes]):
            if after_s == boot_s:
                return R_after
            if before_s <= boot_s < after_s <= before_s + _MAX_GAP_S:
                fraction = (boot_s - before_s) / (after_s - before_s)
                return np.asarray(rotation_exp(fraction * rotation_log(R_after @ R_before.T)) @ R_before)
        return None
