"""What one vehicle says about itself: the newest of everything, and the poses made of it."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from camrig_drivers.mavlink.frames import Vector, world_from_ned, yaw_enu_from_ned
from camrig_drivers.mavlink.packets import (
    Attitude,
    ExtendedState,
    Heard,
    Heartbeat,
    LocalPosition,
    StatusText,
    SystemStatus,
)
from camrig_drivers.mavlink.poses import PoseTrack, StampedPose

_log = logging.getLogger(__name__)

LINK_SILENCE_S = 3.0
FRESH_POSITION_S = 0.5
_CHUNK = 50
"""A STATUSTEXT of this many characters goes on in the next one of its id."""
_WARNING = 4


@dataclass
class Telemetry:
    """Newest values, each an immutable object, so that other threads may look at them one at a time."""

    drone_id: str
    origin_m: Vector
    heartbeat: Heartbeat
    heartbeat_s: float
    landed_state: int = 0
    system: SystemStatus | None = None
    position_m: Vector | None = None
    position_s: float = -1e9
    yaw_rad: float | None = None
    last_warning: str = ""

    def __post_init__(self) -> None:
        self._track = PoseTrack(self.origin_m)
        self._chunks: dict[int, str] = {}
        self._poses: list[StampedPose] = []

    def hear(self, packet: Heard, now_s: float) -> bool:
        """Take one message that arrived at ``now_s``; return whether it shows that the autopilot has rebooted."""
        match packet:
            case Heartbeat():
                self.heartbeat, self.heartbeat_s = packet, now_s
            case ExtendedState(landed_state=landed_state):
                self.landed_state = landed_state
            case SystemStatus():
                self.system = packet
            case StatusText():
                self._text(packet)
            case LocalPosition() | Attitude():
                return self._motion(packet, now_s)
        return False

    def take_poses(self) -> list[StampedPose]:
        """Return the poses completed since the last call, oldest first."""
        poses, self._poses = self._poses, []
        return poses

    @property
    def mode(self) -> int:
        """The custom mode, as the autopilot numbers it."""
        return self.heartbeat.custom_mode

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

    def _motion(self, packet: LocalPosition | Attitude, now_s: float) -> bool:
        match packet:
            case LocalPosition(position_ned_m=position):
                self.position_m, self.position_s = world_from_ned(position, self.origin_m), now_s
            case Attitude(yaw_rad=yaw):
                self.yaw_rad = yaw_enu_from_ned(yaw)
        poses, rebooted = self._track.hear(packet, now_s)
        self._poses += poses
        return rebooted

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
