"""The life of one track: born, confirmed, doubted, restarted; and sightings that arrive out of order.

A track's state is a fold over its sightings in the order of their stamps. The last ``late_s`` seconds of sightings are
kept, each with the state after it: one that arrives late is put in its place and what follows is folded again. So the
result does not depend on the order of arrival, bit for bit.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np

from camrig.fuse.kalman import Belief, begin, distance, predict, update
from camrig.fuse.settings import MotionModel, Settings
from camrig.geometry.arrays import Array
from camrig.messages import Sighting


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A track after some sightings; ``rival`` is what a run of sightings outside the gate believes."""

    belief: Belief | None = None
    confirmed: bool = False
    rival: Belief | None = None
    rival_hits: int = 0
    restarts: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """How a target moves, and what is known of it: the state before the kept sightings, these in the order of
    (stamp, camera), and the state after each.
    """

    model: MotionModel
    base: State = State()
    sightings: tuple[Sighting, ...] = ()
    states: tuple[State, ...] = ()

    @property
    def state(self) -> State:
        """The state after all sightings."""
        return self.states[-1] if self.states else self.base


def add(track: Track, sighting: Sighting, settings: Settings) -> Track | None:
    """Return the track with one more sighting, whenever it arrives; None where it comes too late to count.

    The same camera and stamp again change nothing.
    """
    if track.sightings and sighting.stamp_s <= track.sightings[-1].stamp_s - settings.late_s:
        return None
    place = bisect_left(track.sightings, _order(sighting), key=_order)
    if place < len(track.sightings) and _order(track.sightings[place]) == _order(sighting):
        return track
    sightings = (*track.sightings[:place], sighting, *track.sightings[place:])
    states = list(track.states[:place])
    for due in sightings[place:]:
        states.append(_fold(states[-1] if states else track.base, due, track.model, settings))
    return _trimmed(replace(track, sightings=sightings, states=tuple(states)), settings)


def _trimmed(track: Track, settings: Settings) -> Track:
    """Let go of the sightings that nothing can come before any more."""
    oldest_s = track.sightings[-1].stamp_s - settings.late_s
    gone = sum(sighting.stamp_s <= oldest_s for sighting in track.sightings)
    base = track.states[gone - 1] if gone else track.base
    return Track(track.model, base, track.sightings[gone:], track.states[gone:])


def _order(sighting: Sighting) -> tuple[float, str]:
    return sighting.stamp_s, sighting.camera_id


def _fold(state: State, sighting: Sighting, model: MotionModel, settings: Settings) -> State:
    """Return the state after a sighting: in the gate it updates; outside it starts a rival, or a lost track anew."""
    belief = state.belief
    if belief is None:
        return _born(state, sighting, model, settings)
    unseen_s = sighting.stamp_s - belief.stamp_s
    if unseen_s > settings.lost_after_s and not state.confirmed:
        return _born(state, sighting, model, settings)
    predicted = predict(belief, sighting.stamp_s, model)
    if distance(predicted, sighting) <= settings.gate_chi2:
        updated = update(predicted, sighting, _weight(sighting, settings), settings.repeating)
        return replace(state, belief=updated, confirmed=True, rival=None, rival_hits=0)
    if not state.confirmed or unseen_s > settings.lost_after_s:
        return _born(state, sighting, model, settings)
    return _doubted(state, sighting, model, settings)


def _born(state: State, sighting: Sighting, model: MotionModel, settings: Settings) -> State:
    """Start from one sighting, confirmed at once where it is good enough."""
    total = sighting.covariance[:3, :3] + sighting.camera_covariance[:3, :3]
    sure = float(np.linalg.eigvalsh(total)[-1]) <= settings.sure_sigma_m**2
    return State(begin(sighting, model, settings.repeating), confirmed=sure, restarts=state.restarts)


def _doubted(state: State, sighting: Sighting, model: MotionModel, settings: Settings) -> State:
    """Let sightings outside the gate build a rival; enough of them in a row replace the track."""
    predicted = predict(state.rival, sighting.stamp_s, model) if state.rival else None
    if predicted is None or distance(predicted, sighting) > settings.gate_chi2:
        return replace(state, rival=begin(sighting, model, settings.repeating), rival_hits=1)
    rival = update(predicted, sighting, _weight(sighting, settings), settings.repeating)
    if state.rival_hits + 1 < settings.restart_after:
        return replace(state, rival=rival, rival_hits=state.rival_hits + 1)
    return State(rival, confirmed=True, restarts=state.restarts + 1)


def _weight(sighting: Sighting, settings: Settings) -> Array:
    """Return the (3, 3) R by which a sighting is weighed."""
    if settings.weighting == "quality":
        return sighting.quality_m**2 * np.eye(3)
    return np.asarray(sighting.covariance[:3, :3] + sighting.camera_covariance[:3, :3])
