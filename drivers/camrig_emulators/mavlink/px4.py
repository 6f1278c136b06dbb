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
    Cockpit,
    ReturnHome,
)
from camrig_emulators.mavlink.commands import Cmd
from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.firmware import CommandParams, whole
from camrig_emulators.mavlink.px4_failsafes import Px4Failsafes
from camrig_emulators.mavlink.px4_gimbal import px4_gimbal
from camrig_emulators.mavlink.px4_modes import ALTCTL, HOLD, LAND, MODES, OFFBOARD, RTL, TAKEOFF, custom_mode
from camrig_emulators.mavlink.set_points import PX4_FRAMES, SetPoint, px4_goal
from camrig_emulators.mavlink.streams import PX4_STREAMS_HZ

_SPOOL_UP_S = 1.0
_LIFT_OFF_M = 0.1
_ALTITUDE_SINK_M_S = 0.5  # ALTCTL without sticks: measured 4 s from 2 m
_ESTIMATOR_PATIENCE_S = 5.1  # measured
_OFFBOARD_LOSS_MODES = {4: LAND, 5: HOLD}  # COM_OBL_RC_ACT; all others need a remote control and become RTL
_HEIGHT_BY_VISION = {"EKF2_GPS_CTRL", "EKF2_HGT_REF", "SYS_HAS_GPS"}
_NO_REMOTE_NEEDED = (1, 4)  # COM_RC_IN_MODE


class Px4:
    """A ``Firmware``. ``_intent`` is the mode last asked for, ``_failsafe`` the one that overrides it."""

    autopilot = 12
    default_streams_hz = PX4_STREAMS_HZ
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
        self._height_lost = False
        self._failsafes = Px4Failsafes(cockpit)

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
    def goal(self) -> Demand:
        return self._goal

    @property
    def talks(self) -> bool:
        return self._failsafes.ground_station_heard

    @property
    def _streaming(self) -> bool:
        return self._cockpit.now_s - self._set_point_s <= self._cockpit.params["COM_OF_LOSS_T"]

    @property
    def _blind(self) -> bool:
        estimator = self._cockpit.estimator
        return estimator.local and estimator.lost_s > _ESTIMATOR_PATIENCE_S

    @property
    def modes(self) -> dict[str, int]:
        return {name.lower(): number for number, name in MODES.items()}

    def ground_station_beat(self, system: int) -> None:
        del system  # PX4 takes any ground station
        self._failsafes.ground_station_beat()

    def parameter_set(self, name: str) -> None:
        """Use a new source of height at once, as if it counted from the sea: the place then seems to be a pit."""
        estimator = self._cockpit.estimator
        if name in _HEIGHT_BY_VISION and estimator.sources.gps and estimator.local and not self._height_lost:
            self._height_lost = True
            estimator.jump(np.array([0.0, 0.0, -self._cockpit.frame.altitude_m]))

    def step(self) -> Demand | None:
        self._fall_back()
        mode = self._failsafes.step()
        if mode is not None and self._cockpit.armed:
            self._enter(mode)
        self._disarm_on_floor()
        return self._demand() if self._cockpit.armed else None

    def _demand(self) -> Demand | None:
        cockpit, mode = self._cockpit, self.custom_mode
        if mode in {OFFBOARD, TAKEOFF}:
            return self._climbing_off(mode)
        if mode == LAND:
            return cockpit.sink(self._goal, cockpit.params["MPC_LAND_SPEED"])
        if mode == ALTCTL:
            return cockpit.sink(self._goal, _ALTITUDE_SINK_M_S, adrift=True)
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

    def _fall_back(self) -> None:
        """Fly what is possible instead of what was asked for; as soon as that is possible, it is flown again."""
        cockpit = self._cockpit
        flying = cockpit.armed and (not cockpit.landed or self._failsafe == ALTCTL)
        if flying and self._blind:
            if self._failsafe != ALTCTL:
                cockpit.say(CRITICAL, "Failsafe activated")
            self._fail_over(ALTCTL)
        elif self._intent != OFFBOARD or not cockpit.armed or self._streaming:
            self._stream_lost_s = math.inf
            self._fail_over(None)
        else:
            self._without_stream()

    def _without_stream(self) -> None:
        """OFFBOARD becomes Hold, and later the action."""
        cockpit = self._cockpit
        if self._stream_lost_s == math.inf:
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
        self._goal = self._cockpit.stop_here()
        self._prepare_return()

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
            case Cmd.SET_MODE:
                self._set_mode(whole(params[1]), whole(params[2]))
                return ACCEPTED  # whatever became of it: only HEARTBEAT tells
            case Cmd.ARM_DISARM:
                return self._arm(params[1]) if params[0] >= 0.5 else self._disarm_asked(params[1])
            case Cmd.TAKEOFF:
                return self._take_off(params[6])
            case Cmd.LAND:
                return self._set_mode(4, 6)
            case Cmd.RETURN_TO_LAUNCH:
                return self._set_mode(4, 5)
            case Cmd.CHANGE_SPEED:
                return ACCEPTED  # of no effect in OFFBOARD
            case Cmd.MOUNT_CONTROL | Cmd.GIMBAL_PITCH_YAW | Cmd.GIMBAL_CONFIGURE:
                return px4_gimbal(self._cockpit.mount, command, params)
        return UNSUPPORTED

    def change_mode(self, mode: int) -> int:
        return self._set_mode(mode >> 16 & 0xFF, mode >> 24 & 0xFF)

    def _set_mode(self, main: int, sub: int) -> int:
        mode = custom_mode(main, sub) if 0 <= main <= 255 and 0 <= sub <= 255 else -1
        if mode == TAKEOFF:
            return self._take_off(math.nan)
        flyable = mode in {HOLD, RTL, LAND} or (mode == OFFBOARD and self._streaming)
        if not flyable or not self._cockpit.estimator.local or (self._blind and mode != LAND):
            if mode in MODES:
                self._cockpit.say(CRITICAL, f"Switching to {MODES[mode]} is currently not available")
            return TEMPORARILY_REJECTED
        self._enter(mode)
        return ACCEPTED

    def _enter(self, mode: int, goal: Demand | None = None) -> None:
        if mode != self.custom_mode:
            self._goal = self._cockpit.stop_here()
        if goal is not None:
            self._goal = goal
        self._intent, self._failsafe, self._cockpit.critical = mode, None, False
        self._prepare_return()

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
            "Arming denied: no manual control input": self._cockpit.params["COM_RC_IN_MODE"] not in _NO_REMOTE_NEEDED,
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
        if not cockpit.landed:  # a repeat while it climbs changes nothing
            if self.custom_mode != TAKEOFF:
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
