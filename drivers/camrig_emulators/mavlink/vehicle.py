"""The emulated drone without its links: airframe, firmware and history, advanced in steps of one length."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Transform
from camrig_emulators.mavlink.ardupilot import ArduPilot
from camrig_emulators.mavlink.battery import Battery
from camrig_emulators.mavlink.cockpit import Cockpit
from camrig_emulators.mavlink.dynamics import Airframe
from camrig_emulators.mavlink.estimator import Estimator, Sources
from camrig_emulators.mavlink.firmware import Firmware
from camrig_emulators.mavlink.frames import LocalFrame
from camrig_emulators.mavlink.history import STEP_S, History
from camrig_emulators.mavlink.mount import Mount
from camrig_emulators.mavlink.params import Params
from camrig_emulators.mavlink.px4 import Px4
from camrig_emulators.mavlink.settings import MavlinkDroneSettings

_BOOT_TIME_S = 1.2
_LAST_NS = 2.0**62
_UP_FOR_MS = (20_000, 600_000)  # how long it has been up at the start, at random


@dataclass(slots=True)
class SigningKey:
    """What SETUP_SIGNING told; kept over a reboot. ``timestamp`` (10 us since 2015) was right at ``since_s``."""

    key: bytes
    timestamp: int
    since_s: float

    def timestamp_at(self, now_s: float) -> int:
        """Return the time for a packet that leaves now."""
        return self.timestamp + round(1e5 * max(0.0, now_s - self.since_s))


class Vehicle:
    """One drone from ``start_s`` on. The same seed and the same calls at the same stamps give the same flight."""

    def __init__(self, settings: MavlinkDroneSettings, start_s: float, seed: int) -> None:
        self.settings = settings
        self._airframe = Airframe(settings, np.random.default_rng([seed, settings.system, 0]))
        self._uptime = np.random.default_rng([seed, settings.system, 1])
        self.history = History(start_s, self._airframe)
        self.boot_s = start_s - float(self._uptime.integers(*_UP_FOR_MS)) / 1e3
        self.silent_until_s = start_s
        self.boots = 1
        self.signing: SigningKey | None = None
        self.on_step: Callable[[float], None] = _nothing
        """Called with the stamp of every step before it is taken: here scripted faults happen."""
        self.params = Params(settings.flavour, settings.release, {**_as_settings_say(settings), **settings.params})
        self.battery = Battery(settings.battery, start_s)
        self._power_up(start_s)

    def _power_up(self, now_s: float) -> None:
        settings = self.settings
        px4 = settings.flavour == "px4"
        sources = Sources.of(settings.flavour, self.params.snapshot())
        estimator = Estimator(
            self._airframe,
            self.history,
            sources,
            start_s=now_s,
            ready_after_s=settings.ready_after_s,
            converges_s=settings.vision_converges_s,
            needs_origin=not px4,
        )
        self.cockpit = Cockpit(
            settings=settings,
            airframe=self._airframe,
            frame=LocalFrame(
                np.array(settings.origin_m),
                settings.origin_latitude_deg,
                settings.origin_longitude_deg,
                settings.origin_altitude_m,
            ),
            params=self.params,
            sample=self.history.latest,
            estimator=estimator,
            battery=self.battery,
            mount=self._mount(now_s),
        )
        self.cockpit.update(self.history.latest)
        self.firmware: Firmware = Px4(self.cockpit) if px4 else ArduPilot(self.cockpit)

    def _mount(self, now_s: float) -> Mount | None:
        if self.settings.flavour == "px4":
            return Mount((-math.pi / 2.0, math.pi / 4.0), now_s) if self.params["MNT_MODE_IN"] >= 0 else None
        limits_rad = (math.radians(self.params["MNT1_PITCH_MIN"]), math.radians(self.params["MNT1_PITCH_MAX"]))
        return Mount(limits_rad, now_s) if self.params["MNT1_TYPE"] > 0 else None

    @property
    def wind_m_s(self) -> float:
        """Of the wind, which blows to the east."""
        return self._airframe.wind_m_s

    @wind_m_s.setter
    def wind_m_s(self, speed: float) -> None:
        self._airframe.wind_m_s = speed

    def reboot(self) -> None:
        """Start anew from where it stands: silent for a moment, then with a boot clock of zero and default modes."""
        now_s = self.history.latest.stamp_s
        self.boots += 1
        self.boot_s = now_s
        self.silent_until_s = now_s + _BOOT_TIME_S
        self._power_up(now_s)

    def advance_to(self, now_s: float) -> None:
        """Take every step that is due by ``now_s``."""
        while self.history.next_stamp_s <= now_s:
            self.on_step(self.history.next_stamp_s)
            demand = self.firmware.step()
            self._airframe.advance(STEP_S, demand)
            self.cockpit.estimator.advance(self.history.next_stamp_s, flying=not self._airframe.on_floor)
            self.history.append()
            self.cockpit.update(self.history.latest)

    def T_world_body(self, stamp_s: float) -> Transform:
        """Return the true pose at any stamp of the last 20 s; raises ValueError outside."""
        self.advance_to(stamp_s + STEP_S)
        return self.history.truth(stamp_s).T_world_body()

    def boot_ms(self, stamp_s: float) -> int:
        """Return a stamp on the vehicle's own clock, as time_boot_ms carries it."""
        return round((stamp_s - self.boot_s) * 1e3) & 0xFFFFFFFF

    def boot_ns(self, stamp_s: float) -> int:
        """Return a stamp on the vehicle's own clock, as TIMESYNC carries it."""
        return round(max(-_LAST_NS, min(_LAST_NS, (stamp_s - self.boot_s) * 1e9)))


def _nothing(stamp_s: float) -> None:
    """Let nothing happen."""


def _as_settings_say(settings: MavlinkDroneSettings) -> dict[str, float]:
    if settings.flavour == "px4":
        return {
            "MAV_SYS_ID": settings.system,
            "COM_DISARM_LAND": settings.land_disarm_s,
            "MPC_XY_VEL_MAX": settings.max_speed_m_s,
            "MPC_LAND_SPEED": settings.land_speed_m_s,
        }
    return {
        "MAV_SYSID": settings.system,
        "WPNAV_SPEED": 100.0 * settings.max_speed_m_s,
        "LAND_SPEED": 100.0 * settings.land_speed_m_s,
    }
