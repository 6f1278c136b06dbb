"""Heads go straight to their aim, the shorter way round that their limits allow. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from camrig.geometry.rotation import wrap_angle
from camrig.messages import HeadAim, HeadCommand, RigPose
from camrig.rig import HeadSpec, Interval
from camrig.steer.state import SteerSettings, SteerState


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


def steer_heads(
    state: SteerState, aims: Mapping[str, HeadAim], pose: RigPose, settings: SteerSettings, now_s: float
) -> tuple[SteerState, list[HeadCommand]]:
    """Command the heads that are not where they shall be, unless they have been told so a moment ago."""
    told = {name: state.head_aims[name] for name in aims.keys() & state.head_aims.keys()}
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
    return replace(state, head_aims=told), commands


def apart_rad(aim: HeadAim, other: HeadAim) -> float:
    """Return the larger of the two axes' differences."""
    return max(abs(aim.pan_rad - other.pan_rad), abs(aim.tilt_rad - other.tilt_rad))
