"""Where heads and drones were at a frame's stamp: immutable series of readings, interpolated, with covariance.

Pan and tilt are sampled apart and stay apart: each axis is interpolated at the stamp by itself.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Protocol, TypeVar

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp, rotation_log, wrap_angle
from camrig.locate import curve
from camrig.locate.time_offset import TimeOffset, begin
from camrig.messages import AxisReading, DroneReading
from camrig.rig import CameraSpec, DroneMount, HeadMount

KEEP_S = 3.0
MAX_GAP_S = 1.0
"""Between readings further apart the carrier's pose is unknown."""

MAX_REACH_S = 0.5
"""Further outside the readings the carrier's pose is unknown."""

_TURNS = 4.0
"""Readings that differ by so many sigmas of their noise tell of a turn."""

LEADING = 6
"""How many readings of an axis are followed up to a stamp."""

DRONE_ACCELERATION_M_S2 = 2.0
DRONE_ACCELERATION_RAD_S2 = 5.0
"""What a carrier may do unseen: between readings a motion bounded by it strays a dt^2 w (1 - w) / 2 from the chord,
outside them a dt^2 / 2 from the straight continuation; both are taken as one sigma.
"""


class _Stamped(Protocol):
    @property
    def stamp_s(self) -> float: ...


ReadingT = TypeVar("ReadingT", bound=_Stamped)


@dataclass(frozen=True, slots=True)
class AxisHistory:
    """The last ``KEEP_S`` seconds of one axis, oldest first."""

    readings: tuple[AxisReading, ...] = ()

    def at(self, stamp_s: float) -> tuple[float, float] | None:
        """Return angle (rad, continued from the readings, not wrapped) and variance (rad2); None where unknown."""
        span = _span(self.readings, stamp_s)
        if span is None:
            return None
        before, after, _, outside_s = span
        if before is after:
            stray = 0.5 * curve.ACCELERATION_RAD_S2 * outside_s**2
            return before.angle_rad, before.sigma_rad**2 + stray**2
        return curve.axis_at(_around(self.readings, after), stamp_s)

    def rate_rad_s(self, stamp_s: float) -> float:
        """Return how fast it turns between the readings round the stamp; 0 where these are not known, or differ by no
        more than their noise.
        """
        span = _span(self.readings, stamp_s)
        if span is None or span[0] is span[1]:
            return 0.0
        before, after, _, _ = span
        turn_rad = wrap_angle(after.angle_rad - before.angle_rad)
        noise_rad = math.hypot(before.noise_rad or before.sigma_rad, after.noise_rad or after.sigma_rad)
        return turn_rad / (after.stamp_s - before.stamp_s) if abs(turn_rad) > _TURNS * noise_rad else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class HeadState:
    """Pan and tilt (2,) rad at one instant and their (2, 2) covariance, without the head's bias."""

    angles_rad: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class HeadHistory:
    """Both axes of one head."""

    pan: AxisHistory = AxisHistory()
    tilt: AxisHistory = AxisHistory()

    def with_reading(self, reading: AxisReading) -> HeadHistory:
        """Return the history with one more reading, in whatever order readings come."""
        axis = self.pan if reading.axis == "pan" else self.tilt
        grown = AxisHistory(_insert(axis.readings, reading))
        return replace(self, pan=grown) if reading.axis == "pan" else replace(self, tilt=grown)

    def covers(self, stamp_s: float) -> bool:
        """Tell whether both axes have readings on both sides of the stamp."""
        return all(_covers(axis.readings, stamp_s) for axis in (self.pan, self.tilt))

    def rates_rad_s(self, stamp_s: float) -> Array:
        """Return how fast (2,) pan and tilt turn between the readings round the stamp; 0 where these are not known."""
        return np.array([self.pan.rate_rad_s(stamp_s), self.tilt.rate_rad_s(stamp_s)])

    def at(self, stamp_s: float) -> HeadState | None:
        """Return both angles at the stamp; None where an axis is unknown."""
        pan, tilt = self.pan.at(stamp_s), self.tilt.at(stamp_s)
        if pan is None or tilt is None:
            return None
        return HeadState(np.array([pan[0], tilt[0]]), np.diag([pan[1], tilt[1]]))


@dataclass(frozen=True, slots=True)
class DroneHistory:
    """The last ``KEEP_S`` seconds of one drone."""

    readings: tuple[DroneReading, ...] = ()

    def with_reading(self, reading: DroneReading) -> DroneHistory:
        """Return the history with one more reading, in whatever order readings come."""
        return DroneHistory(_insert(self.readings, reading))

    def covers(self, stamp_s: float) -> bool:
        """Tell whether there are readings on both sides of the stamp."""
        return _covers(self.readings, stamp_s)

    def at(self, stamp_s: float) -> tuple[Transform, Array] | None:
        """Return ``T_world_body`` and its (6, 6) covariance at the stamp; None where unknown.

        A drone's readings share their errors, so interpolation does not average them away.
        """
        span = _span(self.readings, stamp_s)
        if span is None:
            return None
        before, after, share, outside_s = span
        gap_s = after.stamp_s - before.stamp_s
        T_a, T_b = before.T_world_body, after.T_world_body
        turn = rotation_log(T_b[:3, :3] @ T_a[:3, :3].T)
        position = T_a[:3, 3] + share * (T_b[:3, 3] - T_a[:3, 3])
        inside = min(max(share, 0.0), 1.0)
        covariance = (1.0 - inside) * before.covariance + inside * after.covariance
        for rows, acceleration in ((range(3), DRONE_ACCELERATION_M_S2), (range(3, 6), DRONE_ACCELERATION_RAD_S2)):
            stray = _stray(acceleration, gap_s, share) + 0.5 * acceleration * outside_s**2
            covariance[rows, rows] += stray**2
        return transform(rotation_exp(share * turn) @ T_a[:3, :3], position), covariance


