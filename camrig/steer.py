"""Aims -> commands: limits hold whatever the planner says, small moves are not made, drones keep apart. Pure.

Heads go straight to their aim, the shorter way round that their limits allow. Drones follow a set-point a short lead
ahead of where they are; a drone moves only while its whole straight path is free, so that moves that would meet
are made one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from camrig.geometry.airspace import blocked, flight_box, least_distance
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import wrap_angle
from camrig.messages import Aim, Command, DroneAim, DroneCommand, HeadAim, HeadCommand, RigPose
from camrig.rig import DroneMount, DroneSpec, HeadMount, HeadSpec, Interval, Rig

_SLACK_M = 0.01
"""What hovering drifts: drones at their places, kept apart exactly, are not too near."""


@dataclass(frozen=True, slots=True)
class SteerSettings:
    """Moves smaller than a dead band are not commanded; a drone's set-point leads by what it flies in ``lead_s``.

    What has not come to its aim is told again after ``retry_s``.
    """

    dead_band_rad: float = math.radians(0.3)
    dead_band_m: float = 0.03
    lead_s: float = 1.0
    retry_s: float = 2.0


@dataclass(frozen=True, slots=True)
class SteerState:
    """What was commanded last, by head and drone id, and which drones are held back now, with the reason."""

    head_aims: Mapping[str, tuple[HeadAim, float]] = field(default_factory=dict)
    """The aim, and when it was commanded."""
    setpoints: Mapping[str, tuple[DroneAim, float]] = field(default_factory=dict)
    """As far as this a drone flies without a new command, and when it was told."""
    held: Mapping[str, str] = field(default_factory=dict)


def steer(
    state: SteerState,
    goal: Mapping[str, Aim],
    pose: RigPose,
    movable: frozenset[str],
    rig: Rig,
    settings: SteerSettings,
    now_s: float,
) -> tuple[SteerState, tuple[Command, ...]]:
    """Return the commands that bring the rig from ``pose`` towards ``goal``, the aims wanted by camera id.

    Only cameras in ``movable`` are commanded; every other drone in ``pose`` is kept clear of. A head is commanded
    even where its pose is unknown, a drone never. An aim that is not a number is not followed.
    """
    heads: dict[str, HeadAim] = {}
    flights: dict[str, DroneAim] = {}
    for camera_id in sorted(movable & goal.keys()):
        match rig.cameras[camera_id].mount, goal[camera_id]:
            case HeadMount(head=name), HeadAim() as aim if math.isfinite(aim.pan_rad + aim.tilt_rad):
                heads[name] = within_limits(rig.heads[name], aim, pose.heads.get(name))
            case DroneMount(drone=name), DroneAim() as place if math.isfinite(sum(place.position_m) + place.yaw_rad):
                flights[name] = place
    head_aims, head_commands = _steer_heads(state.head_aims, heads, pose, settings, now_s)
    setpoints = {name: told for name, told in state.setpoints.items() if name in flights}
    held, drone_commands = _steer_drones(rig, flights, pose, setpoints, settings, now_s)
    setpoints |= {command.drone_id: (command.aim, now_s) for command in drone_commands}
    return replace(state, head_aims=head_aims, setpoints=setpoints, held=held), (*head_commands, *drone_commands)


def within_limits(head: HeadSpec, aim: HeadAim, present: HeadAim | None) -> HeadAim:
    """Return the aim inside the head's limits, its pan the way round that is nearest to the present one."""
    pan_rad = _nearest_pan(aim.pan_rad, head.pan_limits_rad, present.pan_rad if present else None)
    return HeadAim(pan_rad, min(max(aim.tilt_rad, head.tilt_limits_rad[0]), head.tilt_limits_rad[1]))


def _nearest_pan(pan_rad: float, limits_rad: Interval, present_rad: float | None) -> float:
    low, high = limits_rad
    first, last = math.ceil((low - pan_rad) / math.tau), math.floor((high - pan_rad) / math.tau)
    turns = [pan_rad + math.tau * k for k in range(first, last + 1)]
    if not turns:
        return min(limits_rad, key=lambda limit: abs(wrap_angle(limit - pan_rad)))
    middle = (low + high) / 2.0 if present_rad is None else present_rad
    return min(max(min(turns, key=lambda turn: abs(turn - middle)), low), high)


