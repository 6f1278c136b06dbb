"""What the pipeline knows of its devices: readings, links, who can move, what a lost device costs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from camrig.geometry.arrays import Transform
from camrig.geometry.rotation import yaw_of
from camrig.locate import Drift, Located, with_correction
from camrig.messages import (
    Aim,
    AxisReading,
    CameraPose,
    DroneAim,
    DroneReading,
    Event,
    FlightState,
    HeadAim,
    Level,
    LinkReport,
    LinkStatus,
    RigPose,
    Target,
)
from camrig.pipeline.mission import Knowledge
from camrig.pipeline.state import Inputs, State
from camrig.rig import CameraSpec, DroneMount, FreeMount, HeadMount, Rig

OFFSET_TOLD_S = 0.015
"""Stamps of a camera and of its head further apart are worth a word."""
REPEAT_S = 30.0
"""A lasting cause is told again after so long."""


def take_readings(state: State, inputs: Inputs, rig: Rig) -> tuple[State, tuple[Event, ...]]:
    """Return the state with what heads and drones reported, and an event for every link that changed."""
    histories = state.histories
    readings: tuple[AxisReading | DroneReading, ...] = (*inputs.axis_readings, *inputs.drone_readings)
    for reading in readings:
        histories = histories.with_reading(reading)
    flight = {**state.flight, **{reading.drone_id: reading.flight for reading in inputs.drone_readings}}
    links = dict(state.links)
    events = []
    for report in inputs.links:
        before = links.get(report.device_id)
        links[report.device_id] = report
        if before is None or before.status is not report.status:
            events.append(_link_event(report, state, rig))
    for device, report in links.items():
        if report.status is not LinkStatus.UP and device in flight:
            flight[device] = FlightState.UNKNOWN
    return replace(state, histories=histories, flight=flight, links=links), tuple(events)


def _link_event(report: LinkReport, state: State, rig: Rig) -> Event:
    if report.status is not LinkStatus.LOST:
        return Event(
            report.stamp_s, Level.INFO, report.device_id, f"link {report.status.value} {report.reason}".strip()
        )
    camera = rig.cameras.get(report.device_id) or rig.camera_on(report.device_id)
    promised = state.mission.plan.targets if state.mission.plan else {}
    alone = sorted(name for name, quality in promised.items() if camera and quality.seen_by == (camera.id,))
    cost = f"; {', '.join(alone)} were seen by it alone" if alone else ""
    return Event(report.stamp_s, Level.WARNING, report.device_id, f"link lost: {report.reason}{cost}")


def knowledge(state: State, targets: tuple[Target, ...], inputs: Inputs, rig: Rig, now_s: float) -> Knowledge:
    """Return what the mission and the steering decide by."""
    pose = rig_pose(state, now_s, inputs.begin)
    aims: dict[str, Aim] = {}
    movable, usable = set(), set()
    for camera in rig.cameras.values():
        if (aim := _aim(camera, pose)) is not None:
            aims[camera.id] = aim
        if not _up(state, camera.id) or isinstance(camera.mount, FreeMount):
            continue
        carrier = _carrier(camera)
        if carrier is None or (camera.id in aims and _up(state, carrier)):
            usable.add(camera.id)
        if camera.id in usable and carrier is not None and _may_move(state, inputs, carrier, rig):
            movable.add(camera.id)
    complete = all(_carrier(camera) is None or camera.id in movable for camera in rig.cameras.values())
    return Knowledge(targets, aims, pose, frozenset(movable), frozenset(usable), complete)


def rig_pose(state: State, now_s: float, begin: frozenset[str] = frozenset()) -> RigPose:
    """Return where heads and drones are now, as far as recent readings tell, and where else a drone is in the air.

    Drones in ``begin`` count as in the air: from the order to lift-off another could fly over the place.
    """
    heads: dict[str, HeadAim] = {}
    for name, head in state.histories.heads.items():
        found = head.at(now_s)
        if found is not None:
            heads[name] = HeadAim(*(float(angle) for angle in found.angles_rad))
    drones: dict[str, DroneAim] = {}
    aloft: dict[str, DroneAim] = {}
    for name, drone in state.histories.drones.items():
        placed = drone.at(now_s)
        if placed is not None and state.flight.get(name) is FlightState.FLYING:
            drones[name] = _drone_aim(placed[0])
        elif drone.readings and (name in begin or drone.readings[-1].flight is not FlightState.GROUND):
            aloft[name] = _drone_aim(drone.readings[-1].T_world_body)
    return RigPose(heads, drones, aloft)


def _drone_aim(T_world_body: Transform) -> DroneAim:
    x, y, z = (float(value) for value in T_world_body[:3, 3])
    return DroneAim((x, y, z), yaw_of(T_world_body[:3, :3]))


def held_events(held: Mapping[str, str], now_s: float) -> tuple[Event, ...]:
    """Tell which devices the steering holds back, and why."""
    return tuple(Event(now_s, Level.WARNING, name, f"held back: {reason}") for name, reason in held.items())


def with_corrections(
    drifts: Mapping[str, Drift], found: Iterable[Located], poses: Mapping[str, CameraPose], rig: Rig
) -> dict[str, Drift]:
    """Return how far cameras are from where calibration and readings put them, after some frames and the ``poses`` that
    everything together gave their cameras. Drones are left out: their own estimate wanders as it will.
    """
    after = dict(drifts)
    for each in found:
        carried = each.carried
        pose = poses.get(carried.camera_id) if carried is not None else None
        if carried is None or pose is None or isinstance(rig.cameras[pose.camera_id].mount, DroneMount):
            continue
        if pose.stamp_s != carried.stamp_s:
            continue
        if (drift := with_correction(after.get(pose.camera_id), carried, pose)) is not None:
            after[pose.camera_id] = drift
    return after


def camera_events(state: State, now_s: float) -> tuple[Event, ...]:
    """Tell which cameras have left where their calibration puts them, and whose stamps are far from their head's."""
    told = []
    for name, drift in state.drifts.items():
        if drift.alarming:
            text = "is not where its calibration and readings put it (`camrig status`): see to its mount, calibrate it"
            told.append(Event(now_s, Level.WARNING, name, text))
    for name, offset in state.histories.offsets.items():
        if abs(offset.offset_s) > OFFSET_TOLD_S and abs(offset.offset_s) > 5.0 * offset.sigma_s:
            late = "late" if offset.offset_s > 0.0 else "early"
            text = f"its head reports {late} by its pictures (`camrig status`): reckoned with"
            told.append(Event(now_s, Level.INFO, name, text))
    return tuple(told)


