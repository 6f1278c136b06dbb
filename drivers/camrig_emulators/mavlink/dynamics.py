"""How the emulated drone flies: an acceleration-limited position controller, tilt, hover noise, and the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig_emulators.mavlink.noise import ColouredNoise
from camrig_emulators.mavlink.settings import MavlinkDroneSettings

GRAVITY_M_S2 = 9.81
_POSITION_GAIN = 2.0  # 1/s
_VELOCITY_GAIN = 5.0  # 1/s
_YAW_GAIN = 4.0  # 1/s
_ATTITUDE_LAG_S = 0.1  # thrust follows its demand as fast as the body tilts
_BRAKING = 0.7  # part of the acceleration limit that the approach to a place counts on
_HOVER_TAU_S = 0.5
_ESTIMATE_TAU_S = 2.0
_ESTIMATE_ATTITUDE_TAU_S = 3.0
_WANDER_TAU_S = 20.0
_WIND_GAIN = 0.3  # 1/s: of the air's speed over ground, as acceleration
_ADRIFT_M_S2 = (0.08, 0.06)  # of a body that is only kept level

_UNSET: Array = np.full(3, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """What the autopilot wants, in the world; NaN leaves an axis to the other triple.

    A position with a velocity is flown with that velocity fed forward, an acceleration always is; an axis with none of
    them stands still. Without a
    yaw the body turns at ``yaw_rate_rad_s``. ``speed_m_s``, ``climb_m_s`` and ``turn_rad_s`` lower the limits of the
    approach. ``adrift`` leaves the horizontal to the wind.
    """

    position_m: Array = field(default_factory=lambda: _UNSET)
    velocity_m_s: Array = field(default_factory=lambda: _UNSET)
    acceleration_m_s2: Array = field(default_factory=lambda: _UNSET)
    yaw_rad: float = math.nan
    yaw_rate_rad_s: float = 0.0
    speed_m_s: float = math.inf
    climb_m_s: float = math.inf
    turn_rad_s: float = math.inf
    adrift: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Position, velocity and acceleration (3,) in the world and the heading (unwrapped) of a body."""

    position_m: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    yaw_rad: float
    yaw_rate_rad_s: float = 0.0

    def T_world_body(self) -> Transform:
        """Return the pose: a body tilts so that its thrust gives its acceleration, its nose towards its yaw."""
        ax, ay, az = (float(value) for value in self.acceleration_m_s2)
        thrust = math.sqrt(ax * ax + ay * ay + (az + GRAVITY_M_S2) ** 2)
        up = (ax / thrust, ay / thrust, (az + GRAVITY_M_S2) / thrust)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        rise = -(c * up[0] + s * up[1]) / up[2]
        length = math.hypot(1.0, rise)
        nose = (c / length, s / length, rise / length)
        left = (
            up[1] * nose[2] - up[2] * nose[1],
            up[2] * nose[0] - up[0] * nose[2],
            up[0] * nose[1] - up[1] * nose[0],
        )
        T = np.eye(4)
        T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = nose, left, up, self.position_m
        return T


