"""PX4's habits, as measured on v1.17 in simulation without a remote control."""

from __future__ import annotations

import math

import numpy as np

from camrig_emulators.mavlink.cockpit import (
    ACCEPTED,
    CRITICAL,
    FORCE,
    INFO,
    REACHED_M,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    WARNING,
    Cockpit,
    ReturnHome,
)
from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.firmware import CommandParams, whole
from camrig_emulators.mavlink.set_points import PX4_FRAMES, SetPoint, px4_goal


def custom_mode(main: int, sub: int = 0) -> int:
    """Pack PX4's main and sub mode as HEARTBEAT carries them."""
    return main << 16 | sub << 24


OFFBOARD, HOLD, TAKEOFF = custom_mode(6), custom_mode(4, 3), custom_mode(4, 2)
MISSION, RTL, LAND = custom_mode(4, 4), custom_mode(4, 5), custom_mode(4, 6)
MODES = {
    custom_mode(1): "Manual",
    custom_mode(2): "Altitude",
    custom_mode(3): "Position",
    OFFBOARD: "Offboard",
    HOLD: "Hold",
    TAKEOFF: "Takeoff",
    MISSION: "Mission",
    RTL: "Return",
    LAND: "Land",
}
_SPOOL_UP_S = 1.0
_LIFT_OFF_M = 0.1
_DATA_LINK_CHECK_S = 2.0  # measured: 12 s with COM_DL_LOSS_T 10
_TALKS_FOR_S = 2.5  # STATUSTEXTs wait while no ground station is heard
_OFFBOARD_LOSS_MODES = {4: LAND, 5: HOLD}  # COM_OBL_RC_ACT; all others need a remote control and become RTL
_DATA_LINK_LOSS_MODES = {1: HOLD, 2: RTL, 3: LAND}  # NAV_DLL_ACT


