"""What the emulated autopilot believes about its place: by GPS, by poses sent to it, or by nothing any more."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array
from camrig_emulators.mavlink.dynamics import Airframe
from camrig_emulators.mavlink.history import History

_POSE_EVERY_S = 0.3  # an older pose is none: at least 4 Hz are needed
_OLDEST_POSE_S = 1.0
_FARTHEST_M = 10_000.0
_CLOCK_SLACK_S = 0.05
_FUSING_TAU_S = 0.1
_GATE_M = 1.0
_GATE_OPENS_AFTER_S = 3.0
_DRIFT_M_S2 = 0.02  # measured: 0.6 m in 7.9 s
_DRIFT_DIRECTION: Array = np.array([0.8, 0.6, 0.0])


@dataclass(frozen=True, slots=True)
class Sources:
    """What the firmware was configured to navigate by when it booted."""

    gps: bool
    vision_position: bool
    vision_height: bool
    vision_yaw: bool

    @classmethod
    def of(cls, flavour: str, params: Mapping[str, float]) -> Sources:
        """Read them from a firmware's parameters."""
        if flavour == "px4":
            control = int(params["EKF2_EV_CTRL"])
            gps = params["EKF2_GPS_CTRL"] > 0 and params["SYS_HAS_GPS"] > 0
            return cls(gps, bool(control & 1) and not gps, bool(control & 2) and not gps, bool(control & 8) and not gps)
        told = params["VISO_TYPE"] > 0
        position = told and params["EK3_SRC1_POSXY"] == 6
        gps = params["GPS1_TYPE"] > 0 and params["EK3_SRC1_POSXY"] == 3
        return cls(gps, position, told and params["EK3_SRC1_POSZ"] == 6, told and params["EK3_SRC1_YAW"] == 6)


@dataclass(frozen=True, slots=True, eq=False)
class VisionPose:
    """A pose that somebody sent, in the world; ``stamp_s`` is when the firmware takes it to be true."""

    stamp_s: float
    position_m: Array
    yaw_rad: float
    reset_counter: int


class Estimator:
    """Moves the airframe's error: fused poses pull it, their loss lets it grow while what is claimed stays put."""

    def __init__(
        self,
        airframe: Airframe,
        history: History,
        sources: Sources,
        *,
        start_s: float,
        ready_after_s: float,
        converges_s: float,
        needs_origin: bool,
    ) -> None:
        self.sources = sources
        self._airframe = airframe
        self._history = history
        self._now_s = start_s
        self._ready_at_s = start_s + ready_after_s
        self._converges_s = converges_s
        self._needs_origin = needs_origin
        self._origin_told = False
        self._first_pose_s = self._fused_s = -math.inf
        self._reset_counter: int | None = None
        self._aided_s = start_s
        self.blinded = False
        """A fault: neither GPS nor poses come through."""
        airframe.offset_m, airframe.offset_m_s, airframe.offset_yaw_rad = np.zeros(3), np.zeros(3), 0.0
        airframe.wanders = airframe.wanders and sources.gps

    @property
    def local(self) -> bool:
        """Whether it claims a local position; once it does, it goes on."""
        if self.sources.gps:
            return self._now_s >= self._ready_at_s
        return self._first_pose_s > -math.inf and self._now_s >= self._first_pose_s + self._converges_s

    @property
    def origin_known(self) -> bool:
        """Whether its local origin has a place on the globe."""
        return self._origin_told or (self.sources.gps and self.local)

    @property
    def aided(self) -> bool:
        """Whether what it navigates by comes through."""
        if self.sources.gps:
            return self.local and not self.blinded
        return not self.blinded and self._now_s - self._fused_s <= _POSE_EVERY_S

    @property
    def ready(self) -> bool:
        """Whether its firmware lets it arm."""
        return self.local and self.aided and (self.origin_known or not self._needs_origin)

    @property
    def lost_s(self) -> float:
        """Seconds since anything aided it."""
        return self._now_s - self._aided_s

    def tell_origin(self) -> bool:
        """Take a place on the globe for the origin; returns whether it was new."""
        new, self._origin_told = not self.origin_known, True
        return new

    def advance(self, now_s: float, *, flying: bool) -> None:
        """Let a step go by."""
        dt_s, self._now_s = now_s - self._now_s, now_s
        body = self._airframe
        if self.aided:
            self._aided_s = now_s
            body.offset_m_s = np.zeros(3)
        elif self.local and flying:
            body.offset_m_s = body.offset_m_s - dt_s * _DRIFT_M_S2 * _DRIFT_DIRECTION
            body.offset_m = body.offset_m + dt_s * body.offset_m_s

    def fail(self) -> None:
        """Be without aid, and for so long that every patience is over."""
        self.blinded, self._aided_s = True, -math.inf

    def jump(self, offset_m: Array) -> None:
        """Believe to be elsewhere all at once."""
        self._airframe.offset_m = self._airframe.offset_m + offset_m

    def see(self, pose: VisionPose) -> None:
        """Fuse a pose; what is far off is not believed unless its reset counter says so, or nothing else comes."""
        if self.blinded or self.sources.gps or not self.sources.vision_position:
            return
        newest_s = self._history.latest.stamp_s
        if np.any(np.abs(pose.position_m) > _FARTHEST_M):
            return
        if not newest_s - _OLDEST_POSE_S <= pose.stamp_s <= newest_s + _CLOCK_SLACK_S:
            return
        truth = self._history.truth(min(pose.stamp_s, newest_s))
        offset_m = pose.position_m - truth.position_m
        if not self.sources.vision_height:
            offset_m = np.array([offset_m[0], offset_m[1], self._airframe.offset_m[2]])
        since_s = self._now_s - self._fused_s
        innovation_m = float(np.linalg.norm(offset_m - self._airframe.offset_m))
        afresh = self._reset_counter != pose.reset_counter or since_s > _GATE_OPENS_AFTER_S
        if innovation_m > _GATE_M and not afresh:
            return
        gain = 1.0 if afresh else 1.0 - math.exp(-since_s / _FUSING_TAU_S)
        body = self._airframe
        body.offset_m = body.offset_m + gain * (offset_m - body.offset_m)
        if self.sources.vision_yaw:
            turn_rad = math.remainder(pose.yaw_rad - truth.yaw_rad - body.offset_yaw_rad, math.tau)
            body.offset_yaw_rad += gain * turn_rad
        self._reset_counter, self._fused_s = pose.reset_counter, self._now_s
        if self._first_pose_s == -math.inf:
            self._first_pose_s = self._now_s