class Airframe:
    """The body and its rotors; ``advance`` moves it by one small step.

    Its controller works on its own *estimate* of where it is, whose error wanders slowly, as a real one's must.
    """

    def __init__(self, settings: MavlinkDroneSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        start_m = np.array(settings.start_position_m)
        self._nominal = Motion(start_m, np.zeros(3), np.zeros(3), math.radians(settings.start_yaw_deg))
        self._floor_m = float(start_m[2])
        self._wake = 0.0  # 0 on the floor, 1 well in the air: how much hover noise there is
        position, attitude = settings.estimate_noise_m, math.radians(settings.estimate_noise_deg)
        sigma = np.repeat([settings.hover_noise_m, position, attitude], 3)
        self._noise = ColouredNoise(sigma, np.repeat([_HOVER_TAU_S, _ESTIMATE_TAU_S, _ESTIMATE_ATTITUDE_TAU_S], 3), rng)
        self._wander = ColouredNoise(np.full(3, settings.estimate_wander_m), np.full(3, _WANDER_TAU_S), rng)
        self.wanders = settings.estimate_wander_m > 0.0
        """Whether the estimate suffers from GPS."""
        self.offset_m = np.zeros(3)
        self.offset_m_s = np.zeros(3)
        self.offset_yaw_rad = 0.0
        """The estimator's own error, on top of its noise: ``Estimator`` sets all three."""
        self.wind_m_s = 0.0
        """Of the wind, which blows to the east."""

    @property
    def on_floor(self) -> bool:
        """Whether the floor carries it."""
        return bool(self._nominal.position_m[2] <= self._floor_m)

    @property
    def truth(self) -> Motion:
        """How it really moves, hover noise included."""
        nominal, hover = self._nominal, slice(0, 3)
        position_m = nominal.position_m + self._wake * self._noise.value[hover]
        position_m[2] = max(position_m[2], self._floor_m)
        return replace(
            nominal,
            position_m=position_m,
            velocity_m_s=nominal.velocity_m_s + self._wake * self._noise.rate[hover],
            acceleration_m_s2=nominal.acceleration_m_s2 + self._wake * self._noise.acceleration[hover],
        )

    @property
    def position_error_m(self) -> Array:
        """(3,) estimate minus truth."""
        error_m = self._noise.value[3:6] + self.offset_m
        return np.asarray(error_m + self._wander.value if self.wanders else error_m)

    @property
    def velocity_error_m_s(self) -> Array:
        """(3,) estimate minus truth."""
        return np.asarray(self._noise.rate[3:6] + self.offset_m_s)

    @property
    def attitude_error_rad(self) -> Array:
        """(3,) rotation vector about world axes from truth to estimate."""
        return np.asarray(self._noise.value[6:9] + np.array([0.0, 0.0, self.offset_yaw_rad]))

    def advance(self, dt_s: float, demand: Demand | None) -> None:
        """Move on by ``dt_s``; without a demand the rotors stand still."""
        self._noise.advance(dt_s)
        if self.wanders:
            self._wander.advance(dt_s)
        wanted_m_s2 = np.array([0.0, 0.0, -GRAVITY_M_S2]) if demand is None else self._wanted_acceleration(demand)
        if self.on_floor and wanted_m_s2[2] <= 0.0:
            self._rest()
        else:
            self._fly(dt_s, wanted_m_s2, demand)

    def _rest(self) -> None:
        self._wake = 0.0
        still = np.zeros(3)
        position_m = self._nominal.position_m.copy()
        position_m[2] = self._floor_m
        self._nominal = Motion(position_m, still, still, self._nominal.yaw_rad)

    def _fly(self, dt_s: float, wanted_m_s2: Array, demand: Demand | None) -> None:
        now = self._nominal
        self._wake = min(1.0, self._wake + dt_s)
        lag = min(1.0, dt_s / _ATTITUDE_LAG_S)
        acceleration = now.acceleration_m_s2 + lag * (wanted_m_s2 - now.acceleration_m_s2)
        acceleration[2] = max(acceleration[2], -0.95 * GRAVITY_M_S2)  # a falling body keeps its attitude
        velocity = now.velocity_m_s + dt_s * acceleration
        position = now.position_m + dt_s * (now.velocity_m_s + velocity) / 2.0
        yaw_rate = 0.0 if demand is None else self._wanted_yaw_rate(demand)
        self._nominal = Motion(position, velocity, acceleration, now.yaw_rad + dt_s * yaw_rate, yaw_rate)
        if position[2] < self._floor_m:
            self._rest()

    def _wanted_acceleration(self, demand: Demand) -> Array:
        error_m = _known(demand.position_m - self._nominal.position_m - self.position_error_m)
        limit_m_s2 = self._settings.acceleration_m_s2
        speed_m_s = min(demand.speed_m_s, self._settings.max_speed_m_s)
        velocity = _known(demand.velocity_m_s)
        velocity[:2] = _clipped(velocity[:2] + _approach(error_m[:2], limit_m_s2), speed_m_s)
        climb_m_s = min(demand.climb_m_s, self._settings.climb_speed_m_s)
        if math.isnan(demand.position_m[2]):
            climb_m_s = abs(float(velocity[2]))
        velocity[2:] = _clipped(velocity[2:] + _approach(error_m[2:], limit_m_s2), climb_m_s)
        wanted = _VELOCITY_GAIN * (velocity - self._nominal.velocity_m_s)
        fed = np.isfinite(demand.acceleration_m_s2)
        if np.any(fed):
            free = fed & np.isnan(demand.position_m) & np.isnan(demand.velocity_m_s)
            wanted = np.where(free, 0.0, wanted) + np.where(fed, demand.acceleration_m_s2, 0.0)
        horizontal = np.array(_ADRIFT_M_S2) if demand.adrift else wanted[:2]
        pushed = horizontal + np.array([_WIND_GAIN * self.wind_m_s, 0.0])
        return np.concatenate([_clipped(pushed, limit_m_s2), _clipped(wanted[2:], limit_m_s2)])

    def _wanted_yaw_rate(self, demand: Demand) -> float:
        limit = min(demand.turn_rad_s, math.radians(self._settings.yaw_rate_deg_s))
        rate = demand.yaw_rate_rad_s
        if not math.isnan(demand.yaw_rad):
            estimate = self._nominal.yaw_rad + float(self.attitude_error_rad[2])
            rate = _YAW_GAIN * math.remainder(demand.yaw_rad - estimate, 2.0 * math.pi)
        return max(-limit, min(limit, rate))


def _known(vector: Array) -> Array:
    """Return a vector with zeros where it has NaNs."""
    return np.where(np.isnan(vector), 0.0, vector)


def _approach(error_m: Array, limit_m_s2: float) -> Array:
    """Return the velocity towards a place: proportional near it, and far off what can still be braked in time."""
    distance_m = math.hypot(*error_m)
    braking = _BRAKING * limit_m_s2
    linear_m = braking / _POSITION_GAIN**2
    if distance_m <= linear_m:
        return _POSITION_GAIN * error_m
    speed_m_s = math.sqrt(2.0 * braking * (distance_m - linear_m / 2.0))
    return error_m * (speed_m_s / distance_m)


def _clipped(vector: Array, limit: float) -> Array:
    length = math.hypot(*vector)
    return vector if length <= limit else vector * (limit / length)
