"""Aims -> commands: limits hold whatever the planner says, small moves are not made, drones keep apart. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from camrig.messages import Aim, Command, DroneAim, HeadAim, RigPose
from camrig.rig import DroneMount, HeadMount, Rig
from camrig.steer.drones import steer_drones
from camrig.steer.heads import apart_rad, steer_heads, within_limits
from camrig.steer.state import SteerSettings, SteerState
from camrig.steer.take_off import take_off_obstacle

__all__ = ["SteerSettings", "SteerState", "apart_rad", "steer", "take_off_obstacle", "within_limits"]


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
    drones: dict[str, DroneAim] = {}
    for camera_id in sorted(movable & goal.keys()):
        match rig.cameras[camera_id].mount, goal[camera_id]:
            case HeadMount(head=name), HeadAim() as aim if math.isfinite(aim.pan_rad + aim.tilt_rad):
                heads[name] = within_limits(rig.heads[name], aim, pose.heads.get(name))
            case DroneMount(drone=name), DroneAim() as place if math.isfinite(sum(place.position_m) + place.yaw_rad):
                drones[name] = place
    state, head_commands = steer_heads(state, heads, pose, settings, now_s)
    state, drone_commands = steer_drones(state, drones, pose, rig, settings, now_s)
    return state, (*head_commands, *drone_commands)