def without_repeats(state: State, events: Iterable[Event]) -> tuple[State, tuple[Event, ...]]:
    """Drop events that were told a short while ago in the same words."""
    said_s = dict(state.said_s)
    fresh = []
    for event in events:
        key = (event.about, event.text)
        if event.stamp_s >= said_s.get(key, -math.inf) + REPEAT_S:
            said_s[key] = event.stamp_s
            fresh.append(event)
    newest_s = max(said_s.values(), default=0.0)
    kept: Mapping[tuple[str, str], float] = {key: at_s for key, at_s in said_s.items() if at_s > newest_s - REPEAT_S}
    return replace(state, said_s=kept), tuple(fresh)


def _carrier(camera: CameraSpec) -> str | None:
    match camera.mount:
        case HeadMount(head=name) | DroneMount(drone=name):
            return name
    return None


def _aim(camera: CameraSpec, pose: RigPose) -> Aim | None:
    match camera.mount:
        case HeadMount(head=name):
            return pose.heads.get(name)
        case DroneMount(drone=name):
            return pose.drones.get(name)
    return None


def _up(state: State, device: str) -> bool:
    report = state.links.get(device)
    return report is not None and report.status is LinkStatus.UP


def _may_move(state: State, inputs: Inputs, carrier: str, rig: Rig) -> bool:
    return carrier in inputs.enabled and (carrier in rig.heads or state.flight.get(carrier) is FlightState.FLYING)
