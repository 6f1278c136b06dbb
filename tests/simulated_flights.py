"""Drones that fly to their set-points at limited speed, in random rigs, under plans that keep changing.

A drone follows a point that runs to its set-point at the drone's speed: closely, or trailing behind as a real one does,
so that it overshoots where it is told to turn. Time is simulated. ``camrig.steer`` is called each tick as the pipeline
calls it; what is checked is where the drones truly are, at every instant between two ticks, and what they are told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, permutations

import numpy as np

from camrig.geometry.airspace import Corners, blocked, flight_box, inside_any
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.messages import Command, DroneAim, DroneCommand, RigPose
from camrig.rig import CameraSpec, DroneMount, DroneSpec, Rig, Space
from camrig.steer import SteerSettings, SteerState, steer

TICK_S = 0.2
DRIFT_M = 0.002
"""A hovering drone is as far from its set-point, along each axis."""
TRAILING = 0.5
"""What a drone that trails makes up of its distance to the running point in a tick: it is 0.3 s late."""
ARRIVED_M = 0.04
"""The dead band and the drift."""
STUCK_S = 8.0
"""Nothing has moved for so long: nothing will."""
MOST_S = 600.0
ROOM: Corners = ((0.0, 0.0, 0.0), (6.0, 5.0, 3.0))
LENS = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0))
SETTINGS = SteerSettings()

Places = dict[str, Array]


@dataclass(frozen=True, slots=True)
class Trouble:
    """From ``start_s`` to ``end_s`` a drone may not be moved (``halts``: it stops there), or nobody knows its place."""

    drone: str
    start_s: float
    end_s: float
    unknown: bool
    halts: bool

    def at(self, now_s: float) -> bool:
        return self.start_s <= now_s < self.end_s

    def begins(self, now_s: float) -> bool:
        return self.halts and self.at(now_s) and not self.at(now_s - TICK_S)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A rig, where its drones start, and the plans that follow each other, ``(since_s, places)``."""

    rig: Rig
    starts: Places
    plans: tuple[tuple[float, Places], ...]
    troubles: tuple[Trouble, ...] = ()
    closeness: float = 1.0


@dataclass(slots=True)
class Body:
    """Where a drone is, the point it follows, and where that point runs."""

    at_m: Array
    ahead_m: Array
    setpoint_m: Array

    def fly(self, rng: np.random.Generator, speed_m_s: float, closeness: float) -> None:
        way = self.setpoint_m - self.ahead_m
        self.ahead_m = self.ahead_m + way * min(1.0, speed_m_s * TICK_S / max(float(np.linalg.norm(way)), 1e-9))
        self.at_m = self.at_m + closeness * (self.ahead_m - self.at_m) + rng.uniform(-DRIFT_M, DRIFT_M, 3)


@dataclass(slots=True)
class Seen:
    """The worst of a flight, in metres: positive is how far inside of what is permitted it stayed."""

    separation_m: float = math.inf
    box_m: float = math.inf
    keep_out_m: float = math.inf
    told_m: float = math.inf
    held: Mapping[str, str] = field(default_factory=dict)
    late: tuple[str, ...] = ()
    """Who is not at the last plan's place in the end."""
    flown_s: float = 0.0


def least_m(rig: Rig, one: str, other: str) -> float:
    return max(rig.drones[one].min_separation_m, rig.drones[other].min_separation_m)


def apart(rig: Rig, places: Places) -> bool:
    return all(math.dist(places[a][:2], places[b][:2]) >= least_m(rig, a, b) for a, b in combinations(places, 2))


def scenario(rng: np.random.Generator, count: int, keep_outs: int, plans: int, *, troubles: bool) -> Scenario:
    """Draw a rig of ``count`` drones that has room for its starts and plans."""
    while True:
        rig = _rig(rng, count, keep_outs)
        starts = _places(rng, rig, {})
        if starts is None:
            continue
        since_s, goals = 0.0, [(0.0, starts)]
        for _ in range(plans):
            places = _places(rng, rig, goals[-1][1])
            goals.append((since_s, places if places is not None else goals[-1][1]))
            since_s += float(rng.uniform(0.5, 8.0))
        drawn = tuple(_trouble(rng, name, since_s) for name in rig.drones if troubles and rng.random() < 0.4)
        return Scenario(rig, starts, tuple(goals[1:]), drawn, 1.0 if rng.random() < 0.5 else TRAILING)