def _steer_heads(
    commanded: Mapping[str, tuple[HeadAim, float]],
    aims: Mapping[str, HeadAim],
    pose: RigPose,
    settings: SteerSettings,
    now_s: float,
) -> tuple[dict[str, tuple[HeadAim, float]], list[HeadCommand]]:
    """Command the heads that are not where they shall be, unless they have been told so a moment ago."""
    told = {name: commanded[name] for name in aims.keys() & commanded.keys()}
    commands = []
    for name, aim in aims.items():
        present = pose.heads.get(name)
        there = present is not None and apart_rad(aim, present) < settings.dead_band_rad
        if name in told:
            told_aim, told_s = told[name]
            told_so = apart_rad(aim, told_aim) < settings.dead_band_rad
            if told_so and (there or now_s < told_s + settings.retry_s):
                continue
        elif there:
            continue
        told[name] = (aim, now_s)
        commands.append(HeadCommand(name, aim))
    return told, commands


def apart_rad(aim: HeadAim, other: HeadAim) -> float:
    """Return the larger of the two axes' differences."""
    return max(abs(aim.pan_rad - other.pan_rad), abs(aim.tilt_rad - other.tilt_rad))


def _steer_drones(
    rig: Rig,
    flights: Mapping[str, DroneAim],
    pose: RigPose,
    setpoints: Mapping[str, tuple[DroneAim, float]],
    settings: SteerSettings,
    now_s: float,
) -> tuple[dict[str, str], list[DroneCommand]]:
    """Let drones move whose straight paths are free of the others' paths and places, shortest paths first."""
    at = {name: np.array(aim.position_m) for name, aim in pose.drones.items()}
    held = {name: "its position is unknown" for name in flights if name not in at}
    ends = {name: np.clip(np.array(flights[name].position_m), *flight_box(rig.drones[name].box_m)) for name in flights}
    paths = {name: (point, point) for name, point in at.items()}
    paths |= {name: (at[name], np.array(told.position_m)) for name, (told, _) in setpoints.items() if name in at}
    commands = []
    for name in sorted(at.keys() & ends.keys(), key=lambda name: (float(np.linalg.norm(ends[name] - at[name])), name)):
        reason = _obstacle(rig, name, (at[name], ends[name]), paths)
        if reason:
            held[name] = reason
            continue
        paths[name] = (at[name], ends[name])
        command = _step(rig.drones[name], at[name], ends[name], flights[name].yaw_rad, settings)
        told, told_s = setpoints.get(name, (pose.drones[name], now_s))
        waited = now_s >= told_s + settings.retry_s and _differ(command.aim, pose.drones[name], settings)
        if waited or _differ(command.aim, told, settings):
            commands.append(command)
    return held, commands


def _obstacle(rig: Rig, name: str, path: tuple[Array, Array], paths: Mapping[str, tuple[Array, Array]]) -> str:
    """Return what is in the way of a straight flight, or an empty text. Drones keep apart horizontally.

    Two drones that are too near already may part, but not come nearer.
    """
    if bool(blocked(path[0], path[1], rig.space.keep_out_m)):
        return "a keep-out box is in the way"
    for other, (start, end) in paths.items():
        if other == name:
            continue
        least_m = max(rig.drones[name].min_separation_m, rig.drones[other].min_separation_m) - _SLACK_M
        now_m = float(np.linalg.norm(path[0][:2] - start[:2])) - 1e-6
        if least_distance(path[0][:2], path[1][:2], start[:2], end[:2]) < min(least_m, now_m):
            return f"drone {other} is in the way"
    return ""


def _step(drone: DroneSpec, present: Array, end: Array, yaw_rad: float, settings: SteerSettings) -> DroneCommand:
    """Return the set-point on the way to ``end``, at most a lead ahead."""
    way = end - present
    lead_m = drone.speed_m_s * settings.lead_s
    share = min(1.0, lead_m / max(float(np.linalg.norm(way)), 1e-9))
    # A drone found outside its box (still climbing into it) is led inside, never told to stay outside.
    x, y, z = np.clip(end if share >= 1.0 else present + share * way, *flight_box(drone.box_m)).tolist()
    return DroneCommand(drone.id, DroneAim((x, y, z), yaw_rad))


def _differ(aim: DroneAim, other: DroneAim, settings: SteerSettings) -> bool:
    moved_m = math.dist(aim.position_m, other.position_m)
    return moved_m >= settings.dead_band_m or abs(wrap_angle(aim.yaw_rad - other.yaw_rad)) >= settings.dead_band_rad
