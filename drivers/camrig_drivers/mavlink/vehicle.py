"""The logic of one vehicle, without I/O: packets and orders in, packets out, time as an argument.

Every transition is judged by HEARTBEAT, EXTENDED_SYS_STATE and position; an ack can only refuse, for PX4 accepts modes
that it then does not take. PASSIVE commands nothing: a vehicle found in the air is left alone. When the mode is no
longer ours (failsafe, pilot), it is disarmed or has rebooted, every state falls back to PASSIVE, and its set-points are
not resumed: PX4 would follow them at once. Only an operator's ``arm`` or ``resume`` takes it over again.
"""

from __future__ import annotations

import logging
import math

from camrig.rig import DroneSpec
from camrig_drivers.mavlink import commands
from camrig_drivers.mavlink.asking import Asking, Errands
from camrig_drivers.mavlink.box import LEAST_CLIMB_M, clamped
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.packets import Command, CommandAck, Heard, Heartbeat, LocalPosition, Said
from camrig_drivers.mavlink.phase import (
    IN_OUR_MODE,
    REFUSABLE,
    SETTLED,
    TAKING_OVER,
    WATCHED,
    Phase,
    flight_state,
    set_points_flow,
    taken_away,
)
from camrig_drivers.mavlink.report import Report
from camrig_drivers.mavlink.section import VehicleSettings
from camrig_drivers.mavlink.set_points import SetPoints
from camrig_drivers.mavlink.telemetry import Telemetry
from camrig_drivers.mavlink.upkeep import Upkeep
from camrig_drivers.mavlink.watch import Action, Watch, runaway

_log = logging.getLogger(__name__)

_MODE_TIMEOUT_S = 5.0
_ARM_TIMEOUT_S = 10.0
_CLIMB_GRACE_S = 15.0
"""Beyond the time that the climb takes at the drone's speed: spooling up and settling."""
_REACHED_M = 0.25
_IDLE_TICK_S = 0.1


