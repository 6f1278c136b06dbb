"""A head and its camera at work for a calibration: sent somewhere, waited for, looked through; turned at a speed.

Everything is bounded: a head that does not come, does not report or shows no picture ends it with a sentence, and
whoever asked for the end is heard between any two exchanges. Nothing here enables or stops the head.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from camrig.calibrate.head_aims import Stop
from camrig.calibrate.head_model import HeadShot
from camrig.calibrate.head_timing import Run
from camrig.clock import Clock
from camrig.errors import HardwareError, PartialError
from camrig.geometry.arrays import Array
from camrig.interfaces import Head, TurnsByStep
from camrig.messages import AxisReading, TagDetections
from camrig.runtime.head_flank import STILL_RAD, Flank

AXES = ("pan", "tilt")
POLL_S = 0.1
_THERE_RAD = math.radians(0.6)
"""A head that stands further off from where it was sent was stopped by something."""
_EXACT_RAD = math.radians(0.15)
_STAND_S, _CREEP_S = 0.25, 1.2
"""At rest where it was sent, and near that: a servo may still correct itself."""
_BEGIN_S = 1.5
"""A head that has not begun to move so long after it was sent will not."""
_STUCK_S = 6.0
_SILENT_S = 3.0
_PICTURES = 3
_SETTLE_S = 0.15
_DARK_S = 4.0


class Interrupted(Exception):  # noqa: N818 - somebody asked for it
    """The calibration was asked to end."""


class DoesNotGo(PartialError):  # noqa: N818 - what it does
    """It was sent to a position and did not move at all."""


class Eye(Protocol):
    """The head's camera with a detector behind it."""

    def take(self) -> Sequence[TagDetections]:
        """Return what was found in the pictures since the last call, oldest first. Raises HardwareError, and
        InputError for a camera that is no good for it.
        """
        ...


def corners_of(frame: TagDetections, tags: Container[str]) -> dict[str, Array]:
    """Return the corners of those of some tags that are there once."""
    names = [str(tag.key) for tag in frame.tags]
    return {
        str(tag.key): tag.corners_px for tag in frame.tags if str(tag.key) in tags and names.count(str(tag.key)) == 1
    }