def _rig(rng: np.random.Generator, count: int, keep_outs: int) -> Rig:
    separation_m, low, high = float(rng.uniform(0.3, 0.9)), np.array(ROOM[0]), np.array(ROOM[1])
    drones = {}
    for i in range(count):
        box = ROOM
        if rng.random() < 0.5:
            a = rng.uniform(low, high - (2.0, 2.0, 1.6))
            box = _corners(a, rng.uniform(np.add(a, (2.0, 2.0, 1.6)), high))
        own_m = separation_m if rng.random() < 0.8 else float(rng.uniform(0.3, 0.9))
        drones[f"d{i}"] = DroneSpec(f"d{i}", box, own_m, float(rng.uniform(0.3, 1.5)))
    cameras = {f"c{i}": CameraSpec(f"c{i}", LENS, DroneMount(f"d{i}", np.eye(4))) for i in range(count)}
    boxes = []
    for _ in range(keep_outs):
        a = rng.uniform(low, high - 1.0) * (1.0, 1.0, rng.random() < 0.3)
        boxes.append(_corners(a, a + rng.uniform(0.3, (1.5, 1.5, 2.8))))
    return Rig("r", Space(keep_out_m=tuple(boxes)), cameras, drones=drones)


def _corners(low: Array, high: Array) -> Corners:
    (a, b, c), (d, e, f) = low.tolist(), high.tolist()
    return (a, b, c), (d, e, f)


def _places(rng: np.random.Generator, rig: Rig, before: Places) -> Places | None:
    """Draw permitted places: anywhere, a little beside the last ones, those of another drone, exactly at a limit."""
    names = [str(name) for name in rng.permutation(list(rig.drones))]
    style = rng.random()
    for _ in range(40):
        places: Places = {}
        for name, giver in zip(names, np.roll(names, 1), strict=True):
            low, high = flight_box(rig.drones[name].box_m)
            place = rng.uniform(low, high)
            if before and style < 0.15:
                place = before[name] + rng.uniform(-0.028, 0.028, 3) / math.sqrt(3.0)
            elif before and style < 0.4:
                place = before[str(giver)]
            elif places and rng.random() < 0.3:
                place = _beside(rng, rig, name, places)
            elif rig.space.keep_out_m and rng.random() < 0.1:
                place[2] = rig.space.keep_out_m[0][1][2]
            place = np.clip(place, low, high)
            if not inside_any(place, rig.space.keep_out_m) and apart(rig, {**places, name: place}):
                places[name] = place
        if len(places) == len(names):
            return places
        style = 1.0 if rng.random() < 0.2 else style
    return None


def _beside(rng: np.random.Generator, rig: Rig, name: str, places: Places) -> Array:
    other, bearing_rad = str(rng.choice(list(places))), float(rng.uniform(0.0, math.tau))
    away_m = least_m(rig, name, other) + 1e-9
    level = places[other] + away_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
    level[2] = rng.uniform(1.0, 3.0)
    return np.asarray(level)


def _trouble(rng: np.random.Generator, name: str, until_s: float) -> Trouble:
    start_s = float(rng.uniform(0.0, until_s))
    return Trouble(name, start_s, start_s + float(rng.uniform(0.5, 10.0)), rng.random() < 0.5, rng.random() < 0.5)


def fly(drawn: Scenario, rng: np.random.Generator) -> Seen:
    """Fly a scenario until all have arrived, or nothing moves any more."""
    rig, seen, state = drawn.rig, Seen(), SteerState()
    bodies = {name: Body(place, place, place) for name, place in drawn.starts.items()}
    at = known = dict(drawn.starts)
    still_s, last_s = 0.0, max([since_s for since_s, _ in drawn.plans] + [trouble.end_s for trouble in drawn.troubles])
    while seen.flown_s <= last_s or (seen.late and still_s < STUCK_S):
        now_s = seen.flown_s
        places = next(places for since_s, places in reversed(drawn.plans) if since_s <= now_s)
        ill = [trouble for trouble in drawn.troubles if trouble.at(now_s)]
        known = known | {name: at[name] for name in at if all(name != t.drone or not t.unknown for t in ill)}
        state, commands = _steered(rig, state, places, at, ill, known, now_s)
        _check_told(rig, at, commands, seen)
        _obey(bodies, commands, [trouble.drone for trouble in ill if trouble.begins(now_s)])
        for name, body in bodies.items():
            body.fly(rng, rig.drones[name].speed_m_s, drawn.closeness)
        moved = {name: body.at_m for name, body in bodies.items()}
        _check_flown(rig, at, moved, seen)
        moves = now_s <= last_s or any(math.dist(at[name], moved[name]) > 5.0 * DRIFT_M for name in at)
        still_s = 0.0 if moves else still_s + TICK_S
        at = moved
        seen.late = tuple(name for name in at if math.dist(at[name], places[name]) > ARRIVED_M)
        seen.held, seen.flown_s = state.held, now_s + TICK_S
        assert seen.flown_s < MOST_S, "drones fly on and on"
    return seen


