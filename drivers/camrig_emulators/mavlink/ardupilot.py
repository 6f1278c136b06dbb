"""ArduCopter's habits, as measured on 4.7 in simulation without a remote control."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camrig_emulators.mavlink.cockpit import (
    ACCEPTED,
    CRITICAL,
    FAILED,
    FORCE,
    INFO,
    REACHED_M,
    UNSUPPORTED,
    WARNING,
    Cockpit,
    ReturnHome,
)
from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.firmware import CommandParams, whole
from camrig_emulators.mavlink.frames import swap_yaw
from camrig_emulators.mavlink.set_points import SetPoint, ardupilot_goal

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, POSHOLD, BRAKE = 0, 2, 3, 4, 5, 6, 9, 16, 17
MODES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    AUTO: "AUTO",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    LAND: "LAND",
    POSHOLD: "POSHOLD",
    BRAKE: "BRAKE",
}
_STICK_MODES = (ALT_HOLD, LOITER, POSHOLD)  # zero throttle without a remote control: they sink
_SINK_M_S = 2.4
_SPOOL_UP_S = 0.5
_NOT_ARMABLE = (AUTO, RTL, LAND, BRAKE)
_FAILSAFE_MODES = {1: RTL, 3: RTL, 4: LAND, 5: LAND, 7: LAND}  # FS_GCS_ENABLE


class ArduPilot:
    """A ``Firmware``."""

    autopilot = 3
    default_streams_hz = {0: 1.0, 111: 0.3}  # noqa: RUF012 - HEARTBEAT, TIMESYNC and nothing else until asked
    text_ending = ""
    heartbeat_delay_s = 0.0
    double_ack_rate = 0.0

    def __init__(self, cockpit: Cockpit) -> None:
        self._cockpit = cockpit
        self._mode = STABILIZE
        self._goal = Demand()
        self._goal_ends_s = math.inf
        self._take_off: Demand | None = None
        self._take_off_at_s = 0.0
        self._return: ReturnHome | None = None
        self._speed_m_s = math.inf
        self._climb_m_s = math.inf
        self._ground_station_s = cockpit.now_s
        self._ground_station_lost = False

    @property
    def custom_mode(self) -> int:
        return self._mode

    @property
    def mode_name(self) -> str:
        return MODES[self._mode]

    @property
    def landed_state(self) -> int:
        if self._cockpit.landed:
            return 1
        if self._mode == LAND:
            return 4
        return 3 if self._take_off is not None else 2

    @property
    def talks(self) -> bool:
        return True

    def ground_station_beat(self, system: int) -> None:
        if system != self._cockpit.params["MAV_GCS_SYSID"]:
            return
        self._ground_station_s = self._cockpit.now_s
        if self._ground_station_lost:
            self._ground_station_lost = False
            self._cockpit.say(WARNING, "GCS Failsafe Cleared")

    def step(self) -> Demand | None:
        self._watch_ground_station()
        self._disarm_on_floor()
        return self._demand() if self._cockpit.armed else None

    def _demand(self) -> Demand | None:
        cockpit = self._cockpit
        if self._mode == GUIDED:
            return self._guided()
        if self._mode in _STICK_MODES:
            return cockpit.sink(self._goal, _SINK_M_S)
        if self._mode == LAND:
            return cockpit.sink(self._goal, cockpit.params["LAND_SPEED"] / 100.0)
        if self._return is not None:
            return self._return.demand(cockpit)
        if self._mode == BRAKE and not cockpit.landed:
            return self._goal
        return None  # STABILIZE at zero throttle

    def _guided(self) -> Demand | None:
        if self._take_off is not None:
            return self._taking_off(self._take_off)
        if self._cockpit.landed:
            return None
        if self._cockpit.now_s > self._goal_ends_s:
            self._hold_here()
        return replace(self._goal, speed_m_s=self._speed_m_s, climb_m_s=self._climb_m_s)

    def _taking_off(self, place: Demand) -> Demand | None:
        if self._cockpit.now_s < self._take_off_at_s:
            return None
        if abs(float(place.position_m[2] - self._cockpit.sample.position_m[2])) < REACHED_M:
            self._goal, self._goal_ends_s, self._take_off = place, math.inf, None
        return place

    def _hold_here(self) -> None:
        self._goal, self._goal_ends_s = self._cockpit.stop_here(), math.inf

    def _disarm_on_floor(self) -> None:
        cockpit = self._cockpit
        if not (cockpit.armed and cockpit.landed):
            return
        down = self._mode in {LAND, RTL}
        if cockpit.landed_s >= (cockpit.settings.land_disarm_s if down else cockpit.params["DISARM_DELAY"]):
            self._disarm("Disarming motors")

    def _disarm(self, text: str) -> None:
        self._cockpit.disarm()
        self._take_off = None
        self._cockpit.say(INFO, text)

    def _watch_ground_station(self) -> None:
        cockpit = self._cockpit
        action = int(cockpit.params["FS_GCS_ENABLE"])
        if action == 0:
            self._ground_station_lost = False
            return
        silent = cockpit.now_s - self._ground_station_s > cockpit.params["FS_GCS_TIMEOUT"]
        if not silent or self._ground_station_lost:
            return
        self._ground_station_lost = True
        cockpit.say(CRITICAL, "GCS Failsafe")
        if cockpit.armed and cockpit.landed:
            self._disarm("Disarming motors")
        elif cockpit.armed:
            self._enter(_FAILSAFE_MODES.get(action, LAND))

    # --- commands -----------------------------------------------------------------------------------------

    def command(self, command: int, params: CommandParams) -> int | None:
        match command:
            case 176:
                return self._set_mode(whole(params[1])) if whole(params[0]) & 1 else FAILED
            case 400:
                return self._arm(params[1]) if params[0] >= 0.5 else self._disarm_asked(params[1])
            case 22:
                return self._start_take_off(params[6])
            case 21:
                return self._set_mode(LAND)
            case 20:
                return self._set_mode(RTL)
            case 178:
                return self._change_speed(whole(params[0]), params[1])
            case 115:
                return self._turn(params)
            case 205 | 1000 | 1001:
                return FAILED  # no mount
        return UNSUPPORTED

    def _set_mode(self, mode: int) -> int:
        if mode not in MODES:
            self._cockpit.say(WARNING, f"No such mode {mode & 0xFF}")
            return FAILED
        if mode == AUTO:
            self._cockpit.say(WARNING, "Mode change to AUTO failed: no mission")
            return FAILED
        if mode in {GUIDED, RTL, BRAKE} and not self._cockpit.ready:
            self._cockpit.say(WARNING, f"Mode change to {MODES[mode]} failed: requires position")
            return FAILED
        self._enter(mode)
        return ACCEPTED

    def _enter(self, mode: int) -> None:
        cockpit = self._cockpit
        if mode == self._mode:
            return
        self._mode = mode
        self._take_off = None
        self._hold_here()
        self._speed_m_s, self._climb_m_s = cockpit.params["WPNAV_SPEED"] / 100.0, math.inf
        land_m_s = cockpit.params["LAND_SPEED"] / 100.0
        self._return = ReturnHome(cockpit.params["RTL_ALT"] / 100.0, land_m_s, self._goal) if mode == RTL else None

    def _arm(self, force: float) -> int:
        cockpit = self._cockpit
        refusals = {
            "AHRS: waiting for home": not cockpit.ready,
            f"{self.mode_name} mode not armable": self._mode in _NOT_ARMABLE,
            "GCS failsafe on": self._ground_station_lost,
        }
        if cockpit.armed:
            return ACCEPTED
        for reason, holds in refusals.items():
            if holds and force != FORCE:
                cockpit.say(CRITICAL, f"Arm: {reason}")
                return FAILED
        cockpit.arm()
        self._hold_here()
        cockpit.say(INFO, "Arming motors")
        return ACCEPTED

    def _disarm_asked(self, force: float) -> int:
        if self._cockpit.armed and not self._cockpit.landed and force != FORCE:
            return FAILED
        if self._cockpit.armed:
            self._disarm("Disarming motors")
        return ACCEPTED

    def _start_take_off(self, height_m: float) -> int:
        cockpit = self._cockpit
        able = self._mode == GUIDED and cockpit.armed and cockpit.landed and cockpit.home_m is not None
        if not able or not 0.0 < height_m < math.inf or cockpit.home_m is None:
            return FAILED
        x, y, _ = cockpit.sample.position_m
        target_m = np.array([x, y, cockpit.home_m[2] + height_m])
        self._take_off = Demand(position_m=target_m, yaw_rad=cockpit.yaw_rad)
        self._take_off_at_s = cockpit.now_s + _SPOOL_UP_S
        return ACCEPTED

    def _change_speed(self, kind: int, speed_m_s: float) -> int:
        if kind not in {0, 1, 2, 3} or not speed_m_s > 0.0:
            return FAILED
        if kind < 2:
            self._speed_m_s = speed_m_s
        else:
            self._climb_m_s = speed_m_s
        return ACCEPTED

    def _turn(self, params: CommandParams) -> int:
        if self._mode != GUIDED or not self._cockpit.armed or not math.isfinite(params[0]):
            return FAILED
        if params[3] == 1.0:  # relative; positive is clockwise
            yaw_rad = self._goal.yaw_rad - math.copysign(math.radians(params[0]), params[2] or 1.0)
        else:
            yaw_rad = swap_yaw(math.radians(params[0]))
        self._goal = replace(self._goal, yaw_rad=yaw_rad)
        return ACCEPTED

    # --- set-points ---------------------------------------------------------------------------------------

    def set_point(self, point: SetPoint) -> None:
        """Outside GUIDED nothing happens, without a word; before lift-off a set-point cancels the take-off."""
        if self._mode != GUIDED:
            return
        cockpit, kept = self._cockpit, self._goal.yaw_rad
        self._take_off = None
        goal = ardupilot_goal(point, cockpit, cockpit.yaw_rad if math.isnan(kept) else kept)
        if goal is None:
            self._hold_here()
            return
        moving = not np.any(np.isnan(goal.velocity_m_s))
        self._goal = goal
        self._goal_ends_s = cockpit.now_s + cockpit.params["GUID_TIMEOUT"] if moving else math.inf
