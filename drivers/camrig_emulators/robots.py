"""How the emulated targets move: exact poses at any world time, forwards and backwards, from a seed alone.

Each robot drives round a closed, smooth curve (a short Fourier series) whose length it covers once in a period
that all robots share. The whole future is therefore one period long, and that they keep their distance, their
speed and to the floor is checked over it before the first frame is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.rig import Body, Space

_HARMONICS = np.arange(1, 4)
_DRAWS = 2000
_STARTS = 36
_ARC_SAMPLES = 512
_CHECK_SAMPLES = 360
_MAX_YAW_RATE_RAD_S = 1.0
_CLEARANCE_M = 0.5
_FREE_HEIGHT_M = (0.4, 1.2)


@dataclass(frozen=True, slots=True)
class RobotLimits:
    """What every route keeps: distance to the floor's edge and to boxes, and the range of its speed."""

    margin_m: float = 0.35
    speed_m_s: tuple[float, float] = (0.1, 0.4)


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A closed curve and the speed on it.

    ``coefficients`` (2, 2, harmonics) are the cosine and then the sine amplitudes of x and y in metres, ``arc`` the
    curve parameter (radians) at equal steps of arc length, ``start`` the share of a period driven at time 0,
    ``modulation`` the depth and the phase (radians) of the speed's swing, ``height_m`` the lowest and highest z.
    """

    centre_m: Array
    coefficients: Array
    arc: Array
    period_s: float
    start: float
    modulation: tuple[float, float]
    height_m: tuple[float, float] = (0.0, 0.0)

    def states(self, time_s: Array) -> tuple[Array, Array]:
        """Return positions (n, 3) in metres and headings (n,) in radians at the world times ``time_s`` (n,)."""
        turns = np.asarray(time_s, dtype=float) / self.period_s + self.start
        depth, phase = self.modulation
        # The speed swings by +-depth twice a round; its integral gives the share of the length covered.
        swing = depth / (4.0 * math.pi) * np.sin(4.0 * math.pi * turns + phase)
        parameter = _along(self.arc, turns + swing)
        position = self.centre_m + _curve(self.coefficients, parameter)
        velocity = _curve_slope(self.coefficients, parameter)
        low, high = self.height_m
        z = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2.0 * math.pi * turns + phase)
        return np.column_stack([position, z]), np.arctan2(velocity[:, 1], velocity[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """A target that stands still: position (3,) in metres and heading in radians."""

    position_m: Array
    heading_rad: float

    def states(self, time_s: Array) -> tuple[Array, Array]:
        """Return the same position and heading for each of ``time_s`` (n,)."""
        n = len(time_s)
        return np.tile(self.position_m, (n, 1)), np.full(n, self.heading_rad)


Motion = Route | Stand


def plan_motions(targets: Mapping[str, Body], space: Space, limits: RobotLimits, seed: int) -> dict[str, Motion]:
    """Draw one motion per target; raises InputError where the floor has no room for them.

    The result depends on the arguments alone. Those that stand still are placed first; a robot added at the end of
    the mapping leaves the others' routes as they were.
    """
    period_s = _period_s(space, limits)
    times = _check_times(period_s)
    order = sorted(targets, key=lambda name: targets[name].motion != "static")
    motions: dict[str, Motion] = {}
    taken: list[Array] = []
    for number, name in enumerate(order):
        rng = np.random.default_rng([seed, number])
        still = targets[name].motion == "static"
        heights = _FREE_HEIGHT_M if targets[name].motion == "free" else (0.0, 0.0)
        motion = (
            _place(name, space, limits, taken, rng)
            if still
            else _find_route(name, space, limits, taken, period_s, heights, rng)
        )
        motions[name] = motion
        taken.append(motion.states(times)[0][:, :2])
    return {name: motions[name] for name in targets}


def poses(motions: Mapping[str, Motion], time_s: float) -> dict[str, Transform]:
    """Return ``T_world_body`` of every target at one world time."""
    result = {}
    for name, motion in motions.items():
        positions, headings = motion.states(np.array([time_s]))
        cos, sin = math.cos(headings[0]), math.sin(headings[0])
        T = np.eye(4)
        T[:2, :2] = [[cos, -sin], [sin, cos]]
        T[:3, 3] = positions[0]
        result[name] = T
    return result


def _curve(coefficients: Array, parameter: Array) -> Array:
    """Return the curve's (n, 2) points about its centre."""
    angle = np.multiply.outer(parameter, _HARMONICS)
    return np.asarray(np.cos(angle) @ coefficients[0].T + np.sin(angle) @ coefficients[1].T)


