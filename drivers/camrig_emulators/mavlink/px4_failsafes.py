"""PX4's failsafes that last: data link, battery, geofence. Each speaks once and names a mode."""

from __future__ import annotations

import math

from camrig_emulators.mavlink.cockpit import CRITICAL, INFO, WARNING, Cockpit
from camrig_emulators.mavlink.px4_modes import HOLD, LAND, RTL

_DATA_LINK_CHECK_S = 2.0  # measured: 12 s with COM_DL_LOSS_T 10
_TALKS_FOR_S = 2.5  # STATUSTEXTs wait while no ground station is heard
_DATA_LINK_LOSS_MODES = {1: HOLD, 2: RTL, 3: LAND}  # NAV_DLL_ACT
_GEOFENCE_MODES = {2: HOLD, 3: RTL, 5: LAND}  # GF_ACTION
_BATTERY_MODES = {2: LAND, 3: RTL}  # COM_LOW_BAT_ACT, at the critical level


class Px4Failsafes:
    """``step`` returns the mode that a failsafe asks for now, None for none; nothing goes back when its cause does."""

    def __init__(self, cockpit: Cockpit) -> None:
        self._cockpit = cockpit
        self._ground_station_s = -math.inf
        self._data_link_lost = False
        self._battery_levels = ["LOW", "CRIT"]

    @property
    def ground_station_heard(self) -> bool:
        """Whether one has beaten lately."""
        return self._cockpit.now_s - self._ground_station_s < _TALKS_FOR_S

    def ground_station_beat(self) -> None:
        """Take note of a HEARTBEAT."""
        self._ground_station_s = self._cockpit.now_s
        if self._data_link_lost:
            self._data_link_lost = False
            self._cockpit.say(INFO, "Ground station connection regained")

    def step(self) -> int | None:
        """Look at everything."""
        modes = [self._data_link(), self._battery(), self._geofence()]
        return next((mode for mode in modes if mode is not None), None)

    def _data_link(self) -> int | None:
        cockpit = self._cockpit
        silent_s = cockpit.now_s - self._ground_station_s
        if self._data_link_lost or silent_s < cockpit.params["COM_DL_LOSS_T"] + _DATA_LINK_CHECK_S:
            return None
        if math.isinf(silent_s):
            return None  # nobody has been there yet
        self._data_link_lost = True
        cockpit.say(WARNING, "Connection to ground station lost")
        return _DATA_LINK_LOSS_MODES.get(int(cockpit.params["NAV_DLL_ACT"]))

    def _battery(self) -> int | None:
        cockpit = self._cockpit
        charge = cockpit.battery.charge(cockpit.now_s)
        for level in self._battery_levels:
            if charge < cockpit.params[f"BAT_{level}_THR"]:
                self._battery_levels.remove(level)
                if level == "LOW":
                    cockpit.say(WARNING, "Low battery level")
                    return None
                cockpit.say(CRITICAL, "Critical battery level")
                return _BATTERY_MODES.get(int(cockpit.params["COM_LOW_BAT_ACT"]))
        return None

    def _geofence(self) -> int | None:
        params = self._cockpit.params
        breached = self._cockpit.watch_fence(params["GF_MAX_VER_DIST"], params["GF_MAX_HOR_DIST"])
        if breached is None:
            return None
        self._cockpit.say(CRITICAL, f"Geofence violation: maximum {breached}")
        return _GEOFENCE_MODES.get(int(params["GF_ACTION"]))
