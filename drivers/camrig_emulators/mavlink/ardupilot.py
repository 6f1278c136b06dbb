"""ArduCopter's habits, as measured on 4.7 in simulation without a remote control."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camrig_emulators.mavlink.ardupilot_failsafes import ArduPilotFailsafes
from camrig_emulators.mavlink.ardupilot_modes import (
    ALT_HOLD,
    AUTO,
    BRAKE,
    GUIDED,
    GUIDED_NOGPS,
    LAND,
    LOITER,
    MODES,
    POSHOLD,
    RTL,
    STABILIZE,
)
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
from camrig_emulators.mavlink.commands import Cmd
from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.firmware import CommandParams, whole
from camrig_emulators.mavlink.frames import swap_yaw
from camrig_emulators.mavlink.set_points import SetPoint, ardupilot_goal
from camrig_emulators.mavlink.streams import ARDUPILOT_STREAMS_HZ

_STICK_MODES = (ALT_HOLD, LOITER, POSHOLD, GUIDED_NOGPS)  # zero throttle without a remote control: they sink
_SINK_M_S = 2.4
_SPOOL_UP_S = 0.5
_NOT_ARMABLE = (AUTO, RTL, LAND, BRAKE)
_NEEDS_POSITION = (GUIDED, LOITER, RTL, POSHOLD, BRAKE)
_DEFAULT_TURN_DEG_S = 30.0


class ArduPilot:
    """A ``Firmware``."""

    autopilot = 3
    default_streams_hz = ARDUPILOT_STREAMS_HZ
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
        self._failsafes = ArduPilotFailsafes(cockpit)

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
    def goal(self) -> Demand:
        return self._goal

    @property
    def talks(self) -> bool:
        return True

    @property
    def modes(self) -> dict[str, int]:
        return {name.lower(): number for number, name in MODES.items()}

    def ground_station_beat(self, system: int) -> None:
        self._failsafes.ground_station_beat(system)

    def parameter_set(self, name: str) -> None:
        """Nothing changes at once: what it navigates by is read at the next boot."""

    def step(self) -> Demand | None:
        cockpit = self._cockpit
        mode = self._failsafes.step()
        if mode is not None and cockpit.landed and cockpit.armed:
            self._disarm("Disarming motors")
        elif mode is not None and cockpit.armed:
            self._enter(mode)
        self._disarm_on_floor()
        return self._demand() if cockpit.armed else None

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

    # --- commands -----------------------------------------------------------------------------------------

    def command(self, command: int, params: CommandParams) -> int | None:
        match command:
            case Cmd.SET_MODE:
                return self.change_mode(whole(params[1])) if whole(params[0]) & 1 else FAILED
            case Cmd.ARM_DISARM:
                return self._arm(params[1]) if params[0] >= 0.5 else self._disarm_asked(params[1])
            case Cmd.TAKEOFF:
                return self._start_take_off(params[6])
            case Cmd.LAND:
                return self.change_mode(LAND)
            case Cmd.RETURN_TO_LAUNCH:
                return self.change_mode(RTL)
            case Cmd.CHANGE_SPEED:
                return self._change_speed(whole(params[0]), params[1])
            case Cmd.CONDITION_YAW:
                return self._turn(params)
            case Cmd.MOUNT_CONTROL:
                return self._point_mount(params[0], params[2], 0) if whole(params[6]) == 2 else FAILED
            case Cmd.GIMBAL_PITCH_YAW:
                return self._point_mount(params[0], params[1], whole(params[4]))
            case Cmd.GIMBAL_CONFIGURE:
                return FAILED if self._cockpit.mount is None else ACCEPTED  # accepted, and not needed
        return UNSUPPORTED

    def _point_mount(self, pitch_deg: float, yaw_deg: float, flags: int) -> int:
        if self._cockpit.mount is None:
            return FAILED
        self._cockpit.mount.point(pitch_deg, yaw_deg, flags)
        return ACCEPTED

    def change_mode(self, mode: int) -> int:
        if mode not in MODES:
            self._cockpit.say(WARNING, f"No such mode {mode & 0xFF}")
            return FAILED
        if mode == AUTO:
            self._cockpit.say(WARNING, "Mode change to AUTO failed: no mission")
            return FAILED
        if mode in _NEEDS_POSITION and not self._cockpit.estimator.local:
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
        estimator = cockpit.estimator
        refusals = {
            "VisOdom: not healthy": estimator.sources.vision_position and not estimator.aided,
            "AHRS: waiting for home": not (estimator.local and estimator.origin_known),
            f"{self.mode_name} mode not armable": self._mode in _NOT_ARMABLE,
            "GCS failsafe on": self._failsafes.ground_station_lost,
        }
        if cockpit.armed:
            return ACCEPTED
        reasons = [reason for reason, holds in refusals.items() if holds and force != FORCE]
        for reason in reasons:
            cockpit.say(CRITICAL, f"Arm: {reason}")
        if reasons:
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
        if self._cockpit.ignores_speed:
            return ACCEPTED
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
        rate_deg_s = params[1] if 0.0 < params[1] < math.inf else _DEFAULT_TURN_DEG_S
        self._goal = replace(self._goal, yaw_rad=yaw_rad, turn_rad_s=math.radians(rate_deg_s))
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
        moving = not (np.any(np.isnan(goal.velocity_m_s)) and np.any(np.isnan(goal.acceleration_m_s2)))
        self._goal = goal
        self._goal_ends_s = cockpit.now_s + cockpit.params["GUID_TIMEOUT"] if moving else math.inf
