"""What ``status`` answers: the rig as its operator wants to see it, as one JSON object. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camrig.interfaces import Published
from camrig.messages import (
    DroneHealth,
    Event,
    FlightState,
    HeadAim,
    LinkReport,
    LinkStatus,
    RigPlan,
    Target,
    TargetStatus,
)
from camrig.pipeline import State, mission
from camrig.rig import Rig

EVENTS_KEPT = 32


@dataclass(frozen=True)
class View:
    """The daemon at one instant."""

    rig: Rig
    state: State
    targets: tuple[Target, ...]
    delivered: Mapping[str, int]
    """How many frames each camera has given since the start, and how many answers each head."""
    enabled: frozenset[str]
    """Heads that may move."""
    now_s: float
    aimed: Mapping[str, HeadAim] = field(default_factory=dict)
    """Where an operator has aimed heads that plans are to leave there."""
    statistics: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """What was counted of each device's link."""
    health: Mapping[str, DroneHealth] = field(default_factory=dict)
    """How the drones are whose drivers tell."""
    flown: frozenset[str] = frozenset()
    """Drones that follow plans."""
    lent: frozenset[str] = frozenset()
    """Devices that other programs have."""

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


def status_of(view: View, rates_hz: Mapping[str, float], events: tuple[Event, ...]) -> dict[str, object]:
    """Return the status as JSON: metres, degrees and seconds, as each key says; what is unknown is null."""
    return {
        "rig": view.rig.name,
        "stamp_s": round(view.now_s, 3),
        "phase": "scanning" if view.state.mission.scanning else "tracking",
        "targets": {
            target.id: _target(target, view.now_s)
            for target in mission.with_promises(view.targets, view.state.mission.plan)
        },
        "cameras": {
            name: {**_link(view, name), "fps": _number(rates_hz.get(name), 1), **_camera(view, name)}
            for name in view.rig.cameras
        },
        "heads": {
            name: {**_link(view, name), **_head(view, name), "answers_hz": _number(rates_hz.get(name), 1)}
            for name in view.rig.heads
        },
        "drones": {name: {**_link(view, name), **_drone(view, name)} for name in view.rig.drones},
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
    return {
        "link": report.status.value,
        "loss": report.loss and report.loss.value,
        "reason": report.reason,
        "since_s": _number(view.now_s - report.stamp_s, 1),
        "statistics": {
            key: value if isinstance(value, int) else _number(value, 4)
            for key, value in view.statistics.get(device, {}).items()
        },
    }


def _camera(view: View, name: str) -> dict[str, object]:
    """Tell how far a camera is from its calibration's place, what was learnt of its lens, how late its head."""
    drift, offset = view.state.drifts.get(name), view.state.histories.offsets.get(name)
    return {
        "drift": drift
        and {
            "turned_deg": _number(math.degrees(drift.turned_rad), 3),
            "moved_m": _number(drift.moved_m, 5),
            "alarming": drift.alarming,
        },
        "lens_refined": _lens(view, name),
        "head_late_s": offset and {"mean": _number(offset.offset_s, 4), "sigma": _number(offset.sigma_s, 4)},
    }


def _lens(view: View, name: str) -> dict[str, object] | None:
    """Tell by how much a lens is another than its calibration says; null where nothing was learnt, or is to be."""
    refined = view.state.lenses.refined.get(name)
    if refined is None:
        return None
    f, cx, cy, k1 = (float(value) for value in refined.mean)
    return {
        "f_percent": round(100.0 * f, 4),
        "centre_px": [round(cx, 3), round(cy, 3)],
        "k1": round(k1, 6),
        "bounded": refined.bounded,
    }


def _head(view: View, name: str) -> dict[str, object]:
    """Tell who controls a head, where it points (one sigma per axis), where an operator wants it, and its limits."""
    history, spec = view.state.histories.heads.get(name), view.rig.heads[name]
    found = history.at(view.now_s) if history is not None else None
    pan_deg, tilt_deg = (None, None) if found is None else np.degrees(found.angles_rad)
    sigma_deg = None if found is None else np.degrees(np.sqrt(found.covariance.diagonal()))
    wanted = view.aimed.get(name)
    return {
        "enabled": name in view.enabled,
        "control": "operator" if wanted else "planner" if name in view.enabled else "held",
        "pan_deg": _number(pan_deg, 2),
        "tilt_deg": _number(tilt_deg, 2),
        "sigma_deg": None if sigma_deg is None else [_number(value, 3) for value in sigma_deg],
        "aim": None if wanted is None else _degrees(("pan_deg", "tilt_deg"), wanted.pan_rad, wanted.tilt_rad),
        "limits": {
            "pan_deg": [_number(math.degrees(end), 3) for end in spec.pan_limits_rad],
            "tilt_deg": [_number(math.degrees(end), 3) for end in spec.tilt_limits_rad],
        },
    }


def _drone(view: View, name: str) -> dict[str, object]:
    """Tell what a drone does, who controls it, whether it is fit to be armed or resumed, and why not."""
    flight, health = view.state.flight.get(name, FlightState.UNKNOWN), view.health.get(name)
    told: dict[str, object] = {
        "flight": flight.value,
        "control": "planner" if name in view.flown else "held" if health and health.activity == "holding" else "nobody",
    }
    if health is None:
        return told
    return told | {
        "activity": health.activity,
        "fit": not health.unfit,
        "unfit": list(health.unfit),
        "advice": list(health.advice),
        "said": health.reason,
        "battery_percent": _number(None if health.battery is None else 100.0 * health.battery, 0),
        "pose_age_s": _number(health.pose_age_s, 2),
        "software": health.software,
    }


def _degrees(keys: tuple[str, ...], *angles_rad: float) -> dict[str, float | None]:
    return {key: _number(math.degrees(angle), 3) for key, angle in zip(keys, angles_rad, strict=True)}


def _target(target: Target, now_s: float) -> dict[str, object]:
    known = target.status is not TargetStatus.UNSEEN
    return {
        "status": target.status.value,
        "position_m": [_number(value, 4) for value in target.position_m] if known else None,
        "sigma_m": [_number(value, 5) for value in np.sqrt(target.covariance_m2.diagonal())] if known else None,
        "planned_sigma_m": target.planned_sigma_m,
        "innovation": _number(target.innovation, 2),
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
