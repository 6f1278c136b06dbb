"""Drones fly straight, one after the other where their moves would meet, round each other where they block. Pure.

A drone follows a set-point a short lead ahead of where it is, and moves only while its whole straight path is free of
the places of all others and of what they may still fly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from camrig.geometry.airspace import flight_box
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import wrap_angle
from camrig.messages import DroneAim, DroneCommand, RigPose
from camrig.rig import DroneSpec, Rig
from camrig.steer.detour import way_round
from camrig.steer.sky import Sky
from camrig.steer.state import Leg, SteerSettings, SteerState

Told = Mapping[str, tuple[DroneAim, float]]


def steer_drones(
    state: SteerState,
    goals: Mapping[str, DroneAim],
    pose: RigPose,
    rig: Rig,
    settings: SteerSettings,
    now_s: float,
) -> tuple[SteerState, list[DroneCommand]]:
    """Command the drones in ``goals`` that may fly on, and say who is held back and why."""
    # A drone that was told nothing yet hovers where it is.
    told = {name: (aim, now_s) for name, aim in pose.drones.items() if name in goals}
    told |= {name: said for name, said in state.setpoints.items() if name in pose.drones or name in pose.aloft}
    sky = _sky(rig, pose, told, settings, now_s)
    flown = sorted(goals.keys() & pose.drones.keys())
    wanted_m = {name: _wanted(rig.drones[name], goals[name], sky.places_m[name], settings) for name in flown}
    legs = {name: _leg(state, name, wanted_m[name], sky.places_m[name], settings) for name in flown}
    waiting = [name for name in flown if not _rests(legs[name], sky.places_m[name], told[name][0], settings)]
    # Who is on the way has the right of way, then who has least to fly.
    waiting.sort(key=lambda name: (not legs[name].going, math.dist(sky.places_m[name], legs[name].end_m)))
    held = _let_go(sky, legs, waiting)
    sought_s = state.sought_s
    still = all(math.dist(sky.places_m[name], sky.bound_m[name]) < settings.dead_band_m for name in flown)
    if held and still and not any(leg.going for leg in legs.values()) and now_s >= sought_s + settings.retry_s:
        sought_s = now_s
        _untie(sky, legs, held)
    commands = []
    for name in flown:
        if name not in held:
            command = _step(rig.drones[name], sky.places_m[name], legs[name].point_m, goals[name].yaw_rad, settings)
            if _due(command.aim, told[name], pose.drones[name], legs[name], settings, now_s):
                commands.append(command)
    held |= {name: "its position is unknown" for name in goals if name not in pose.drones}
    told |= {command.drone_id: (command.aim, now_s) for command in commands}
    in_way = frozenset(name for name in flown if _makes_way(sky, name, wanted_m[name], legs, held))
    return replace(state, setpoints=told, legs=legs, held=held, in_way=in_way, sought_s=sought_s), commands


def _sky(rig: Rig, pose: RigPose, told: Told, settings: SteerSettings, now_s: float) -> Sky:
    places_m = {name: np.array(aim.position_m) for name, aim in (*pose.aloft.items(), *pose.drones.items())}
    # A drone comes to its set-point in less than the time to retry, or it was stopped; unseen, it may be anywhere.
    bound = {name for name, (_, told_s) in told.items() if name not in pose.drones or now_s < told_s + settings.retry_s}
    bound_m = {**places_m, **{name: np.array(told[name][0].position_m) for name in bound}}
    sky = Sky(rig, places_m, bound_m, {})
    sky.paths_m.update({name: sky.path(name, bound_m[name]) for name in places_m})
    return sky


def _wanted(drone: DroneSpec, goal: DroneAim, place_m: Array, settings: SteerSettings) -> Array:
    """Return where the drone shall be; one that is found outside its box comes in first, the shortest way."""
    inside_m = np.clip(place_m, *flight_box(drone.box_m))
    outside = math.dist(inside_m, place_m) > settings.dead_band_m
    return np.asarray(inside_m if outside else np.clip(np.array(goal.position_m), *flight_box(drone.box_m)))


def _leg(state: SteerState, name: str, wanted_m: Array, place_m: Array, settings: SteerSettings) -> Leg:
    """Go on with the leg that is being flown where hardly another end is wanted; else begin another one."""
    leg = state.legs.get(name, Leg(place_m, place_m))
    if math.dist(leg.end_m, wanted_m) >= (0.0 if name in state.in_way else settings.dead_band_m):
        return Leg(wanted_m, wanted_m)
    return replace(leg, going=leg.going and math.dist(place_m, leg.point_m) >= settings.dead_band_m)


def _rests(leg: Leg, place_m: Array, told: DroneAim, settings: SteerSettings) -> bool:
    return math.dist(place_m, leg.end_m) < settings.dead_band_m and told.position_m == _triple(leg.end_m)


def _let_go(sky: Sky, legs: dict[str, Leg], waiting: Iterable[str]) -> dict[str, str]:
    """Let everyone go who may, in this order; return who may not, and why."""
    held = {}
    for name in waiting:
        leg = legs[name]
        straight_on = leg.going and leg.straight
        reason = sky.obstacle(name, leg.end_m) or ("" if straight_on else _first(sky, name, legs, waiting))
        if not reason:
            _go(sky, legs, name, leg.end_m)
        elif leg.going and not straight_on and not sky.obstacle(name, leg.point_m):
            _go(sky, legs, name, leg.point_m)
        else:
            legs[name] = replace(leg, going=False)
            held[name] = reason
    return held


def _go(sky: Sky, legs: dict[str, Leg], name: str, point_m: Array) -> None:
    legs[name] = replace(legs[name], point_m=point_m, going=True)
    sky.paths_m[name] = sky.path(name, point_m)


def _first(sky: Sky, name: str, legs: Mapping[str, Leg], waiting: Iterable[str]) -> str:
    """Return who must go first, or an empty text: at its end the drone would be in the way of who still waits."""
    end_m = legs[name].end_m
    others = [other for other in waiting if other != name and not legs[other].going]
    paths_m = {other: np.array([[sky.places_m[other], legs[other].end_m]]) for other in others}
    near = sky.too_near(name, np.array([[end_m, end_m]]), paths_m)[0]
    return f"drone {others[int(np.argmax(near))]} goes first" if near.any() else ""


def _untie(sky: Sky, legs: dict[str, Leg], held: dict[str, str]) -> None:
    """Where nobody can go on: send one drone a way round; else let one go although it will be in another's way."""
    ends_m = {name: leg.end_m for name, leg in legs.items()}
    for name in held:
        corner_m = None if legs[name].rounded else way_round(sky, name, ends_m)
        if corner_m is not None and not sky.obstacle(name, corner_m):
            legs[name] = replace(legs[name], rounded=True)
            _go(sky, legs, name, corner_m)
            break
    else:
        name = next((name for name in held if not sky.obstacle(name, ends_m[name])), "")
        if not name:
            return
        _go(sky, legs, name, ends_m[name])
    del held[name]