class Px4:
    """A ``Firmware``. ``_intent`` is the mode last asked for, ``_failsafe`` the one that overrides it."""

    autopilot = 12
    default_streams_hz = {  # noqa: RUF012 - pushed unasked
        0: 1.0,  # HEARTBEAT
        1: 5.0,  # SYS_STATUS
        24: 1.0,  # GPS_RAW_INT
        30: 100.0,  # ATTITUDE
        31: 50.0,  # ATTITUDE_QUATERNION
        32: 30.0,  # LOCAL_POSITION_NED
        33: 50.0,  # GLOBAL_POSITION_INT
        111: 10.0,  # TIMESYNC
        147: 0.5,  # BATTERY_STATUS
        242: 0.5,  # HOME_POSITION
        245: 5.0,  # EXTENDED_SYS_STATE
    }
    text_ending = "\t"
    heartbeat_delay_s = 0.4
    double_ack_rate = 0.1

    def __init__(self, cockpit: Cockpit) -> None:
        self._cockpit = cockpit
        self._intent = HOLD
        self._failsafe: int | None = None
        self._goal = cockpit.stop_here()
        self._return: ReturnHome | None = None
        self._set_point_s = -math.inf
        self._stream_lost_s = math.inf
        self._ground_station_s = -math.inf
        self._data_link_lost = False

    @property
    def custom_mode(self) -> int:
        return self._intent if self._failsafe is None else self._failsafe

    @property
    def mode_name(self) -> str:
        return MODES[self.custom_mode]

    @property
    def landed_state(self) -> int:
        if self._cockpit.landed:
            return 1
        return {TAKEOFF: 3, LAND: 4}.get(self.custom_mode, 2)

    @property
    def talks(self) -> bool:
        return self._cockpit.now_s - self._ground_station_s < _TALKS_FOR_S

    @property
    def _streaming(self) -> bool:
        return self._cockpit.now_s - self._set_point_s <= self._cockpit.params["COM_OF_LOSS_T"]

    def ground_station_beat(self, system: int) -> None:
        del system  # PX4 takes any ground station
        self._ground_station_s = self._cockpit.now_s
        if self._data_link_lost:
            self._data_link_lost = False
            self._cockpit.say(INFO, "Ground station connection regained")

    def step(self) -> Demand | None:
        self._watch_stream()
        self._watch_ground_station()
        self._disarm_on_floor()
        return self._demand() if self._cockpit.armed else None

    def _demand(self) -> Demand | None:
        cockpit, mode = self._cockpit, self.custom_mode
        if mode in {OFFBOARD, TAKEOFF}:
            return self._climbing_off(mode)
        if mode == LAND:
            return cockpit.sink(self._goal, cockpit.params["MPC_LAND_SPEED"])
        if self._return is not None:
            return self._return.demand(cockpit)
        return None if cockpit.landed else self._goal

    def _climbing_off(self, mode: int) -> Demand | None:
        """Lift off by take-off or by a set-point above the floor, and fly what was asked."""
        cockpit, goal = self._cockpit, self._goal
        above_m = float(goal.position_m[2] - cockpit.sample.position_m[2])
        if cockpit.landed:
            up = above_m > _LIFT_OFF_M or float(goal.velocity_m_s[2]) > _LIFT_OFF_M
            return goal if up and cockpit.armed_s >= _SPOOL_UP_S else None
        if mode == TAKEOFF and above_m < REACHED_M:
            self._enter(HOLD, goal)
        return goal

    # --- failsafes ----------------------------------------------------------------------------------------

    def _watch_stream(self) -> None:
        """Without set-points OFFBOARD becomes Hold, then the action; with them it comes back by itself."""
        cockpit = self._cockpit
        if self._intent != OFFBOARD or not cockpit.armed or self._streaming:
            self._stream_lost_s = math.inf
            if self._failsafe is not None:
                self._fail_over(None)
            return
        if self._failsafe is None:
            self._stream_lost_s = cockpit.now_s
            cockpit.say(CRITICAL, "Failsafe activated: no offboard signal")
            self._fail_over(HOLD)
        elif cockpit.now_s - self._stream_lost_s >= cockpit.params["COM_FAIL_ACT_T"]:
            self._fail_over(_OFFBOARD_LOSS_MODES.get(int(cockpit.params["COM_OBL_RC_ACT"]), RTL))

    def _fail_over(self, mode: int | None) -> None:
        if mode == self._failsafe:
            return
        self._failsafe = mode
        self._cockpit.critical = mode is not None
        self._hold_here()
        self._prepare_return()

    def _watch_ground_station(self) -> None:
        cockpit = self._cockpit
        silent_s = cockpit.now_s - self._ground_station_s
        if self._data_link_lost or silent_s < cockpit.params["COM_DL_LOSS_T"] + _DATA_LINK_CHECK_S:
            return
        if math.isinf(silent_s):
            return  # nobody has been there yet
        self._data_link_lost = True
        cockpit.say(WARNING, "Connection to ground station lost")
        action = _DATA_LINK_LOSS_MODES.get(int(cockpit.params["NAV_DLL_ACT"]))
        if action is not None and cockpit.armed:
            self._enter(action)

    def _disarm_on_floor(self) -> None:
        cockpit = self._cockpit
        if not (cockpit.armed and cockpit.landed):
            return
        delay_s = cockpit.params["COM_DISARM_LAND" if cockpit.flown else "COM_DISARM_PRFLT"]
        if cockpit.landed_s >= delay_s:
            self._disarm("Disarmed by landing" if cockpit.flown else "Disarmed by auto preflight disarming")

    def _disarm(self, text: str) -> None:
        self._cockpit.disarm()
        self._cockpit.say(INFO, text)
        if self._intent in {LAND, RTL, TAKEOFF}:
            self._enter(HOLD)

    # --- commands -----------------------------------------------------------------------------------------

    def command(self, command: int, params: CommandParams) -> int | None:
        match command:
            case 176:
                self._set_mode(whole(params[1]), whole(params[2]))
                return ACCEPTED  # whatever became of it: only HEARTBEAT tells
            case 400:
                return self._arm(params[1]) if params[0] >= 0.5 else self._disarm_asked(params[1])
            case 22:
                return self._take_off(params[6])
            case 21:
                return self._set_mode(4, 6)
            case 20:
                return self._set_mode(4, 5)
            case 178:
                return ACCEPTED  # of no effect in OFFBOARD
            case 205 | 1000 | 1001:
                return None  # no gimbal module runs, so nobody answers
        return UNSUPPORTED

    def _set_mode(self, main: int, sub: int) -> int:
        mode = custom_mode(main, sub) if 0 <= main <= 255 and 0 <= sub <= 255 else -1
        if mode == TAKEOFF:
            return self._take_off(math.nan)
        flyable = mode in {HOLD, RTL, LAND} or (mode == OFFBOARD and self._streaming)
        if not flyable or not self._cockpit.ready:
            if mode in MODES:
                self._cockpit.say(CRITICAL, f"Switching to {MODES[mode]} is currently not available")
            return TEMPORARILY_REJECTED
        self._enter(mode)
        return ACCEPTED

    def _enter(self, mode: int, goal: Demand | None = None) -> None:
        if mode != self.custom_mode:
            self._hold_here()
        if goal is not None:
            self._goal = goal
        self._intent, self._failsafe, self._cockpit.critical = mode, None, False
        self._prepare_return()

    def _hold_here(self) -> None:
        self._goal = self._cockpit.stop_here()

    def _prepare_return(self) -> None:
        params = self._cockpit.params
        returning = self.custom_mode == RTL
        self._return = ReturnHome(params["RTL_RETURN_ALT"], params["MPC_LAND_SPEED"], self._goal) if returning else None

    def _arm(self, force: float) -> int:
        cockpit = self._cockpit
        if cockpit.armed:
            return ACCEPTED
        refusals = {
            "Arming denied: Resolve system health failures first": not cockpit.ready,
            f"Arming denied: {self.mode_name} mode not armable": self._intent in {LAND, RTL},
            "Arming denied: no offboard signal": self._intent == OFFBOARD and not self._streaming,
        }
        for reason, holds in refusals.items():
            if holds and force != FORCE:
                cockpit.say(CRITICAL, reason)
                return TEMPORARILY_REJECTED
        cockpit.arm()
        cockpit.say(INFO, "Armed by external command")
        return ACCEPTED

    def _disarm_asked(self, force: float) -> int:
        if not self._cockpit.armed:
            return ACCEPTED
        if not self._cockpit.landed and force != FORCE:
            self._cockpit.say(CRITICAL, "Disarming denied: not landed")
            return TEMPORARILY_REJECTED
        self._disarm("Disarmed by external command")
        return ACCEPTED

    def _take_off(self, altitude_m: float) -> int:
        """``altitude_m`` is above the sea; NaN, or lower than this place, means MIS_TAKEOFF_ALT above it."""
        cockpit = self._cockpit
        if not cockpit.ready:
            return TEMPORARILY_REJECTED
        if not cockpit.landed:
            self._enter(HOLD)
            return ACCEPTED
        x, y, z = cockpit.sample.position_m
        wanted = altitude_m - cockpit.frame.altitude_m + float(cockpit.frame.origin_m[2])
        if not z < wanted < math.inf:
            wanted = float(z) + cockpit.params["MIS_TAKEOFF_ALT"]
        self._enter(TAKEOFF, Demand(position_m=np.array([x, y, wanted]), yaw_rad=cockpit.yaw_rad))
        return ACCEPTED

    # --- set-points ---------------------------------------------------------------------------------------

    def set_point(self, point: SetPoint) -> None:
        """Outside OFFBOARD a set-point only says that somebody is there."""
        cockpit, kept = self._cockpit, self._goal.yaw_rad
        if point.coordinate_frame not in PX4_FRAMES:
            frame = point.coordinate_frame
            cockpit.say(CRITICAL, f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported")
            return
        goal = px4_goal(point, cockpit, cockpit.yaw_rad if math.isnan(kept) else kept)
        if goal is None:
            return
        self._set_point_s = cockpit.now_s
        if self.custom_mode == OFFBOARD:
            self._goal = goal
