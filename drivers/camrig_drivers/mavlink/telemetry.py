"""What one vehicle says about itself: the newest of everything, and the poses made of it."""

from __future__ import annotations

import logging
import math
from dataclasses import InitVar, dataclass

from camrig_drivers.mavlink.frames import LocalFrame, Vector, yaw_enu_from_ned
from camrig_drivers.mavlink.packets import (
    Attitude,
    Estimator,
    ExtendedState,
    GimbalAttitude,
    GlobalOrigin,
    Heard,
    Heartbeat,
    LocalPosition,
    StatusText,
    SystemStatus,
    TimeSync,
    Version,
)
from camrig_drivers.mavlink.poses import PoseTrack, StampedPose

_log = logging.getLogger(__name__)

LINK_SILENCE_S = 3.0
FRESH_POSITION_S = 0.5
_CHUNK = 50
"""A STATUSTEXT of this many characters goes on in the next one of its id."""
_WARNING = 4
_JUMP_M = 0.5
_FASTEST_M_S = 5.0
"""No drone in a room moves faster; an estimate that does has jumped."""
_WANDERED_M = 0.15
"""A height on the ground that is off by more is no noise."""
_NEVER_S = -1e9


@dataclass
class Telemetry:
    """Newest values, each an immutable object, so that other threads may look at them one at a time."""

    drone_id: str
    origin_m: InitVar[Vector]
    heartbeat: Heartbeat
    heartbeat_s: float
    landed_state: int = 0
    landed_state_s: float = _NEVER_S
    system: SystemStatus | None = None
    system_s: float = _NEVER_S
    version: Version | None = None
    estimator: Estimator | None = None
    estimator_s: float = _NEVER_S
    global_origin: GlobalOrigin | None = None
    gimbal: GimbalAttitude | None = None
    gimbal_s: float = _NEVER_S
    position_m: Vector | None = None
    position_s: float = _NEVER_S
    """When it was there by its own clock: a link may hold messages back and go on delivering them, seconds old."""
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    yaw_rad: float | None = None
    yaw_s: float = _NEVER_S
    """When that was so, as of ``position_s``."""
    jump_m: float = 0.0
    """How far the last position lay from where the one before and its speed could have led; 0 where it fitted."""
    last_warning: str = ""

    def __post_init__(self, origin_m: Vector) -> None:
        self.frame = LocalFrame(origin_m)
        self._track = PoseTrack(self.frame)
        self._chunks: dict[int, str] = {}
        self._poses: list[StampedPose] = []

    def hear(self, packet: Heard, now_s: float) -> bool:
        """Take one message that arrived at ``now_s``; return whether it shows that the autopilot has rebooted."""
        match packet:
            case Heartbeat():
                self.heartbeat, self.heartbeat_s = packet, now_s
            case ExtendedState(landed_state=landed_state):
                self.landed_state, self.landed_state_s = landed_state, now_s
            case SystemStatus():
                self.system, self.system_s = packet, now_s
            case StatusText():
                self._text(packet)
            case Estimator():
                self.estimator, self.estimator_s = packet, now_s
            case Version():
                self.version = packet
            case GlobalOrigin():
                self.global_origin = packet
            case GimbalAttitude():
                self.gimbal, self.gimbal_s = packet, now_s
            case TimeSync(tc1=theirs_ns, ts1=asked_ns) if theirs_ns:
                self._track.clock.synchronise(asked_ns / 1e9, theirs_ns / 1e9, now_s)
            case LocalPosition() | Attitude():
                return self._motion(packet, now_s)
        return False

    @property
    def synchronised(self) -> bool:
        """Whether TIMESYNC tells the offset of its clock, and not the shortest delay alone."""
        return self._track.clock.synchronised

    def level(self, height_m: float) -> None:
        """Believe the floor on which it stands rather than a height that has wandered since it was switched on."""
        if self.position_m is None or not self.on_ground:
            return
        x, y, z = self.position_m
        if abs(z - height_m) > _WANDERED_M:
            self.frame.raise_by(height_m - z)
            self.position_m = (x, y, height_m)

    def take_poses(self) -> list[StampedPose]:
        """Return the poses completed since the last call, oldest first."""
        poses, self._poses = self._poses, []
        return poses

    @property
    def mode(self) -> int:
        """The custom mode, as the autopilot numbers it."""
        return self.heartbeat.custom_mode

    @property
    def height_m(self) -> float:
        """Height in the world; 0 where it is not known yet."""
        return self.position_m[2] if self.position_m else 0.0

    @property
    def on_ground(self) -> bool:
        """Said to be on the ground; a disarmed vehicle that says nothing is taken to be there too."""
        return self.landed_state == 1 or (self.landed_state == 0 and not self.heartbeat.armed)

    @property
    def airborne(self) -> bool:
        """Said to be off the ground; neither this nor ``on_ground`` while an armed vehicle says nothing."""
        return self.landed_state in (2, 3, 4)

    def silent(self, now_s: float) -> bool:
        """Whether the heartbeat has been missing for too long."""
        return now_s - self.heartbeat_s > LINK_SILENCE_S

    def position_fresh(self, now_s: float) -> bool:
        """Whether the local position is recent enough to steer by."""
        return now_s - self.position_s <= FRESH_POSITION_S

    def yaw_fresh(self, now_s: float) -> bool:
        """Whether the heading is recent enough to steer by."""
        return now_s - self.yaw_s <= FRESH_POSITION_S

    def _motion(self, packet: LocalPosition | Attitude, now_s: float) -> bool:
        poses, rebooted = self._track.hear(packet, now_s)
        self._poses += poses
        match packet:
            case LocalPosition(position_ned_m=position, velocity_ned_m_s=(north, east, down)):
                self._place(self.frame.world(position), min(now_s, self._track.position_stamp_s))
                self.velocity_m_s = (east, north, -down)
            case Attitude(yaw_rad=yaw):
                self.yaw_rad, self.yaw_s = yaw_enu_from_ned(yaw), min(now_s, self._track.attitude_stamp_s)
        if rebooted:
            self.global_origin = self.version = self.estimator = self.gimbal = self.system = None
            self.landed_state = 0
        return rebooted

    def _place(self, position_m: Vector, stamp_s: float) -> None:
        self.jump_m = 0.0
        if self.position_m is not None:
            moved_m = math.dist(position_m, self.position_m)
            possible_m = _JUMP_M + _FASTEST_M_S * max(0.0, stamp_s - self.position_s)
            self.jump_m = moved_m if moved_m > possible_m else 0.0
        self.position_m, self.position_s = position_m, stamp_s

    def _text(self, packet: StatusText) -> None:
        text = packet.text
        if packet.id:
            text = (self._chunks.pop(packet.id, "") if packet.chunk else "") + text
            if len(packet.text) == _CHUNK:
                self._chunks = {packet.id: text}
                return
        text = text.rstrip()
        if packet.severity <= _WARNING:
            self.last_warning = text
            _log.warning("drone %s says: %s", self.drone_id, text)
        else:
            _log.info("drone %s says: %s", self.drone_id, text)