class Vehicle:
    """One autopilot and what we do with it. One thread at a time; others may look at ``phase`` and ``reason``."""

    def __init__(self, spec: DroneSpec, flavour: Flavour, seen: Telemetry, settings: VehicleSettings) -> None:
        self.spec = spec
        self.flavour = flavour
        self.seen = seen
        self.settings = settings
        self.phase = Phase.PASSIVE
        self.reason = ""
        """Why the last order ended otherwise than ordered, or what was done about a fault."""
        self.watch = Watch(spec, settings.needs)
        self.errands = Errands()
        self.upkeep = Upkeep(flavour, seen, settings)
        self.report = Report(spec, seen, gimbal=settings.gimbal)
        self._set_points = SetPoints(flavour, spec.speed_m_s, seen)
        self._asking: Asking | None = None
        self._climbs = False
        self._climb_to_m = spec.box_m[0][2]
        self._since_s = 0.0
        self._mode_before = seen.mode

    # --- packets in, packets out ------------------------------------------------------------------------

    def hear(self, packet: Heard, now_s: float) -> None:
        """Take one packet that arrived at ``now_s``."""
        rebooted = self.seen.hear(packet, now_s)
        self.upkeep.hear(packet, now_s)
        if rebooted:
            self.upkeep.restart()
            self.errands.clear()
            self._let_go("it has rebooted", now_s)
        match packet:
            case Heartbeat():
                self._judge(now_s)
            case CommandAck():
                self.errands.hear(packet)
                self._heed(packet, now_s)
            case LocalPosition():
                self._supervise(now_s)
        self.report.take(self.seen.take_poses(), flight_state(self.phase, self.flavour, self.seen), now_s)

    def tick(self, now_s: float) -> list[Said]:
        """Return what to send now; to be called at ``due_s`` or earlier."""
        self._supervise(now_s)
        self._step(now_s)
        asked = self._asking.due(now_s) if self._asking else []
        set_points = self._set_points.due_if(self._streaming(), now_s, follows=self.phase is Phase.ENTERING)
        if set_points is None:
            self._let_go("our set-points were interrupted", now_s)
        return [*asked, *(set_points or []), *self.errands.due(now_s), *self.upkeep.due(now_s)]

    def due_s(self, now_s: float) -> float:
        """Return when to call ``tick`` next, at the latest."""
        idle_s = now_s + _IDLE_TICK_S
        return min(idle_s, self._set_points.next_s) if self._streaming() else idle_s

    # --- orders -----------------------------------------------------------------------------------------

    def arm(self, now_s: float) -> None:
        """From the ground: take the vehicle over, arm it and climb to the lowest height of its box."""
        if self.phase not in TAKING_OVER and not self.seen.airborne:
            if not self.settings.needs.vision:  # poses from outside do not wander
                self.seen.level(self.settings.floor_m)
            self._take_over(now_s, climbs=True)

    def resume(self, now_s: float) -> None:
        """In the air: take the vehicle over where it is, and follow ``go_to``."""
        if self.phase is Phase.HOLDING and self.seen.airborne:
            self.reason = ""
            self._fly(now_s)
        elif self.phase not in TAKING_OVER and self.seen.airborne:
            self._take_over(now_s, climbs=False)

    def go_to(self, goal_m: Vector, yaw_rad: float) -> None:
        """Move the set-point towards a point of the box; nothing unless FLYING (a stop has come between)."""
        if self.phase is Phase.FLYING:
            self._set_points.move(clamped(goal_m, self.spec.box_m), yaw_rad)

    def stop(self, now_s: float) -> None:
        """Hold here, in every state in which we command; before lift-off that cancels the take-off."""
        breaking_off = {Phase.ENTERING, Phase.LANDING, Phase.DESCENDING}
        if self.phase in IN_OUR_MODE:
            self._set_points.hold_here(now_s)
            self._go(Phase.HOLDING, now_s)
        elif self.phase in breaking_off and self.seen.airborne:
            self._brake(now_s)
        elif self.phase is Phase.ENTERING:
            self._go(Phase.PASSIVE, now_s)

    def land(self, now_s: float) -> None:
        """Land here, from whatever mode it is in."""
        self.reason = ""
        self._land(now_s)

    def release(self, now_s: float) -> None:
        """Leave the vehicle standing where it is without us; a landing goes on. Done when ``phase`` is not BRAKING."""
        if self.phase not in {Phase.LANDING, Phase.DESCENDING}:
            self.stop(now_s)
        if self.phase is Phase.HOLDING and self.flavour.set_points_must_flow:
            self._brake(now_s)

    # --- transitions ------------------------------------------------------------------------------------

    def _go(
        self, phase: Phase, now_s: float, command: Command | None = None, period_s: float = 1.0, delay_s: float = 0.0
    ) -> None:
        """Change the phase; in it, repeat ``command`` until the vehicle shows that it took effect."""
        self.phase, self._since_s, self._mode_before = phase, now_s, self.seen.mode
        self.watch.settle(self.seen.height_m if phase in SETTLED else None)
        self._asking = Asking(command, period_s, now_s + delay_s) if command else None
        _log.info("drone %s: %s", self.spec.id, phase.name.lower())

    def _take_over(self, now_s: float, *, climbs: bool) -> None:
        self.reason = ""
        self._climbs = climbs
        self.watch.begin()
        self._set_points.hold_here(now_s)
        self._go(Phase.ENTERING, now_s, self.flavour.set_mode(self.flavour.ours), 0.5, self.flavour.lead_s)
        if self.settings.gimbal:
            self.errands.add(*commands.gimbal_down(takes_control=self.flavour.set_points_must_flow))

    def _let_go(self, reason: str, now_s: float) -> None:
        if self.phase is not Phase.PASSIVE:
            self.reason = self.reason or reason
            _log.warning("drone %s: no longer commanded: %s", self.spec.id, reason)
            self.errands.clear()
            self._go(Phase.PASSIVE, now_s)

    def _give_up(self, reason: str, now_s: float) -> None:
        """End an order that failed: hold where the mode is ours, else command nothing."""
        if self.seen.mode != self.flavour.ours:
            self._let_go(reason, now_s)
            return
        self.reason = reason
        _log.warning("drone %s: gives up: %s", self.spec.id, reason)
        self._set_points.hold_here(now_s)
        self._go(Phase.HOLDING, now_s)

    def _supervise(self, now_s: float) -> None:
        """Act on the gravest fault."""
        if self.phase not in WATCHED:
            return
        fault = self.watch.gravest(self.seen, now_s)
        if fault is None and self.phase in SETTLED and (gap_m := self._set_points.runaway_m()):
            fault = runaway(gap_m, holds=self.phase is Phase.HOLDING)
        if fault is not None and fault.action is Action.LAND and self.seen.heartbeat.armed:
            self.reason = f"{fault.text}: it lands"
            _log.warning("drone %s: lands: %s", self.spec.id, fault.text)
            self._land(now_s)
        elif fault is not None and (self.phase is not Phase.HOLDING or self.seen.jump_m):
            self._give_up(f"{fault.text}: it {'stays down' if self.seen.on_ground else 'holds'}", now_s)

    def _judge(self, now_s: float) -> None:
        """Let go where a heartbeat shows that somebody else (failsafe, pilot) has taken the vehicle over."""
        reason = taken_away(self.phase, self.flavour, self.seen, self._mode_before, now_s - self._since_s)
        if reason:
            self._let_go(reason, now_s)

    def _heed(self, ack: CommandAck, now_s: float) -> None:
        if ack.command != REFUSABLE.get(self.phase) or not ack.is_for_us:
            return
        if not ack.refuses:
            if self.phase is Phase.CLIMBING:
                self._asking = None  # asked again, the take-off would start again
        elif self._asking is not None:
            said = self.seen.last_warning or "it gives no reason"
            self._give_up(f"it refuses command {ack.command} with result {ack.result}: {said}", now_s)

    def _step(self, now_s: float) -> None:
        elapsed_s = now_s - self._since_s
        match self.phase:
            case Phase.ENTERING:
                self._enter(now_s, elapsed_s)
            case Phase.ARMING:
                self._wait_for_arming(now_s, elapsed_s)
            case Phase.CLIMBING:
                self._climb(now_s, elapsed_s)
            case Phase.BRAKING:
                self._wait_for_brake(now_s, elapsed_s)
            case Phase.LANDING | Phase.DESCENDING:
                self._descend(now_s)

    def _enter(self, now_s: float, elapsed_s: float) -> None:
        if self.seen.mode == self.flavour.ours and elapsed_s >= self.flavour.lead_s:
            if self.seen.airborne:
                self._fly(now_s)
            elif self._climbs:
                self._go(Phase.ARMING, now_s, commands.arm(), math.inf)  # once: a pilot may disarm it at any moment
            else:
                self._give_up("it has landed", now_s)
        elif elapsed_s > self.flavour.lead_s + _MODE_TIMEOUT_S:
            self._give_up(f"{self.flavour.name} does not take mode {self.flavour.ours:#x}", now_s)

    def _wait_for_arming(self, now_s: float, elapsed_s: float) -> None:
        if not self.seen.heartbeat.armed or (here := self.seen.position_m) is None:
            if elapsed_s > _ARM_TIMEOUT_S:
                self._give_up("it does not arm, or the order to was lost", now_s)
            return
        self._climb_to_m = max(self.spec.box_m[0][2], here[2] + LEAST_CLIMB_M)
        if self.flavour.set_points_must_flow:
            self._set_points.move((here[0], here[1], self._climb_to_m))
            self._go(Phase.CLIMBING, now_s)
        else:
            self._go(Phase.CLIMBING, now_s, commands.take_off(self._climb_to_m - here[2]))

    def _climb(self, now_s: float, elapsed_s: float) -> None:
        if self.seen.airborne:
            self._asking = None
            if self.seen.height_m >= self._climb_to_m - _REACHED_M:
                self._fly(now_s)
                return
        if elapsed_s > _CLIMB_GRACE_S + self._climb_to_m / self.spec.speed_m_s:
            self._give_up(f"it has not reached {self._climb_to_m:g} m", now_s)

    def _fly(self, now_s: float) -> None:
        """Follow ``go_to`` from here on; whoever starts outside the box moves inside."""
        if self.phase is not Phase.CLIMBING or not self.flavour.set_points_must_flow:
            self._set_points.hold_here(now_s)
        if self.flavour.keeps_speed:
            self.errands.add(*(commands.change_speed(kind, self.spec.speed_m_s) for kind in (1, 2, 3)))
        self._go(Phase.FLYING, now_s)
        self._set_points.move_into(self.spec.box_m)

    def _brake(self, now_s: float) -> None:
        self._set_points.hold_here(now_s)
        self._go(Phase.BRAKING, now_s, self.flavour.set_mode(self.flavour.brake), 0.5)

    def _wait_for_brake(self, now_s: float, elapsed_s: float) -> None:
        if self.seen.mode != self.flavour.brake:
            if elapsed_s > _MODE_TIMEOUT_S:
                self._give_up(f"{self.flavour.name} does not take mode {self.flavour.brake:#x}", now_s)
        elif self.flavour.brake == self.flavour.ours:
            self._set_points.hold_here(now_s)
            self._go(Phase.HOLDING, now_s)
        else:
            self._go(Phase.PASSIVE, now_s)

    def _land(self, now_s: float) -> None:
        self.errands.clear()
        self._set_points.hold_here(now_s)
        self._go(Phase.LANDING, now_s, commands.land(), 0.5)

    def _descend(self, now_s: float) -> None:
        if self.seen.on_ground and not self.seen.heartbeat.armed:
            self._go(Phase.PASSIVE, now_s)
        elif self.phase is Phase.LANDING and self.seen.mode == self.flavour.land:
            self._go(Phase.DESCENDING, now_s)

    def _streaming(self) -> bool:
        return set_points_flow(self.phase, self.flavour, self.seen.mode)
