"""All tracks together: sightings in, targets and predicted poses out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from camrig.fuse.kalman import predict
from camrig.fuse.settings import DEFAULTS, MotionModel, Settings
from camrig.fuse.track import Track, add
from camrig.geometry.arrays import Transform
from camrig.geometry.pose import transform
from camrig.messages import Event, Fix, Level, Motion, Target, TargetStatus
from camrig.rig import Rig

_WITHOUT_END = (
    "swerves without end: its cameras do not agree on where it is (calibration, stamps, a tag's place), or it drives "
    "narrower curves than its motion allows"
)


@dataclass(frozen=True, slots=True)
class Tracks:
    """One track for every target seen so far, by target id."""

    by_id: Mapping[str, Track] = field(default_factory=lambda: MappingProxyType({}))


def update(
    tracks: Tracks, fixes: Iterable[Fix], rig: Rig, settings: Settings = DEFAULTS
) -> tuple[Tracks, tuple[Event, ...]]:
    """Return the tracks after more fixes, in whatever order they come, and what an operator should know."""
    by_id, notes = dict(tracks.by_id), []
    for fix in fixes:
        name = fix.target_id
        before = by_id.get(name) or Track(settings.models[rig.targets[name].motion])
        after = add(before, fix, settings)
        if after is None:
            text = f"a sighting by {fix.seen[0].camera_id} came more than {settings.late_s:g} s late: not used"
            notes.append(Event(fix.stamp_s, Level.WARNING, name, text))
            continue
        by_id[name] = after
        if after.state.restarts > before.state.restarts:
            notes.append(Event(fix.stamp_s, Level.INFO, name, "was moved by more than it can move: track restarted"))
        if after.state.restless and not before.state.restless:
            notes.append(Event(fix.stamp_s, Level.WARNING, name, _WITHOUT_END))
    return Tracks(by_id), tuple(notes)


def targets_at(tracks: Tracks, rig: Rig, now_s: float, settings: Settings = DEFAULTS) -> tuple[Target, ...]:
    """Return every target of the rig, predicted to ``now_s`` (to its last sighting where that is later).

    UNSEEN, never or not yet confirmed: position, velocity and orientation NaN, infinite variances, last seen -inf.
    LOST: unseen for ``lost_after_s``; the prediction goes on for whoever searches, its covariance growing.
    """
    return tuple(_target(name, tracks.by_id.get(name), now_s, settings) for name in rig.targets)


def predicted_poses(tracks: Tracks, stamp_s: float) -> dict[str, Transform]:
    """Return the predicted ``T_world_body`` of every confirmed target at ``stamp_s``, by id: priors for ``locate``."""
    poses = {}
    for name, track in tracks.by_id.items():
        belief = track.state.belief
        if belief is not None and track.state.confirmed:
            then = predict(belief, stamp_s, track.model)
            poses[name] = transform(then.R_world_body, then.mean[:3])
    return poses


def motions(tracks: Tracks, rig: Rig, stamp_s: float, settings: Settings = DEFAULTS) -> dict[str, Motion]:
    """Return how every target of the rig moves about ``stamp_s``, by id; where it is only of confirmed tracks."""
    return {
        name: _motion(tracks.by_id.get(name), settings.models[body.motion], body.on_floor, stamp_s)
        for name, body in rig.targets.items()
    }


def _motion(track: Track | None, model: MotionModel, on_floor: bool, stamp_s: float) -> Motion:
    belief = track.state.belief if track and track.state.confirmed else None
    turning = model.turn_rad2_s * (np.array([0.0, 0.0, 1.0]) if on_floor else np.ones(3))
    swerve = model.swerve_density_m2_s3
    if belief is None:
        density, rate_variance = model.density_m2_s3 + swerve, model.turn_sigma_rad_s**2
        return Motion(stamp_s, None, np.zeros(3), model.velocity_covariance, density, turning, 0.0, rate_variance)
    now = predict(belief, stamp_s, model)
    return Motion(
        stamp_s=stamp_s,
        T_world_body=transform(now.R_world_body, now.mean[:3]),
        velocity_m_s=now.mean[3:],
        velocity_covariance=now.published[3:, 3:],
        acceleration_m2_s3=model.density_m2_s3 + now.modes.swerving * swerve,
        turn_rad2_s=turning,
        turn_rate_rad_s=now.turn_rate_rad_s,
        turn_rate_rad2_s2=float(now.turning[1, 1]),
    )


def _target(name: str, track: Track | None, now_s: float, settings: Settings) -> Target:
    belief = track.state.belief if track and track.state.confirmed else None
    if track is None or belief is None:
        return _unseen(name, now_s)
    now = predict(belief, now_s, track.model)
    seeing = [each for each in now.seen if now_s - each.stamp_s <= settings.seen_within_s]
    tracked = now_s - belief.stamp_s <= settings.lost_after_s
    return Target(
        id=name,
        stamp_s=now.stamp_s,
        status=TargetStatus.TRACKED if tracked else TargetStatus.LOST,
        position_m=now.mean[:3],
        velocity_m_s=now.mean[3:],
        covariance_m2=now.published[:3, :3],
        R_world_body=now.R_world_body,
        seen_by=tuple(sorted(each.camera_id for each in seeing)),
        last_seen_s=belief.stamp_s,
        quality_m=1.0 / sum(1.0 / each.quality_m for each in seeing) if seeing else None,
        innovation=track.state.innovation,
    )


def _unseen(name: str, now_s: float) -> Target:
    nowhere = np.full(3, np.nan)
    return Target(
        id=name,
        stamp_s=now_s,
        status=TargetStatus.UNSEEN,
        position_m=nowhere,
        velocity_m_s=nowhere,
        covariance_m2=np.diag(np.full(3, np.inf)),
        R_world_body=np.full((3, 3), np.nan),
        seen_by=(),
        last_seen_s=-math.inf,
    )
