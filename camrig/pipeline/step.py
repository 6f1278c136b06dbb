"""One tick of camrig: measurements in, targets, a plan request and commands out. Pure."""

from __future__ import annotations

from dataclasses import replace

from camrig import fuse, locate
from camrig.interfaces import Published
from camrig.messages import CameraPose, Event, Sighting
from camrig.pipeline import mission, watch
from camrig.pipeline.expect import expected
from camrig.pipeline.state import Inputs, Outputs, Settings, State
from camrig.rig import Rig
from camrig.steer import steer

POSE_WAIT_S = 0.25
"""How long a frame waits for the readings after its stamp; then the pose is extrapolated, its covariance grown."""


def step(state: State, inputs: Inputs, rig: Rig, settings: Settings, now_s: float) -> tuple[State, Outputs]:
    """Take in what arrived, and return the state after it and everything that is to be done."""
    state, link_events = watch.take_readings(state, inputs, rig)
    state, sightings, camera_poses, notes = _see(state, inputs, rig, now_s)
    tracks, fuse_notes = fuse.update(state.tracks, sightings, rig, settings.fuse)
    targets = fuse.targets_at(tracks, rig, now_s, settings.fuse)
    known = watch.knowledge(state, targets, inputs, rig, now_s)
    plan, request, events = mission.advance(state.mission, rig, known, inputs.answer, settings.mission, now_s)
    steered, commands = steer(state.steer, plan.goal, known.pose, known.movable, rig, settings.steer, now_s)
    # What lasts is told once in a while; what happens is told each time, or the last word on a link would be wrong.
    lasting = (*notes, *fuse_notes, *watch.held_events(steered.held, now_s))
    state, fresh = watch.without_repeats(replace(state, tracks=tracks, mission=plan, steer=steered), lasting)
    said = (*inputs.events, *link_events, *fresh, *events)
    published = Published(now_s, targets, said, inputs.links, plan.plan, sightings, camera_poses)
    news = camera_poses or commands
    regions = expected(state, targets, known.pose, rig, now_s) if news else None
    return state, Outputs(published, request, commands, regions)


Seen = tuple[State, tuple[Sighting, ...], tuple[CameraPose, ...], tuple[Event, ...]]


def _see(state: State, inputs: Inputs, rig: Rig, now_s: float) -> Seen:
    """Place the targets of every frame whose camera's pose at its stamp is known; keep the others for later."""
    frames = (*state.pending, *inputs.detections)
    ready = [
        frame
        for frame in frames
        if state.histories.covers(rig.cameras[frame.camera_id], frame.stamp_s) or now_s > frame.stamp_s + POSE_WAIT_S
    ]
    sightings: list[Sighting] = []
    notes: list[Event] = []
    poses: dict[str, CameraPose] = {}
    for frame in sorted(ready, key=lambda frame: frame.stamp_s):
        priors = fuse.predicted_poses(state.tracks, frame.stamp_s)
        located = locate.locate(frame, state.histories, rig, priors)
        sightings += located.sightings
        notes += located.notes
        if located.camera_pose is not None:
            poses[frame.camera_id] = located.camera_pose
    pending = tuple(frame for frame in frames if frame not in ready)
    state = replace(state, pending=pending, camera_poses={**state.camera_poses, **poses})
    return state, tuple(sightings), tuple(poses.values()), tuple(notes)


def rescan(state: State, now_s: float) -> State:
    """Operator's order: scan the whole floor again."""
    return replace(state, mission=mission.rescan(state.mission, now_s))