@dataclass
class HeadBench:
    """One head; ``tags`` are the names of those that count. Used by one thread."""

    name: str
    head: Head
    eye: Eye
    clock: Clock
    tags: Container[str]
    asked_to_end: Callable[[], bool] = lambda: False
    frames: list[TagDetections] = field(default_factory=list)
    readings: dict[str, list[AxisReading]] = field(default_factory=lambda: {axis: [] for axis in AXES})
    reports_optics: bool = False
    """Whether its driver reckons with its play already; else a report is its motor's."""
    narrower: str = "in the file (or --{axis}-deg)"
    """Where a person gives it narrower limits."""
    moving_s: float = 0.0
    """For how long it has moved in all."""
    has_gone: bool = False
    """Whether it has gone to a position that was not where it stood."""
    settles_s: list[float] = field(default_factory=list)
    """How long after it first reported that it stood pictures stood too."""
    _flanks: tuple[Flank, Flank] = field(default_factory=lambda: (Flank(), Flank()))
    _heard_s: float = -math.inf

    def serve(self, duration_s: float) -> None:
        """Poll head and camera for a while, at least once. Raises Interrupted, and HardwareError on silence."""
        until_s = self.clock.now_s() + duration_s
        if self._heard_s == -math.inf:
            self._heard_s = self.clock.now_s()
        while True:
            if self.asked_to_end():
                raise Interrupted
            for reading in self.head.read(POLL_S):
                self._heard_s = self.clock.now_s()
                axis = AXES.index(reading.axis)
                self.readings[reading.axis].append(reading)
                self._flanks[axis].follow(reading.angle_rad)
            self.frames += self.eye.take()
            if self.clock.now_s() > self._heard_s + _SILENT_S:
                raise HardwareError(f"head {self.name} has not told its angles for {_SILENT_S:g} s; it is stopped")
            if self.clock.now_s() >= until_s:
                return

    def begin(self) -> None:
        """Serve for half a second, and until both axes were heard twice. Raises HardwareError where one is not."""
        until_s = self.clock.now_s() + _SILENT_S
        self.serve(0.5)
        while missing := [axis for axis in AXES if len(self.readings[axis]) < 2]:
            if self.clock.now_s() > until_s:
                raise HardwareError(
                    f"head {self.name} has not told its {' and its '.join(missing)} for {_SILENT_S:g} s; it is stopped"
                )
            self.serve(0.0)

    @property
    def reported_rad(self) -> Array:
        """Return the last reports of pan and tilt (2,), once it has begun."""
        return np.array([self.readings[axis][-1].angle_rad for axis in AXES])

    def go(self, pan_rad: float, tilt_rad: float) -> float:
        """Send it there and return since when it has stood. Raises PartialError where something keeps it from it."""
        target = np.array([pan_rad, tilt_rad])
        self.head.move_to(pan_rad, tilt_rad)
        sent_s = moved_s = self.clock.now_s()
        begun = last = self.reported_rad
        while True:
            self.serve(0.0)
            now_s, here = self.clock.now_s(), self.reported_rad
            if np.abs(here - last).max() > STILL_RAD:
                last, moved_s = here, now_s
            off_rad = float(np.abs(here - target).max())
            there = off_rad < _THERE_RAD
            patience_s = _STAND_S if off_rad < _EXACT_RAD else _CREEP_S if there else _STUCK_S
            stands = now_s - moved_s > (patience_s if there or moved_s > sent_s else _BEGIN_S)
            if stands and there:
                self.moving_s += moved_s - sent_s
                self.has_gone = self.has_gone or bool(np.abs(here - begun).max() > _THERE_RAD)
                if isinstance(self.head, TurnsByStep):
                    self.head.turn(0, 0)  # nothing corrects it while it is looked through
                return moved_s
            if stands and moved_s == sent_s:
                raise DoesNotGo(self._unmoved(here, target))
            if stands:
                raise PartialError(self._kept(here, target))

    def look(self, stood_s: float, aim_rad: Array | None = None) -> HeadShot | None:
        """Look until enough pictures of the resting head show the same tags; None where they show none."""
        since_s, until_s = stood_s + _SETTLE_S, self.clock.now_s() + _DARK_S
        while True:
            self.serve(0.0)
            seen = [frame for frame in self._since(since_s) if frame.whole]
            if len(seen) >= _PICTURES or (len(seen) >= 2 and not any(self.corners(each) for each in seen)):
                break
            if self.clock.now_s() > until_s:
                if not seen:
                    raise HardwareError(f"the camera of head {self.name} has sent no picture for {_DARK_S:g} s")
                break
        corners = [self.corners(frame) for frame in seen]
        common = set.intersection(*(set(each) for each in corners)) if corners else set()
        self._note_settling(stood_s, corners[-1])
        at_rad = self._stood_at(stood_s)
        dragged = [flank.at(at) for flank, at in zip(self._flanks, at_rad, strict=True)]
        if self.reports_optics:
            dragged = [(at, 0.0) for at in at_rad]
        return HeadShot(
            reported_rad=np.array([reported_rad for reported_rad, _ in dragged]),
            travel=np.array([travel for _, travel in dragged]),
            corners_px={name: np.mean([each[name] for each in corners], axis=0) for name in sorted(common)},
            stamp_s=stood_s,
            pictures=len(corners),
            aim_rad=aim_rad,
        )

    def visit(self, stops: Sequence[Stop]) -> list[HeadShot]:
        """Go from stop to stop; return what was seen where there was something to see."""
        shots = []
        for stop in stops:
            stood_s = self.go(stop.pan_rad, stop.tilt_rad)
            if stop.look:
                shot = self.look(stood_s, np.array([stop.pan_rad, stop.tilt_rad]))
                if shot is not None and shot.corners_px:
                    shots.append(shot)
        return shots

    def run(self, steps: tuple[int, int], lasts_s: float, bounds_rad: Sequence[tuple[float, float]]) -> list[Run]:
        """Turn both axes at signed steps for so long, or until one comes near the end of ``bounds_rad``."""
        assert isinstance(self.head, TurnsByStep)
        self.serve(0.2)
        since_s = self.clock.now_s() - 0.5
        told_s = self.head.turn(*steps)
        while self.clock.now_s() < told_s + lasts_s and not self._nears(bounds_rad):
            self.serve(0.0)
        ended_s = self.head.turn(0, 0)
        self._come_to_rest()
        self.moving_s += self.clock.now_s() - told_s
        return [self._as_run(axis, steps[axis], told_s, ended_s, since_s) for axis in range(2) if steps[axis]]

    def corners(self, frame: TagDetections) -> dict[str, Array]:
        """Return the corners of the tags that count."""
        return corners_of(frame, self.tags)

    def _come_to_rest(self) -> None:
        last, still_s = self.reported_rad, self.clock.now_s()
        until_s = still_s + _STUCK_S
        while self.clock.now_s() - still_s < 0.4:
            self.serve(0.0)
            if np.abs(self.reported_rad - last).max() > 0.5 * STILL_RAD:
                last, still_s = self.reported_rad, self.clock.now_s()
            if self.clock.now_s() > until_s:
                raise HardwareError(f"head {self.name} still moves {_STUCK_S:g} s after it was told to stand")

    def _nears(self, bounds_rad: Sequence[tuple[float, float]]) -> bool:
        """Tell whether an axis will be beyond its bound before one could stop it."""
        for axis, (low_rad, high_rad) in zip(AXES, bounds_rad, strict=True):
            before, last = self.readings[axis][-2:]
            rate = (last.angle_rad - before.angle_rad) / max(last.stamp_s - before.stamp_s, 1e-3)
            ahead_rad = last.angle_rad + rate * (self.clock.now_s() - last.stamp_s + 0.3)
            if (rate > 0.0 and ahead_rad > high_rad) or (rate < 0.0 and ahead_rad < low_rad):
                return True
        return False

    def _as_run(self, axis: int, step: int, told_s: float, ended_s: float, since_s: float) -> Run:
        own = [reading for reading in self.readings[AXES[axis]][-400:] if reading.stamp_s >= since_s]
        return Run(
            axis,
            step,
            told_s,
            ended_s,
            np.array([reading.stamp_s for reading in own]),
            np.array([reading.stamp_sigma_s for reading in own]),
            np.array([reading.angle_rad for reading in own]),
        )

    def _since(self, stamp_s: float) -> list[TagDetections]:
        return [frame for frame in self.frames[-60:] if frame.stamp_s >= stamp_s]

    def _stood_at(self, since_s: float) -> Array:
        return np.array(
            [
                np.mean([each.angle_rad for each in self.readings[axis][-40:] if each.stamp_s >= since_s])
                for axis in AXES
            ]
        )

    def _note_settling(self, stood_s: float, last: Mapping[str, Array]) -> None:
        """Note when pictures had come as near to the last one as pictures of something at rest do."""
        late = [stood_s - 1.0]
        for frame in self._since(stood_s - 1.0):
            seen = self.corners(frame)
            shared = seen.keys() & last.keys()
            if shared and max(float(np.abs(seen[name] - last[name]).max()) for name in shared) > 1.0:
                late.append(frame.stamp_s)
        if len(late) > 1:
            self.settles_s.append(late[-1] - stood_s)

    def _unmoved(self, here: Array, target: Array) -> str:
        axis = int(np.argmax(np.abs(here - target)))
        return (
            f"head {self.name}: its {AXES[axis]} does not move when it is sent from {math.degrees(here[axis]):.1f} to "
            f"{math.degrees(target[axis]):.1f} deg (as it reports): it is at a stop, is jammed, or takes no positions"
        )

    def _kept(self, here: Array, target: Array) -> str:
        off = np.abs(here - target)
        axis = int(np.argmax(off))
        at, to = math.degrees(here[axis]), math.degrees(target[axis])
        return (
            f"head {self.name}: its {AXES[axis]} stands at {at:.1f} deg (as it reports) though it was sent to "
            f"{to:.1f}: a stop, a cable or a limit of its own; it is stopped. Give it narrower limits "
            f"{self.narrower.format(axis=AXES[axis])} and start again"
        )