def _makes_way(sky: Sky, name: str, wanted_m: Array, legs: Mapping[str, Leg], held: Mapping[str, str]) -> bool:
    """Tell whether somebody is held back by less than the drone's dead band."""
    end_m = legs[name].end_m
    if name in held or np.array_equal(end_m, wanted_m):
        return False
    for other in held.keys() & legs.keys():
        path = sky.path(other, legs[other].end_m)
        there, moved = (sky.too_near(other, path, {name: np.array([[p, p]])}).any() for p in (end_m, wanted_m))
        if there and not moved:
            return True
    return False


def _step(drone: DroneSpec, present_m: Array, point_m: Array, yaw_rad: float, settings: SteerSettings) -> DroneCommand:
    """Return the set-point on the way to a point, at most a lead ahead."""
    way = point_m - present_m
    share = drone.speed_m_s * settings.lead_s / max(float(np.linalg.norm(way)), 1e-9)
    ahead_m = point_m if share >= 1.0 else present_m + share * way
    return DroneCommand(drone.id, DroneAim(_triple(np.clip(ahead_m, *flight_box(drone.box_m))), yaw_rad))


def _due(
    aim: DroneAim,
    told: tuple[DroneAim, float],
    present: DroneAim,
    leg: Leg,
    settings: SteerSettings,
    now_s: float,
) -> bool:
    """Tell whether a set-point is news, or has been waited for too long; the last one of a leg is told exactly."""
    if aim.position_m == _triple(leg.point_m) != told[0].position_m:
        return True
    waited = now_s >= told[1] + settings.retry_s and _differ(aim, present, settings)
    return waited or _differ(aim, told[0], settings)


def _differ(aim: DroneAim, other: DroneAim, settings: SteerSettings) -> bool:
    moved_m = math.dist(aim.position_m, other.position_m)
    return moved_m >= settings.dead_band_m or abs(wrap_angle(aim.yaw_rad - other.yaw_rad)) >= settings.dead_band_rad


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
