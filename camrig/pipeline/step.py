"""One tick of camrig: measurements in, targets, a plan request and commands out. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from camrig import fuse, locate
from camrig.interfaces import Published
from camrig.messages import AxisReading, CameraPose, Event, Fix, Sighting
from camrig.pipeline import mission, watch
from camrig.pipeline.expect import expected
from camrig.pipeline.state import Inputs, Outputs, Settings, State
from camrig.rig import Rig
from camrig.steer import steer

Stamped = TypeVar("Stamped", CameraPose, locate.View)

POSE_WAIT_S = 0.25
"""How long a frame waits for the readings after its stamp; then the pose is extrapolated, its covariance grown."""


def step(state: State, inputs: Inputs, rig: Rig, settings: Settings, now_s: float) -> tuple[State, Outputs]:
    """Take in what arrived, and return the state after it and everything that is to be done."""
    state, link_events = watch.take_readings(state, inputs, rig)
    state, seen = _see(state, inputs, rig, settings, now_s)
    tracks, fuse_notes = fuse.update(state.tracks, seen.fixes, rig, settings.fuse)
    targets = fuse.targets_at(tracks, rig, now_s, settings.fuse)
    known = watch.knowledge(state, targets, inputs, rig, now_s)
    plan, request, events = mission.advance(state.mission, rig, known, inputs.answer, settings.mission, now_s)
    steered, commands = steer(state.steer, plan.goal, known.pose, known.movable, rig, settings.steer, now_s)
    # What lasts is told once in a while; what happens is told each time, or the last word on a link would be wrong.
    lasting = (*seen.notes, *fuse_notes, *watch.held_events(steered.held, now_s), *watch.camera_events(state, now_s))
    state, fresh = watch.without_repeats(replace(state, tracks=tracks, mission=plan, steer=steered), lasting)
    said = (*inputs.events, *link_events, *fresh, *events)
    published = Published(
        now_s,
        mission.with_promises(targets, plan.plan),
        said,
        inputs.links,
        plan.plan,
        seen.sightings,
        seen.camera_poses,
    )
    news = seen.camera_poses or commands
    regions = expected(state, targets, rig, now_s) if news else None
    return state, Outputs(published, request, commands, regions, seen.head_angles)


@dataclass(frozen=True, slots=True)
class Seen:
    """What the frames of one tick tell."""

    sightings: tuple[Sighting, ...]
    fixes: tuple[Fix, ...]
    camera_poses: tuple[CameraPose, ...]
    head_angles: tuple[AxisReading, ...]
    notes: tuple[Event, ...]


def _see(state: State, inputs: Inputs, rig: Rig, settings: Settings, now_s: float) -> tuple[State, Seen]:
    """Place the targets of every frame whose camera's pose at its stamp is known; keep the others for later."""
    frames = (*state.pending, *inputs.detections)
    ready = [
        frame
        for frame in frames
        if state.histories.covers(rig.cameras[frame.camera_id], frame.stamp_s) or now_s > frame.stamp_s + POSE_WAIT_S
    ]
    found = [
        locate.locate(frame, state.histories, rig, fuse.predicted_poses(state.tracks, frame.stamp_s))
        for frame in sorted(ready, key=lambda frame: frame.stamp_s)
    ]
    views = {each.view.camera_id: each.view for each in found if each.view is not None}
    if settings.fuse.estimator == "joint":
        newest_s = max((view.stamp_s for view in views.values()), default=now_s)
        motions = fuse.motions(state.tracks, rig, newest_s, settings.fuse)
        together = locate.joint(tuple(views.values()), tuple(state.views.values()), motions, rig, state.lenses)
    else:
        together = locate.apart(tuple(each.view for each in found if each.view is not None))
    poses = {pose.camera_id: pose for pose in together.camera_poses}
    histories = state.histories
    for each in found:
        if each.view is not None and each.view.carried is not None:
            histories = locate.with_offset(histories, rig.cameras[each.view.camera_id], each.head_angles)
    state = replace(
        state,
        histories=histories,
        pending=tuple(frame for frame in frames if frame not in ready),
        views={**state.views, **_newer(views, state.views)},
        camera_poses={**state.camera_poses, **_newer(poses, state.camera_poses)},
        drifts=watch.with_corrections(state.drifts, found, poses, rig),
        lenses=together.lenses or state.lenses,
    )
    seen = Seen(
        sightings=tuple(sighting for each in found for sighting in each.sightings),
        fixes=together.fixes,
        camera_poses=together.camera_poses,
        head_angles=tuple(reading for each in found for reading in each.head_angles),
        notes=(*(note for each in found for note in each.notes), *together.notes),
    )
    return state, seen


def _newer(items: Mapping[str, Stamped], than: Mapping[str, Stamped]) -> dict[str, Stamped]:
    """Return what is of a later stamp than its camera's last one: frames may overtake each other."""
    return {name: item for name, item in items.items() if name not in than or item.stamp_s > than[name].stamp_s}


def rescan(state: State, now_s: float) -> State:
    """Operator's order: scan the whole floor again."""
    return replace(state, mission=mission.rescan(state.mission, now_s))