def _obey(bodies: Mapping[str, Body], commands: tuple[Command, ...], halted: list[str]) -> None:
    for command in commands:
        assert isinstance(command, DroneCommand)
        bodies[command.drone_id].setpoint_m = np.array(command.aim.position_m)
    for name in halted:
        bodies[name].setpoint_m = bodies[name].ahead_m = bodies[name].at_m


def _steered(
    rig: Rig, state: SteerState, places: Places, at: Places, ill: list[Trouble], known: Places, now_s: float
) -> tuple[SteerState, tuple[Command, ...]]:
    unknown = {trouble.drone for trouble in ill if trouble.unknown}
    drones = {name: _aim(place) for name, place in at.items() if name not in unknown}
    aloft = {name: _aim(known[name]) for name in unknown}
    movable = frozenset(f"c{name[1:]}" for name in at if all(trouble.drone != name for trouble in ill))
    goal = {f"c{name[1:]}": _aim(place) for name, place in places.items()}
    return steer(state, goal, RigPose(drones=drones, aloft=aloft), movable, rig, SETTINGS, now_s)


def _aim(place: Array) -> DroneAim:
    x, y, z = place.tolist()
    return DroneAim((x, y, z))


def _check_told(rig: Rig, at: Places, commands: tuple[Command, ...], seen: Seen) -> None:
    for command in commands:
        assert isinstance(command, DroneCommand)
        point = np.array(command.aim.position_m)
        low, high = flight_box(rig.drones[command.drone_id].box_m)
        seen.told_m = min(seen.told_m, float(np.min([point - low, high - point])))
        _check_keep_out(rig, at[command.drone_id], point, seen)


def _check_keep_out(rig: Rig, start: Array, end: Array, seen: Seen) -> None:
    """Find by how much a flight cuts into a keep-out box, to the half centimetre."""
    depth_m = 0.0
    while blocked(start, end, [_shrunk(box, depth_m) for box in rig.space.keep_out_m]):
        depth_m += 0.005
    seen.keep_out_m = min(seen.keep_out_m, -depth_m)


def _shrunk(box: Corners, depth_m: float) -> Corners:
    low, high = np.array(box[0]) + depth_m, np.array(box[1]) - depth_m
    return _corners(np.minimum(low, high), np.maximum(low, high)) if (low < high).all() else _corners(low, low)


def _check_flown(rig: Rig, at: Places, moved: Places, seen: Seen) -> None:
    """Look at every instant of a tick: in it each drone flies straight, at a steady speed."""
    names = list(at)
    a, b = np.array([at[name] for name in names]), np.array([moved[name] for name in names])
    for i, j in combinations(range(len(names)), 2):
        gap, step = (a[i] - a[j])[:2], (b[i] - b[j] - a[i] + a[j])[:2]
        share = min(max(-float(gap @ step) / max(float(step @ step), 1e-18), 0.0), 1.0)
        margin_m = math.hypot(*(gap + share * step)) - least_m(rig, names[i], names[j])
        seen.separation_m = min(seen.separation_m, margin_m)
    for i, name in enumerate(names):
        low, high = flight_box(rig.drones[name].box_m)
        seen.box_m = min(seen.box_m, float(np.min([b[i] - low, high - b[i]])))
        if math.dist(a[i], b[i]) > 5.0 * DRIFT_M:
            _check_keep_out(rig, a[i], b[i], seen)


def sequence_exists(drawn: Scenario) -> bool:
    """Tell whether the drones can go from their starts to the last plan's places straight, one after the other."""
    ends = drawn.plans[-1][1]
    return any(_sequence(drawn.rig, drawn.starts, ends, order) for order in permutations(drawn.starts))


def _sequence(rig: Rig, starts: Places, ends: Places, order: tuple[str, ...]) -> bool:
    places = dict(starts)
    for name in order:
        start, end = places[name], ends[name]
        if blocked(start, end, rig.space.keep_out_m):
            return False
        for other, place in places.items():
            if other == name:
                continue
            way = (end - start)[:2]
            share = min(max(float((place - start)[:2] @ way) / max(float(way @ way), 1e-18), 0.0), 1.0)
            if math.hypot(*((start - place)[:2] + share * way)) < least_m(rig, name, other):
                return False
        places[name] = end
    return True
