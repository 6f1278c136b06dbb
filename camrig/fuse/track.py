"""The life of one track: born, confirmed, doubted, restarted; and fixes that arrive out of order.

A track's state is a fold over its fixes in the order of their stamps. The last ``late_s`` seconds of fixes are
kept, each with the state after it: one that arrives late is put in its place and what follows is folded again. So the
result does not depend on the order of arrival, bit for bit.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace

import numpy as np

from camrig.fuse.kalman import Belief, begin, distances, predict, update
from camrig.fuse.settings import MotionModel, Settings
from camrig.geometry.arrays import Array
from camrig.messages import Fix

_INNOVATIONS = 30
"""So many fixes the mean of their innovations remembers."""

_SWERVES = 100
_RESTLESS, _RESTED = 0.5, 0.25
"""What swerves for most of so many fixes does more than swerve, until it does so for a quarter of them."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A track after some fixes; ``rival`` is what a run of fixes outside the gate believes."""

    belief: Belief | None = None
    confirmed: bool = False
    rival: Belief | None = None
    rival_hits: int = 0
    restarts: int = 0
    innovation: float | None = None
    """The mean squared Mahalanobis distance of the last fixes from their prediction, by degree of freedom."""
    swerving: float = 0.0
    """How probably it swerved, on the average over the last fixes."""
    restless: bool = False
    """Whether it swerves without end."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """How a target moves, and what is known of it: the state before the kept fixes, these in the order of
    (stamp, cameras), and the state after each.
    """

    model: MotionModel
    base: State = State()
    fixes: tuple[Fix, ...] = ()
    states: tuple[State, ...] = ()

    @property
    def state(self) -> State:
        """The state after all fixes."""
        return self.states[-1] if self.states else self.base


def add(track: Track, fix: Fix, settings: Settings) -> Track | None:
    """Return the track with one more fix, whenever it arrives; None where it comes too late to count.

    The same cameras and stamp again change nothing.
    """
    if track.fixes and fix.stamp_s <= track.fixes[-1].stamp_s - settings.late_s:
        return None
    place = bisect_left(track.fixes, fix.order, key=lambda each: each.order)
    if place < len(track.fixes) and track.fixes[place].order == fix.order:
        return track
    fixes = (*track.fixes[:place], fix, *track.fixes[place:])
    states = list(track.states[:place])
    for due in fixes[place:]:
        states.append(_fold(states[-1] if states else track.base, due, track.model, settings))
    # What nothing can come before any more is let go of.
    gone = bisect_right(fixes, fixes[-1].stamp_s - settings.late_s, key=lambda each: each.stamp_s)
    return Track(track.model, states[gone - 1] if gone else track.base, fixes[gone:], tuple(states[gone:]))


def _fold(state: State, fix: Fix, model: MotionModel, settings: Settings) -> State:
    """Return the state after a fix: in the gate it updates; outside it starts a rival, or a lost track anew."""
    belief = state.belief
    if belief is None:
        return _born(state, fix, model, settings)
    unseen_s = fix.stamp_s - belief.stamp_s
    if unseen_s > settings.lost_after_s and not state.confirmed:
        return _born(state, fix, model, settings)
    predicted = predict(belief, fix.stamp_s, model)
    surprise, by_mode = distances(predicted, fix)
    innovation = _mean_innovation(state, surprise / 3.0)
    if min(by_mode) <= settings.gate_chi2:
        suspect = by_mode[0] > settings.gate_chi2
        updated = update(predicted, fix, _weight(fix, settings), settings.repeating, suspect=suspect)
        swerving = state.swerving + (updated.modes.swerving - state.swerving) / _SWERVES
        return State(
            updated,
            confirmed=True,
            restarts=state.restarts,
            innovation=innovation,
            swerving=swerving,
            restless=swerving > (_RESTED if state.restless else _RESTLESS),
        )
    state = replace(state, innovation=innovation)
    if not state.confirmed or unseen_s > settings.lost_after_s:
        return _born(state, fix, model, settings)
    return _doubted(state, fix, model, settings)


def _mean_innovation(state: State, newest: float) -> float:
    """Return the mean with one more."""
    before = newest if state.innovation is None else state.innovation
    return before + (newest - before) / _INNOVATIONS


def _born(state: State, fix: Fix, model: MotionModel, settings: Settings) -> State:
    """Start from one fix, confirmed at once where it is good enough."""
    sure = float(np.linalg.eigvalsh(fix.whole[:3, :3])[-1]) <= settings.sure_sigma_m**2
    return State(begin(fix, model, _weight(fix, settings), settings.repeating), confirmed=sure, restarts=state.restarts)


def _doubted(state: State, fix: Fix, model: MotionModel, settings: Settings) -> State:
    """Let fixes outside the gate build a rival; enough of them in a row replace the track."""
    predicted = predict(state.rival, fix.stamp_s, model) if state.rival else None
    if predicted is None or min(distances(predicted, fix)[1]) > settings.gate_chi2:
        return replace(state, rival=begin(fix, model, _weight(fix, settings), settings.repeating), rival_hits=1)
    rival = update(predicted, fix, _weight(fix, settings), settings.repeating)
    if state.rival_hits + 1 < settings.restart_after:
        return replace(state, rival=rival, rival_hits=state.rival_hits + 1)
    return State(rival, confirmed=True, restarts=state.restarts + 1)


def _weight(fix: Fix, settings: Settings) -> Array | None:
    """Return the (3, 3) covariance that a fix is taken to have, None where its own."""
    match settings.estimator:
        case "quality":
            return fix.seen[0].quality_m ** 2 * np.eye(3)
        case "mean":
            return settings.equal_sigma_m**2 * np.eye(3)
    return None
