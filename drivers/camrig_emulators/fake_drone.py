"""A camera drone in memory."""

from __future__ import annotations

import threading

import numpy as np

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, InputError, LinkLost, NotEnabledError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import DroneAim, DroneReading, FlightState
from camrig.rig import DroneSpec
from camrig_emulators.faults import Faults

_REAL_CLOCK = RealClock()
_ROUNDING_M = 1e-9


class FakeDrone:
    """A drone that flies straight at its spec's speed and turns at once; ``commands`` logs its set-points."""

    def __init__(
        self,
        spec: DroneSpec,
        *,
        clock: Clock = _REAL_CLOCK,
        start_m: tuple[float, float, float] | None = None,
        period_s: float = 0.0,
    ) -> None:
        """Stand at ``start_m``, by default on the floor below the box's middle. ``read`` takes ``period_s``."""
        self.spec = spec
        self.faults = Faults()
        self.commands: list[tuple[float, DroneAim]] = []
        self._clock = clock
        self._period_s = period_s
        self._lock = threading.RLock()
        self._commanded = False
        self._flight = FlightState.GROUND
        low, high = np.asarray(spec.box_m)
        self._from_m = np.array([*(low[:2] + high[:2]) / 2.0, 0.0]) if start_m is None else np.array(start_m)
        self._to_m, self._ground_m, self._since_s, self._yaw_rad = self._from_m, float(self._from_m[2]), 0.0, 0.0
        self._last: DroneReading | None = None

    def open(self) -> None:
        self._need_link()

    def arm(self) -> None:
        self._need_link()
        with self._lock:
            if self._update() is not FlightState.GROUND:
                raise HardwareError(f"drone {self.spec.id} is not armed: it is in the air; resume it")
            self._commanded = True
            self._fly(np.array([*self._position()[:2], self.spec.box_m[0][2]]), FlightState.TAKING_OFF)

    def resume(self) -> None:
        self._need_link()
        with self._lock:
            if self._update() is FlightState.GROUND:
                raise HardwareError(f"drone {self.spec.id} is not resumed: it is not in the air; arm it")
            self._commanded = True
            if self._flight is FlightState.LANDING:
                self._fly(self._position(), FlightState.FLYING)

    def go_to(self, position_m: tuple[float, float, float], yaw_rad: float) -> None:
        self._need_link()
        low, high = np.asarray(self.spec.box_m)
        if not (low - _ROUNDING_M <= position_m).all() or not (position_m <= high + _ROUNDING_M).all():
            raise InputError(f"drone {self.spec.id}: {position_m} m is outside its box {self.spec.box_m} m")
        with self._lock:
            if not (self._commanded and self._update() is FlightState.FLYING):
                raise NotEnabledError(f"drone {self.spec.id} is not flying under our command: arm it first")
            if self.faults.take_drop():
                return
            self.commands.append((self._clock.now_s(), DroneAim(position_m, yaw_rad)))
            self._fly(np.array(position_m), FlightState.FLYING)
            self._yaw_rad = yaw_rad

    def land(self) -> None:
        self._need_link()
        with self._lock:
            self._commanded = False
            if self._update() is not FlightState.GROUND:
                self._fly(np.array([*self._position()[:2], self._ground_m]), FlightState.LANDING)

    def stop(self) -> None:
        with self._lock:
            self._commanded = False
            if self.faults.plugged and self._update() is not FlightState.GROUND:
                self._fly(self._position(), FlightState.FLYING)

    def read(self, timeout_s: float) -> tuple[DroneReading, ...]:
        self._clock.sleep_s(min(timeout_s, self._period_s))
        self._need_link()
        if self.faults.silent:
            return ()
        if self._last is None or not self.faults.freeze:
            sigmas = [self.spec.position_sigma_m] * 3 + [self.spec.attitude_sigma_rad] * 3
            with self._lock:
                flight, pose = self._update(), self.T_world_body()
            self._last = DroneReading(self.spec.id, self._clock.now_s(), pose, np.diag(np.square(sigmas)), flight)
        return (self._last,)

    def close(self) -> None:
        if self._commanded:
            self.stop()

    def T_world_body(self) -> Transform:
        """Return where the drone truly is now."""
        with self._lock:
            return transform(rotation_z(self._yaw_rad), self._position())

    def _fly(self, to_m: Array, flight: FlightState) -> None:
        self._from_m, self._to_m, self._since_s, self._flight = self._position(), to_m, self._clock.now_s(), flight

    def _position(self) -> Array:
        way_m = self._to_m - self._from_m
        flown_m = self.spec.speed_m_s * max(0.0, self._clock.now_s() - self._since_s)
        flown = min(1.0, flown_m / max(float(np.linalg.norm(way_m)), _ROUNDING_M))
        return np.asarray(self._from_m + way_m * flown)

    def _update(self) -> FlightState:
        if np.allclose(self._position(), self._to_m, rtol=0.0, atol=_ROUNDING_M):
            arrived = {FlightState.TAKING_OFF: FlightState.FLYING, FlightState.LANDING: FlightState.GROUND}
            self._flight = arrived.get(self._flight, self._flight)
        return self._flight

    def _need_link(self) -> None:
        if not self.faults.plugged:
            raise LinkLost(f"drone {self.spec.id}: the fake is unplugged")
