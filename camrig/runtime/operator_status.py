"""What ``status`` answers: the rig as its operator wants to see it, as one JSON object. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camrig.interfaces import Published
from camrig.messages import Event, FlightState, LinkReport, LinkStatus, RigPlan, Target, TargetStatus
from camrig.pipeline import State
from camrig.pipeline.watch import rig_pose
from camrig.rig import Rig

EVENTS_KEPT = 32


@dataclass(frozen=True)
class View:
    """The daemon at one instant; ``frames`` counts each camera's since the start, ``enabled`` names heads."""

    rig: Rig
    state: State
    targets: tuple[Target, ...]
    frames: Mapping[str, int]
    enabled: frozenset[str]
    now_s: float

    def link(self, device: str) -> LinkReport:
        """Return the last report of a device's link; one that has said nothing yet is closed."""
        return self.state.links.get(device) or LinkReport(device, LinkStatus.CLOSED, self.now_s, "still opening")


@dataclass
class RecentEvents:
    """A sink that keeps the newest events; written by the control thread, read by any."""

    latest: tuple[Event, ...] = ()

    def open(self, rig: Rig) -> None:
        """Do nothing: there is no output to open."""

    def write(self, published: Published) -> None:
        if published.events:
            self.latest = (*self.latest, *published.events)[-EVENTS_KEPT:]

    def close(self) -> None:
        """Do nothing."""


def status_of(view: View, fps: Mapping[str, float], events: tuple[Event, ...]) -> dict[str, object]:
    """Return the status as JSON: metres, degrees and seconds, as each key says; what is unknown is null."""
    pose = rig_pose(view.state, view.now_s)
    heads: dict[str, object] = {}
    for name in view.rig.heads:
        aim = pose.heads.get(name)
        heads[name] = {
            **_link(view, name),
            "enabled": name in view.enabled,
            "pan_deg": None if aim is None else _number(math.degrees(aim.pan_rad), 2),
            "tilt_deg": None if aim is None else _number(math.degrees(aim.tilt_rad), 2),
        }
    return {
        "rig": view.rig.name,
        "stamp_s": round(view.now_s, 3),
        "phase": "scanning" if view.state.mission.scanning else "tracking",
        "targets": {target.id: _target(target, view.now_s) for target in view.targets},
        "cameras": {name: {**_link(view, name), "fps": _number(fps.get(name), 1)} for name in view.rig.cameras},
        "heads": heads,
        "drones": {
            name: {**_link(view, name), "flight": view.state.flight.get(name, FlightState.UNKNOWN).value}
            for name in view.rig.drones
        },
        "plan": _plan(view.state.mission.plan, view.now_s),
        "events": [
            {
                "about": event.about,
                "level": event.level.value,
                "text": event.text,
                "age_s": round(view.now_s - event.stamp_s, 3),
            }
            for event in events
        ],
    }


def _link(view: View, device: str) -> dict[str, object]:
    report = view.link(device)
    return {"link": report.status.value, "loss": report.loss and report.loss.value, "reason": report.reason}


def _target(target: Target, now_s: float) -> dict[str, object]:
    known = target.status is not TargetStatus.UNSEEN
    return {
        "status": target.status.value,
        "position_m": [_number(value, 4) for value in target.position_m] if known else None,
        "sigma_m": [_number(value, 5) for value in np.sqrt(target.covariance_m2.diagonal())] if known else None,
        "seen_by": list(target.seen_by),
        "age_s": _number(now_s - target.last_seen_s, 3),
    }


def _plan(plan: RigPlan | None, now_s: float) -> dict[str, object] | None:
    if plan is None:
        return None
    return {
        "status": plan.status.value,
        "uncovered": list(plan.uncovered),
        "searching": dict(plan.searching),
        "objective_m": _number(plan.objective_m, 6),
        "solve_s": round(plan.solve_s, 4),
        "age_s": round(now_s - plan.stamp_s, 3),
    }


def _number(value: float | None, digits: int) -> float | None:
    """Return a number for JSON, which knows no infinity: what is not finite is unknown."""
    return None if value is None or not math.isfinite(value) else round(float(value), digits)