def _curve_slope(coefficients: Array, parameter: Array) -> Array:
    """Return d point / d parameter, (n, 2)."""
    angle = np.multiply.outer(parameter, _HARMONICS)
    scaled = coefficients * _HARMONICS
    return np.asarray(np.cos(angle) @ scaled[1].T - np.sin(angle) @ scaled[0].T)


def _along(arc: Array, share: Array) -> Array:
    """Return the curve parameter after a share of the length; Catmull-Rom, so that the speed has no jumps."""
    turns = np.floor(share)
    at = (share - turns) * _ARC_SAMPLES
    index = at.astype(int)
    u = at - index
    p0, p1, p2, p3 = (_wrapped(arc, index + step) for step in (-1, 0, 1, 2))
    inner = p1 + 0.5 * u * (p2 - p0 + u * (2 * p0 - 5 * p1 + 4 * p2 - p3 + u * (3 * (p1 - p2) + p3 - p0)))
    return np.asarray(inner + 2.0 * math.pi * turns)


def _wrapped(arc: Array, index: Array) -> Array:
    return np.asarray(arc[index % _ARC_SAMPLES] + 2.0 * math.pi * np.floor_divide(index, _ARC_SAMPLES))


def _arc_table(coefficients: Array) -> tuple[Array, float]:
    """Return the parameter at ``_ARC_SAMPLES`` equal steps of arc length from 0, and the whole length in metres."""
    fine = np.linspace(0.0, 2.0 * math.pi, 8 * _ARC_SAMPLES + 1)
    speed = np.linalg.norm(_curve_slope(coefficients, fine), axis=1)
    length = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine))])
    wanted = np.linspace(0.0, length[-1], _ARC_SAMPLES, endpoint=False)
    return np.interp(wanted, length, fine), float(length[-1])


def _period_s(space: Space, limits: RobotLimits) -> float:
    """Return a period in which a curve of the floor's size is driven at the middle of the speed range."""
    (x0, y0), (x1, y1) = space.floor_m
    reach = (x1 - x0 - 2 * limits.margin_m, y1 - y0 - 2 * limits.margin_m)
    if min(reach) <= 0.0:
        raise InputError(
            f"world: a floor of {x1 - x0:g} x {y1 - y0:g} m leaves robots no room inside a margin of "
            f"{limits.margin_m:g} m; make space.floor_m larger or robot_margin_m smaller"
        )
    return min(60.0, 1.2 * sum(reach) / (0.5 * sum(limits.speed_m_s)))


def _inside(points: Array, space: Space, margin_m: float) -> float:
    """Return the least distance (m) of (n, 2) points to the floor's edge and to boxes, beyond the margin."""
    low, high = np.asarray(space.floor_m)
    room = min(float((points - low).min()), float((high - points).min())) - margin_m
    for box_low, box_high in space.keep_out_m:
        if box_low[2] > _FREE_HEIGHT_M[1]:
            continue
        outside = np.maximum(np.asarray(box_low[:2]) - points, points - np.asarray(box_high[:2])).max(axis=1)
        room = min(room, float(outside.min()) - margin_m)
    return room


def _distance(points: Array, taken: Sequence[Array]) -> float:
    """Return the least distance (m) of a sampled route to all others at equal times."""
    return min((float(np.linalg.norm(points - other, axis=1).min()) for other in taken), default=math.inf)