@dataclass(frozen=True, slots=True)
class Histories:
    """The histories of all carriers, by head and drone id, and by how much a camera's stamps and its head's are apart,
    by camera id; what nothing is known of is absent.
    """

    heads: Mapping[str, HeadHistory] = field(default_factory=lambda: MappingProxyType({}))
    drones: Mapping[str, DroneHistory] = field(default_factory=lambda: MappingProxyType({}))
    offsets: Mapping[str, TimeOffset] = field(default_factory=lambda: MappingProxyType({}))

    def offset(self, camera_id: str) -> TimeOffset:
        """Return what is known of the time between a camera's stamps and its head's."""
        return self.offsets.get(camera_id) or begin()

    def with_reading(self, reading: AxisReading | DroneReading) -> Histories:
        """Return the histories with one more reading of a head's axis or of a drone."""
        if isinstance(reading, AxisReading):
            head = self.heads.get(reading.head_id, HeadHistory()).with_reading(reading)
            return replace(self, heads={**self.heads, reading.head_id: head})
        drone = self.drones.get(reading.drone_id, DroneHistory()).with_reading(reading)
        return replace(self, drones={**self.drones, reading.drone_id: drone})

    def covers(self, camera: CameraSpec, stamp_s: float) -> bool:
        """Tell whether the camera's carrier has readings on both sides of the stamp; true of one that has none.

        A frame that is not covered yet is better kept back for the few milliseconds until it is.
        """
        match camera.mount:
            case HeadMount(head=head):
                later_s = stamp_s + self.offset(camera.id).offset_s
                return head in self.heads and self.heads[head].covers(later_s)
            case DroneMount(drone=drone):
                return drone in self.drones and self.drones[drone].covers(stamp_s)
            case _:
                return True


def _insert(readings: tuple[ReadingT, ...], reading: ReadingT) -> tuple[ReadingT, ...]:
    """Return the series with ``reading`` in its place and what is too old gone; the same stamp again replaces."""
    place = bisect_right(readings, reading.stamp_s, key=lambda known: known.stamp_s)
    before, after = readings[:place], readings[place:]
    if before and before[-1].stamp_s == reading.stamp_s:
        before = before[:-1]
    series = (*before, reading, *after)
    oldest_s = series[-1].stamp_s - KEEP_S
    return series[bisect_right(series, oldest_s, key=lambda known: known.stamp_s) :]


def _covers(readings: tuple[ReadingT, ...], stamp_s: float) -> bool:
    span = _span(readings, stamp_s)
    return span is not None and span[3] == 0.0


def _span(readings: tuple[ReadingT, ...], stamp_s: float) -> tuple[ReadingT, ReadingT, float, float] | None:
    """Return the two readings to reckon from, the share of the way from one to the other, and how many seconds the
    stamp lies outside the series. One reading alone, or one after a long silence, stands for both.
    """
    if not readings:
        return None
    outside_s = max(readings[0].stamp_s - stamp_s, stamp_s - readings[-1].stamp_s, 0.0)
    if outside_s > MAX_REACH_S:
        return None
    place = min(max(bisect_right(readings, stamp_s, key=lambda known: known.stamp_s), 1), len(readings) - 1)
    before, after = readings[max(place - 1, 0)], readings[place]
    gap_s = after.stamp_s - before.stamp_s
    if gap_s > MAX_GAP_S or gap_s == 0.0:
        nearest = before if abs(stamp_s - before.stamp_s) <= abs(stamp_s - after.stamp_s) else after
        known = outside_s > 0.0 or stamp_s == nearest.stamp_s
        return (nearest, nearest, 0.0, outside_s) if known else None
    return before, after, (stamp_s - before.stamp_s) / gap_s, outside_s


def _stray(acceleration: float, gap_s: float, share: float) -> float:
    """Return how far a motion of bounded acceleration may stray from the chord at ``share`` of the way."""
    return 0.5 * acceleration * gap_s**2 * max(0.0, share * (1.0 - share))


def _around(readings: tuple[AxisReading, ...], after: AxisReading) -> tuple[AxisReading, ...]:
    """Return the readings that lead to one, not beyond a long silence."""
    last = first = readings.index(after)
    while first > max(0, last - LEADING) and readings[first].stamp_s - readings[first - 1].stamp_s <= MAX_GAP_S:
        first -= 1
    return readings[first : last + 1]
