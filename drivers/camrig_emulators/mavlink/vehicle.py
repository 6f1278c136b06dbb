"""The emulated drone without its link: airframe, firmware and history, advanced in steps of one length."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Transform
from camrig_emulators.mavlink.ardupilot import ArduPilot
from camrig_emulators.mavlink.cockpit import Cockpit
from camrig_emulators.mavlink.dynamics import Airframe
from camrig_emulators.mavlink.firmware import Firmware
from camrig_emulators.mavlink.frames import LocalFrame
from camrig_emulators.mavlink.history import STEP_S, History
from camrig_emulators.mavlink.params import ardupilot_params, px4_params
from camrig_emulators.mavlink.px4 import Px4
from camrig_emulators.mavlink.settings import MavlinkDroneSettings

_BOOT_TIME_S = 1.2
_UP_FOR_MS = (20_000, 600_000)  # how long it has been up at the start, at random


class Vehicle:
    """One drone from ``start_s`` on. The same seed and the same calls at the same stamps give the same flight."""

    def __init__(self, settings: MavlinkDroneSettings, start_s: float, seed: int) -> None:
        self.settings = settings
        self._airframe = Airframe(settings, np.random.default_rng([seed, settings.system, 0]))
        self._uptime = np.random.default_rng([seed, settings.system, 1])
        self.history = History(start_s, self._airframe)
        self.boot_s = start_s - float(self._uptime.integers(*_UP_FOR_MS)) / 1e3
        self.silent_until_s = start_s
        self._power_up(start_s)

    def _power_up(self, now_s: float) -> None:
        settings = self.settings
        px4 = settings.flavour == "px4"
        origin = np.array(settings.origin_m)
        self.cockpit = Cockpit(
            settings=settings,
            airframe=self._airframe,
            frame=LocalFrame(
                origin, settings.origin_latitude_deg, settings.origin_longitude_deg, settings.origin_altitude_m
            ),
            params=px4_params(settings) if px4 else ardupilot_params(settings),
            sample=self.history.latest,
            ready_at_s=now_s + settings.ready_after_s,
        )
        self.cockpit.update(self.history.latest)
        self.firmware: Firmware = Px4(self.cockpit) if px4 else ArduPilot(self.cockpit)

    def reboot(self) -> None:
        """Start anew from where it stands: silent for a moment, then with a boot clock of zero and default modes."""
        now_s = self.history.latest.stamp_s
        self.boot_s = now_s
        self.silent_until_s = now_s + _BOOT_TIME_S
        self._power_up(now_s)

    def advance_to(self, now_s: float) -> None:
        """Take every step that is due by ``now_s``."""
        while self.history.next_stamp_s <= now_s:
            demand = self.firmware.step()
            self._airframe.advance(STEP_S, demand)
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
        return round((stamp_s - self.boot_s) * 1e9)