def _place(name: str, space: Space, limits: RobotLimits, taken: Sequence[Array], rng: np.random.Generator) -> Stand:
    low, high = np.asarray(space.floor_m)
    for _ in range(_DRAWS):
        spot = rng.uniform(low + limits.margin_m, high - limits.margin_m)
        if _inside(spot[None], space, limits.margin_m) >= 0.0 and _distance(spot[None], taken) >= _CLEARANCE_M:
            return Stand(np.append(spot, 0.0), float(rng.uniform(-math.pi, math.pi)))
    raise InputError(f"world: no room on the floor for {name}; make space.floor_m larger or list fewer targets")


def _find_route(
    name: str,
    space: Space,
    limits: RobotLimits,
    taken: Sequence[Array],
    period_s: float,
    heights: tuple[float, float],
    rng: np.random.Generator,
) -> Route:
    """Draw routes until one keeps its distance; the longer it takes, the less is asked of distance and turns."""
    best: tuple[float, Route] | None = None
    for draw in range(_DRAWS):
        haste = draw / _DRAWS
        if best is not None and best[0] >= _CLEARANCE_M * (1.0 - haste):
            return best[1]
        route = _draw_route(space, limits, period_s, heights, _MAX_YAW_RATE_RAD_S * (1.0 + 2.0 * haste), rng)
        if route is None:
            continue
        distance, start = _best_start(route, taken)
        if best is None or distance > best[0]:
            best = (distance, replace(route, start=start))
    if best is None:
        raise InputError(
            f"world: no route for {name} fits the floor at {limits.speed_m_s[0]:g} to {limits.speed_m_s[1]:g} m/s; "
            "make space.floor_m larger or the speeds lower"
        )
    return best[1]


def _draw_route(
    space: Space,
    limits: RobotLimits,
    period_s: float,
    heights: tuple[float, float],
    yaw_rate_rad_s: float,
    rng: np.random.Generator,
) -> Route | None:
    """Draw a curve of a length that the speed range allows, at a random place; None where it does not fit."""
    slow, fast = limits.speed_m_s
    mean = rng.uniform(slow + 0.25 * (fast - slow), fast - 0.25 * (fast - slow))
    depth = min(mean - slow, fast - mean) / mean
    shape = rng.normal(size=(2, 2, len(_HARMONICS))) / _HARMONICS**1.8
    place, phase = rng.uniform(size=2), rng.uniform(0.0, 2.0 * math.pi)
    arc, length_m = _arc_table(shape)
    coefficients = shape * (mean * period_s / length_m)
    points = _curve(coefficients, arc)
    low, high = np.asarray(space.floor_m)
    first, last = low + limits.margin_m - points.min(axis=0), high - limits.margin_m - points.max(axis=0)
    if np.any(first > last):
        return None
    route = Route(first + place * (last - first), coefficients, arc, period_s, 0.0, (depth, phase), heights)
    points, headings = route.states(_check_times(period_s))
    gentle = _yaw_rate_rad_s(headings, period_s) <= yaw_rate_rad_s
    return route if gentle and _inside(points[:, :2], space, limits.margin_m) >= -1e-9 else None


def _best_start(route: Route, taken: Sequence[Array]) -> tuple[float, float]:
    """Return the largest least distance (m) to the others, and the share of the period to set out at for it."""
    points = route.states(_check_times(route.period_s))[0][:, :2]
    step = _CHECK_SAMPLES // _STARTS
    distances = [_distance(np.roll(points, -shift, axis=0), taken) for shift in range(0, _CHECK_SAMPLES, step)]
    best = int(np.argmax(distances))
    return distances[best], best / _STARTS


def _yaw_rate_rad_s(headings: Array, period_s: float) -> float:
    turn = np.angle(np.exp(1j * np.diff(headings, append=headings[:1])))
    return float(np.abs(turn).max()) * _CHECK_SAMPLES / period_s


def _check_times(period_s: float) -> Array:
    return np.linspace(0.0, period_s, _CHECK_SAMPLES, endpoint=False)
