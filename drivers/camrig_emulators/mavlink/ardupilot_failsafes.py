"""ArduCopter's failsafes: ground station, estimator, battery, fence. Each speaks once and names a mode."""

from __future__ import annotations

from camrig_emulators.mavlink.ardupilot_modes import BRAKE, LAND, RTL
from camrig_emulators.mavlink.cockpit import CRITICAL, INFO, WARNING, Cockpit

_GROUND_STATION_MODES = {1: RTL, 3: RTL, 4: LAND, 5: LAND, 7: LAND}  # FS_GCS_ENABLE
_BATTERY_MODES = {1: LAND, 2: RTL}  # BATT_FS_LOW_ACT, BATT_FS_CRT_ACT
_FENCE_MODES = {1: RTL, 2: LAND, 4: BRAKE}  # FENCE_ACTION
_FENCE_HEIGHT, _FENCE_CIRCLE = 1, 2  # FENCE_TYPE
_ESTIMATOR_PATIENCE_S = 7.9  # measured


class ArduPilotFailsafes:
    """``step`` returns the mode that a failsafe asks for now, None for none; nothing goes back when its cause does."""

    def __init__(self, cockpit: Cockpit) -> None:
        self.ground_station_lost = False
        self._cockpit = cockpit
        self._ground_station_s = cockpit.now_s
        self._estimator_failed = self._uses_poses = False
        self._battery_levels = ["LOW", "CRT"]

    def ground_station_beat(self, system: int) -> None:
        """Take note of a HEARTBEAT; only the ground station that the parameters name counts."""
        if system != self._cockpit.params["MAV_GCS_SYSID"]:
            return
        self._ground_station_s = self._cockpit.now_s
        if self.ground_station_lost:
            self.ground_station_lost = False
            self._cockpit.say(WARNING, "GCS Failsafe Cleared")

    def step(self) -> int | None:
        """Look at everything."""
        modes = [self._ground_station(), self._estimator(), self._battery(), self._fence()]
        return next((mode for mode in modes if mode is not None), None)

    def _ground_station(self) -> int | None:
        cockpit = self._cockpit
        action = int(cockpit.params["FS_GCS_ENABLE"])
        if action == 0:
            self.ground_station_lost = False
            return None
        silent = cockpit.now_s - self._ground_station_s > cockpit.params["FS_GCS_TIMEOUT"]
        if not silent or self.ground_station_lost:
            return None
        self.ground_station_lost = True
        cockpit.say(CRITICAL, "GCS Failsafe")
        return _GROUND_STATION_MODES.get(action, LAND)

    def _estimator(self) -> int | None:
        cockpit = self._cockpit
        estimator = cockpit.estimator
        if estimator.sources.vision_position and estimator.local and not self._uses_poses:
            self._uses_poses = True
            cockpit.say(INFO, "EKF3 IMU0 is using external nav data")
        failed = estimator.local and estimator.lost_s > _ESTIMATOR_PATIENCE_S
        new, self._estimator_failed = failed and not self._estimator_failed, failed
        if not new or not cockpit.armed or cockpit.landed:
            return None
        cockpit.say(CRITICAL, "EKF variance")
        if cockpit.params["FS_EKF_ACTION"] == 0:
            return None
        cockpit.say(CRITICAL, "EKF Failsafe: changed to LAND Mode")
        return LAND

    def _battery(self) -> int | None:
        """Limits are in mAh that are left; 0 turns one off."""
        cockpit = self._cockpit
        left_mah = cockpit.battery.charge(cockpit.now_s) * cockpit.params["BATT_CAPACITY"]
        for level in self._battery_levels:
            if left_mah < cockpit.params[f"BATT_{level}_MAH"]:
                self._battery_levels.remove(level)
                name = {"LOW": "low", "CRT": "critical"}[level]
                cockpit.say(WARNING, f"Battery 1 is {name} {cockpit.battery.voltage_V(cockpit.now_s):.2f}V")
                return _BATTERY_MODES.get(int(cockpit.params[f"BATT_FS_{level}_ACT"]))
        return None

    def _fence(self) -> int | None:
        params = self._cockpit.params
        kinds = int(params["FENCE_TYPE"]) if params["FENCE_ENABLE"] else 0
        height_m = params["FENCE_ALT_MAX"] if kinds & _FENCE_HEIGHT else 0.0
        radius_m = params["FENCE_RADIUS"] if kinds & _FENCE_CIRCLE else 0.0
        breached = self._cockpit.watch_fence(height_m, radius_m)
        if breached is None:
            return None
        self._cockpit.say(WARNING, {"height": "Max Alt", "distance": "Circle"}[breached] + " fence breached")
        return _FENCE_MODES.get(int(params["FENCE_ACTION"]))
