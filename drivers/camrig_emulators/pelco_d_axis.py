"""One axis of an emulated head on the wire: its motion, and the hundredths of a degree by which it names its angle."""

from __future__ import annotations

import math
import random

from camrig_emulators.pelco_d_motion import AxisMotion
from camrig_emulators.pelco_d_settings import AxisMap, Limits, PelcoDHeadSettings
from camrig_emulators.pelco_d_speeds import FULL_SPEED, share_of_full_speed

CIRCLE = 36000
_CREEP = 1.0 / 65.0


class Axis:
    """Commands carry their stamps, which never go back."""

    def __init__(
        self,
        start_deg: float,
        limits_deg: Limits | None,
        axis: AxisMap,
        settings: PelcoDHeadSettings,
        rng: random.Random,
        *,
        turbo: bool = False,
    ) -> None:
        self._axis = axis
        self._settings = settings
        self._rng = rng
        self._turbo = turbo
        self._zero_raw_deg = 0.0
        self._jogged: tuple[int, int, float] = (0, 0, 1.0)
        """Direction and byte of the jog in force, and how fast it is of what it should be."""
        self.start_deg = start_deg
        self.shift_deg = 0.0
        """What reports have lost of the truth: lost steps, resets."""
        self.last_read: int | None = None
        self.motion = AxisMotion(
            start_deg,
            limits=limits_deg,
            speed=settings.max_speed_deg_s,
            acceleration=settings.acceleration_deg_s2,
            start_latency_s=settings.start_latency_s,
            play=settings.backlash_deg,
        )

    def true_deg(self, stamp_s: float) -> float:
        """Return where the optics look, but for the head's zero error."""
        settings = self._settings
        load_deg = self.motion.load(stamp_s)
        worm_deg = settings.worm_error_deg * math.sin(math.tau * load_deg / settings.worm_period_deg)
        return load_deg + worm_deg + self.shift_deg

    def raw(self, stamp_s: float) -> int:
        """Return the encoder's 0 to 35999."""
        return self._counted(self.motion.motor(stamp_s))

    def report(self, stamp_s: float) -> int:
        """Return what the head says of this axis, as of ``stamp_s``."""
        settings, motion = self._settings, self.motion
        if settings.update_s:
            stamp_s = math.floor(stamp_s / settings.update_s) * settings.update_s
        angle_deg = motion.motor(stamp_s)
        if settings.reports == "target" and motion.goal is not None:
            angle_deg = motion.goal
        elif settings.reports == "frozen":
            angle_deg = motion.rested_at(stamp_s)
        raw = self._counted(angle_deg)
        if not settings.wraps and raw > CIRCLE // 2:
            return 0
        return CIRCLE if raw == 0 and settings.full_turn_as_36000 else raw

    def go_to(self, raw: int, at_s: float) -> None:
        """Move to a position of the wire; the turn that is nearest, within the limits."""
        target_deg = self._target(raw, at_s)
        if target_deg is None:
            return
        self._prepare(at_s)
        error_deg = self._settings.stop_error_deg
        low, high = self.motion.limits or (-math.inf, math.inf)
        target_deg = min(max(target_deg + self._rng.uniform(-error_deg, error_deg), low), high)
        self._jogged = (0, 0, 1.0)
        self.motion.go_to(target_deg, at_s, past=self._settings.overshoot_deg)

    def jog(self, direction: int, speed_byte: int, at_s: float, zoom_share: float = 0.0) -> None:
        """Turn towards growing (+1) or falling (-1) raw, or not at all (0)."""
        settings = self._settings
        if (direction, speed_byte) != self._jogged[:2] or self.motion.at_rest(at_s):
            self._prepare(at_s)
            self._jogged = (direction, speed_byte, max(0.1, self._rng.gauss(1.0, settings.speed_drift)))
        speed = self._speed(speed_byte) * self._jogged[2] * (1.0 - settings.zoom_slows * zoom_share)
        until_s = math.inf if settings.dead_man_s is None else at_s + settings.dead_man_s
        self.motion.jog(direction * self._axis.sign * speed, at_s, until_s=until_s)

    def reset(self, at_s: float) -> None:
        """Stop; once the head is awake again drive to where it started."""
        self.motion.stop(at_s)
        self._jogged = (0, 0, 1.0)
        self.shift_deg += self._settings.reset_shift_deg
        self.motion.home(self.start_deg, at_s + self._settings.reset_s)

    def set_zero(self, at_s: float) -> None:
        """Call the present angle raw 0 from now on."""
        self._zero_raw_deg = self._raw_deg(self.motion.motor(at_s))

    def _prepare(self, at_s: float) -> None:
        """Draw when the motion begins; lose steps where the one before ran into a stop."""
        settings = self._settings
        stopped = self.motion.at_stop(at_s)
        if stopped and self._jogged[0]:
            self.shift_deg -= math.copysign(settings.stall_loss_deg, self._jogged[0] * self._axis.sign)
        breakaway_s = settings.breakaway_s if stopped else 0.0
        self.motion.start_latency_s = (
            settings.start_latency_s + self._rng.uniform(0.0, settings.start_jitter_s) + breakaway_s
        )

    def _speed(self, byte: int) -> float:
        settings = self._settings
        full = settings.manual_speed_deg_s or settings.max_speed_deg_s
        if byte == 0:
            return full * _CREEP if settings.speed_zero == "creep" else 0.0
        if self._turbo and byte == settings.turbo_byte and byte > FULL_SPEED:
            return settings.turbo_speed_deg_s
        return full * share_of_full_speed(byte, settings.speed_curve, settings.dead_bytes)

    def _counted(self, angle_deg: float) -> int:
        step_deg = self._settings.readback_step_deg
        steps = round((self._raw_deg(angle_deg) - self._zero_raw_deg) / step_deg)
        return round(steps * step_deg * 100.0) % CIRCLE

    def _raw_deg(self, angle_deg: float) -> float:
        return (angle_deg - self._axis.offset_deg) / (self._axis.sign * self._axis.scale)

    def _target(self, raw: int, at_s: float) -> float | None:
        raw_deg = raw / 100.0 + self._zero_raw_deg
        turn_deg = 360.0 * self._axis.scale
        now_deg = self.motion.motor(at_s)
        wanted_deg = self._axis.sign * self._axis.scale * raw_deg + self._axis.offset_deg
        if self.motion.limits is None and self._settings.pan_travel == "direct":
            return now_deg + self._axis.sign * self._axis.scale * (raw - self.raw(at_s)) / 100.0
        nearest_deg = now_deg + math.remainder(wanted_deg - now_deg, turn_deg)
        if self.motion.limits is None:
            return nearest_deg
        low, high = self.motion.limits
        turns = [nearest_deg + k * turn_deg for k in (0, -1, 1)]
        clamped = [min(max(angle, low), high) for angle in turns]
        off_deg = [abs(math.remainder(angle - wanted_deg, turn_deg)) for angle in clamped]
        best = min(range(len(turns)), key=lambda k: round(off_deg[k], 6))  # a tie goes to the nearest turn
        return None if off_deg[best] > 1e-6 and self._settings.out_of_range == "ignore" else clamped[best]
