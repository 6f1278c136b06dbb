"""What both emulated firmwares have in common: arming, touching the floor, what they say, simple manoeuvres."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig_emulators.mavlink.battery import Battery
from camrig_emulators.mavlink.dynamics import Airframe, Demand
from camrig_emulators.mavlink.estimator import Estimator
from camrig_emulators.mavlink.frames import LocalFrame
from camrig_emulators.mavlink.history import Sample
from camrig_emulators.mavlink.mount import Mount
from camrig_emulators.mavlink.params import Params
from camrig_emulators.mavlink.settings import MavlinkDroneSettings

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4  # MAV_RESULT
CRITICAL, WARNING, INFO = 2, 4, 6  # MAV_SEVERITY
FORCE = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM

REACHED_M = 0.1
_LANDED_AFTER_S = 0.2
_NEAR_HOME_M = 0.3


@dataclass(frozen=True, slots=True)
class Text:
    """A STATUSTEXT; numbers go up by one."""

    number: int
    severity: int
    text: str


@dataclass(eq=False)
class Cockpit:
    """State that both firmwares read and write; times are of the emulator's clock, places in the world."""

    settings: MavlinkDroneSettings
    airframe: Airframe
    frame: LocalFrame
    params: Params
    sample: Sample
    estimator: Estimator
    battery: Battery
    mount: Mount | None
    armed: bool = False
    landed: bool = True
    flown: bool = False
    """Whether it has left the floor since it was armed."""
    critical: bool = False
    home_m: Array | None = None
    fence_breach: int = 0
    """FENCE_BREACH: 0 none, 2 height, 3 distance."""
    ignores_speed: bool = False
    """A fault: a change of speed is acknowledged and forgotten."""
    texts: deque[Text] = field(default_factory=lambda: deque(maxlen=100))
    _texts_said: int = 0
    _armed_at_s: float = -math.inf
    _touched_s: float = -math.inf

    @property
    def now_s(self) -> float:
        """The time of the newest sample."""
        return self.sample.stamp_s

    @property
    def ready(self) -> bool:
        """Whether the estimator knows where it is, well enough to arm."""
        return self.estimator.ready

    @property
    def yaw_rad(self) -> float:
        """Estimated heading in the world."""
        return self.sample.truth.yaw_rad + float(self.sample.attitude_error_rad[2])

    @property
    def armed_s(self) -> float:
        """Seconds since it was armed."""
        return self.now_s - self._armed_at_s

    @property
    def landed_s(self) -> float:
        """Seconds since the floor or the arming, whichever came last."""
        return self.now_s - max(self._touched_s, self._armed_at_s)

    def update(self, sample: Sample) -> None:
        """Take the newest sample; works out whether it stands on the floor."""
        self.sample = sample
        if self.mount is not None:
            self.mount.advance(sample.stamp_s)
        if self.home_m is None and self.ready:
            self.home_m = sample.position_m
        if not self.airframe.on_floor:
            self._touched_s = math.inf
            self.flown = self.armed
        elif self._touched_s == math.inf:
            self._touched_s = self.now_s
        self.landed = self.now_s - self._touched_s >= _LANDED_AFTER_S

    def say(self, severity: int, text: str) -> None:
        """Put a STATUSTEXT on record for all links."""
        self._texts_said += 1
        self.texts.append(Text(self._texts_said, severity, text))

    def tell_origin(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> bool:
        """Place the local origin on the globe; what is there stays. Returns whether it had none before."""
        if not self.estimator.tell_origin():
            return False
        self.frame = replace(self.frame, latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m)
        return True

    def arm(self) -> None:
        """Arm here; this place becomes home."""
        self.armed, self.flown, self._armed_at_s = True, False, self.now_s
        self.home_m = self.sample.position_m

    def disarm(self) -> None:
        """Stop the rotors, wherever it is."""
        self.armed = self.critical = False

    def stop_here(self) -> Demand:
        """Come to rest as soon as the acceleration limit allows, heading kept."""
        velocity = self.sample.velocity_m_s
        braking_s = float(np.linalg.norm(velocity)) / (2.0 * self.settings.acceleration_m_s2)
        return Demand(position_m=self.sample.position_m + velocity * braking_s, yaw_rad=self.yaw_rad)

    def sink(self, place: Demand, speed_m_s: float, *, adrift: bool = False) -> Demand | None:
        """Descend over a place, or adrift, until the floor carries it."""
        if self.landed:
            return None
        x, y, _ = place.position_m
        down = np.array([np.nan, np.nan, -speed_m_s])
        return Demand(position_m=np.array([x, y, np.nan]), velocity_m_s=down, yaw_rad=place.yaw_rad, adrift=adrift)

    def watch_fence(self, height_m: float, radius_m: float) -> str | None:
        """Judge the place by limits above and around home, 0 for none; return what was breached just now."""
        breach = 0
        if self.home_m is not None and self.armed:
            away = self.sample.position_m - self.home_m
            too_far = 0.0 < radius_m < float(np.hypot(away[0], away[1]))
            breach = 2 if 0.0 < height_m < away[2] else 3 if too_far else 0
        new = breach not in {0, self.fence_breach}
        self.fence_breach = breach
        return {2: "height", 3: "distance"}[breach] if new else None


@dataclass(eq=False)
class ReturnHome:
    """Climb to ``altitude_m`` over home, fly there, land: what neither room nor camera likes."""

    altitude_m: float
    land_speed_m_s: float
    start: Demand
    _climbed: bool = False
    _over_home: bool = False

    def demand(self, cockpit: Cockpit) -> Demand | None:
        """Return what to fly now."""
        if cockpit.landed or cockpit.home_m is None:
            return None
        home = cockpit.home_m
        height_m = max(float(home[2]) + self.altitude_m, float(self.start.position_m[2]))
        position = cockpit.sample.position_m
        self._climbed = self._climbed or abs(height_m - float(position[2])) < _NEAR_HOME_M
        self._over_home = self._climbed and (
            self._over_home or float(np.linalg.norm(home[:2] - position[:2])) < _NEAR_HOME_M
        )
        over = home[:2] if self._climbed else self.start.position_m[:2]
        place = Demand(position_m=np.array([over[0], over[1], height_m]), yaw_rad=self.start.yaw_rad)
        return cockpit.sink(place, self.land_speed_m_s) if self._over_home else place
