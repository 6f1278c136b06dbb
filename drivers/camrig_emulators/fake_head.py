"""A pan-tilt head in memory."""

from __future__ import annotations

import contextlib
import os
import threading

from camrig.clock import Clock, RealClock
from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.interfaces import Guard
from camrig.messages import AxisReading, HeadAim
from camrig.rig import HeadSpec, Interval
from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_motion import AxisMotion

_REAL_CLOCK = RealClock()
_ACCELERATION_RAD_S2 = 3.0
_SIGMA_RAD = 1e-4
_ROUNDING_RAD = 1e-9
STOP_BYTES = b"stop"


class FakeHead:
    """A head that moves as its spec says and reads back the truth; ``commands`` logs its orders, None for a stop."""

    def __init__(
        self, spec: HeadSpec, *, clock: Clock = _REAL_CLOCK, start: HeadAim | None = None, exchange_s: float = 0.0
    ) -> None:
        """Stand at ``start``, by default the aim nearest to zero within limits. ``read`` takes ``exchange_s``."""
        self.spec = spec
        self.faults = Faults()
        self.commands: list[tuple[float, HeadAim | None]] = []
        self._clock = clock
        self._exchange_s = exchange_s
        self._lock = threading.RLock()
        self._enabled = False
        self._pipe: tuple[int, int] | None = None
        self._last: tuple[AxisReading, ...] = ()
        start = start or HeadAim(_clip(0.0, spec.pan_limits_rad), _clip(0.0, spec.tilt_limits_rad))
        self._pan = self._axis(start.pan_rad, spec.pan_limits_rad)
        self._tilt = self._axis(start.tilt_rad, spec.tilt_limits_rad)

    @property
    def enabled(self) -> bool:
        return self._enabled

    def open(self) -> None:
        self._need_link()
        with self._lock:
            if self._pipe is None:
                self._pipe = os.pipe()
                os.set_blocking(self._pipe[0], False)

    def enable(self) -> None:
        self._need_link()
        self._enabled = True

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        self._need_link()
        self._need_inside("pan", pan_rad, self.spec.pan_limits_rad)
        self._need_inside("tilt", tilt_rad, self.spec.tilt_limits_rad)
        with self._lock:
            if not self._enabled:
                raise NotEnabledError(f"head {self.spec.id} is not enabled: call enable() before move_to()")
            if self.faults.take_drop():
                return
            now_s = self._clock.now_s()
            self.commands.append((now_s, HeadAim(pan_rad, tilt_rad)))
            self._pan.go_to(pan_rad, now_s)
            self._tilt.go_to(tilt_rad, now_s)

    def stop(self) -> None:
        with self._lock:
            self._enabled = False
            if not self.faults.plugged:
                return
            now_s = self._clock.now_s()
            self.commands.append((now_s, None))
            self._pan.stop(now_s)
            self._tilt.stop(now_s)

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        self._clock.sleep_s(min(timeout_s, self._exchange_s))
        self._need_link()
        if self.faults.silent:
            return ()
        stamp_s = self._clock.now_s()
        if not (self.faults.freeze and self._last):
            pan_rad, tilt_rad = self.true_angles_rad(stamp_s)
            self._last = (
                AxisReading(self.spec.id, "pan", pan_rad, stamp_s, _SIGMA_RAD, 0.0),
                AxisReading(self.spec.id, "tilt", tilt_rad, stamp_s, _SIGMA_RAD, 0.0),
            )
        return self._last

    def guard(self) -> Guard:
        if self._pipe is None:
            raise LinkLost(f"head {self.spec.id} is not open")
        return Guard(self._pipe[1], STOP_BYTES)

    def guarded(self) -> bytes:
        """Return what a guardian has written since the last call."""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._pipe[0], 4096) if self._pipe else b""
        return b""

    def close(self) -> None:
        if self._enabled:
            self.stop()
        with self._lock:
            for descriptor in self._pipe or ():
                os.close(descriptor)
            self._pipe = None

    def true_angles_rad(self, stamp_s: float) -> tuple[float, float]:
        """Return pan and tilt at any stamp of the last minute."""
        with self._lock:
            return self._pan.motor(stamp_s), self._tilt.motor(stamp_s)

    def _axis(self, start_rad: float, limits_rad: Interval) -> AxisMotion:
        speed = self.spec.speed_rad_s
        return AxisMotion(start_rad, limits=limits_rad, speed=speed, acceleration=_ACCELERATION_RAD_S2)

    def _need_link(self) -> None:
        if not self.faults.plugged:
            raise LinkLost(f"head {self.spec.id}: the fake is unplugged")

    def _need_inside(self, axis: str, angle_rad: float, limits_rad: Interval) -> None:
        low, high = limits_rad
        if not low - _ROUNDING_RAD <= angle_rad <= high + _ROUNDING_RAD:
            raise InputError(f"head {self.spec.id}: {axis} {angle_rad:.4f} rad is outside {low:.4f} to {high:.4f} rad")


def _clip(angle_rad: float, limits_rad: Interval) -> float:
    return min(max(angle_rad, limits_rad[0]), limits_rad[1])
