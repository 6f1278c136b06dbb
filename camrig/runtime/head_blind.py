"""The motion of a calibration of a head that tells nothing: turns at known steps round one place, seen by its eye."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from camrig.calibrate.head_blind import BlindRun, BlindView, Corners, measured, speed_sigma, timings
from camrig.calibrate.head_result import AXES, HeadResult
from camrig.calibrate.head_start import expected_axes, tilt_of
from camrig.clock import Clock
from camrig.errors import HardwareError, PartialError
from camrig.geometry.arrays import Array
from camrig.interfaces import Head, TurnsByStep
from camrig.messages import TagDetections
from camrig.runtime.enabled_head import enabled
from camrig.runtime.head_bench import Eye, Interrupted, corners_of
from camrig.runtime.head_survey import Place, Tell

_SHARES = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
_FIRST_SHARES = (0.0, 0.03, 0.06, 0.12, 0.2, 0.35)
_TURNS_EACH = 4
_FIRST_S, _LONGEST_S, _SHORTEST_S = 0.5, 1.5, 0.35
MOST_RAD = math.radians(14.0)
"""How far to either side of where it stands it is turned at most."""
_VIEW_SHARE = 0.22
_SEEN_RAD = math.radians(0.5)
_STILL_PX = 0.5
_CALM_S, _DARK_S = 0.5, 8.0
_STEEPEST = 4


@dataclass
class BlindBench:
    """One head that tells nothing, and its camera. Used by one thread."""

    name: str
    head: Head
    eye: Eye
    clock: Clock
    tags: Container[str]
    asked_to_end: Callable[[], bool] = lambda: False
    frames: list[TagDetections] = field(default_factory=list)
    runs: list[BlindRun] = field(default_factory=list)
    moving_s: float = 0.0

    def serve(self, duration_s: float) -> None:
        """Poll for a while. Raises Interrupted."""
        until_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < until_s:
            if self.asked_to_end():
                raise Interrupted
            self.head.read(0.05)  # what an open-loop driver reckons tells nothing here; it needs its turn
            self.frames += self.eye.take()

    def run(self, steps: tuple[int, int], lasts_s: float) -> BlindRun:
        """Turn both axes for so long, and wait until they have surely come to rest."""
        assert isinstance(self.head, TurnsByStep)
        told_s = self.head.turn(*steps)
        self.serve(lasts_s)
        ended_s = self.head.turn(0, 0)
        self.moving_s += ended_s - told_s
        self.runs.append(BlindRun(steps, told_s, ended_s))
        self.serve(_CALM_S)
        return self.runs[-1]

    def look(self) -> Corners:
        """Wait for two pictures in a row that show the same. Raises PartialError where there is no tag."""
        until_s, from_s = self.clock.now_s() + _DARK_S, self.clock.now_s() - 0.2
        while self.clock.now_s() < until_s:
            self.serve(0.1)
            last = [corners_of(frame, self.tags) for frame in self.frames[-12:] if frame.stamp_s > from_s][-2:]
            if len(last) == 2 and _same(*last):
                return last[-1]
        raise PartialError(
            f"head {self.name}: its camera sees no tag at rest: aim it at fixed tags of known size, or give it"
        )


def run_blind_calibration(bench: BlindBench, place: Place, tell: Tell) -> HeadResult:
    """Open and enable the head, turn it, stop and close it, and return its time model.

    Raises PartialError where the picture does not follow what it is told, HardwareError where it cannot be turned.
    """
    if not isinstance(bench.head, TurnsByStep):
        raise HardwareError(f"head {bench.name} tells no angles and offers no steps of speed: nothing can be measured")
    offered = bench.head.steps()
    with enabled(bench.name, bench.head):
        tell("first turns", 0.0)
        view = _first_turns(bench, place, offered)
        first = len(bench.runs)
        for number, share in enumerate(_SHARES):
            tell("speeds", 0.1 + 0.85 * number / len(_SHARES))
            _turns(bench, place, view, _steps(offered, share))
    tell("computing", 0.95)
    frames = [(frame.stamp_s, corners_of(frame, bench.tags)) for frame in bench.frames]
    calibration, stamps_s, angles_rad = measured(view, place.file, place.sizes_m, frames)
    pan, tilt = timings(bench.runs[first:], stamps_s, angles_rad)
    sigma = speed_sigma((pan, tilt))
    return HeadResult(calibration, (pan, tilt), None, "open loop", bench.moving_s, (), sigma)


def _first_turns(bench: BlindBench, place: Place, offered: Mapping[str, Sequence[int]]) -> BlindView:
    """Turn pan until its axis is seen in the picture, which tells the tilt; then back. Tilt turns a little likewise."""
    first = bench.look()
    mount = place.file.T_mount_camera
    view = BlindView(place.lens, mount, first, 0.5 * sum(place.limits_rad[1]))
    turned = _until_seen(bench, view, offered, axis=0)
    up, _ = expected_axes(mount, view.tilt_rad)
    axis = turned / np.linalg.norm(turned)
    view = BlindView(place.lens, mount, first, tilt_of(mount, axis * math.copysign(1.0, float(axis @ up))))
    _until_seen(bench, view, offered, axis=1)
    return view


def _until_seen(bench: BlindBench, view: BlindView, offered: Mapping[str, Sequence[int]], axis: int) -> Array:
    """Turn one axis a little, the slowest step first, until the picture turns; return the rotation vector (3,).

    How fast a step is nobody knows yet. Each is about twice the one before, which did not turn the picture, goes the
    other way first, and comes back. They are too short, and play swallows too much of them, to tell speeds.
    """
    for number, share in enumerate(_FIRST_SHARES):
        step = _steps(offered, share)[axis] * (-1 if number % 2 else 1)
        bench.run((step, 0) if axis == 0 else (0, step), _FIRST_S)
        turned = view.turn_rad(bench.look())
        bench.run((-step, 0) if axis == 0 else (0, -step), _FIRST_S)
        if turned is not None and np.linalg.norm(turned) > _SEEN_RAD:
            return turned
    raise PartialError(
        f"head {bench.name}: its picture does not turn when its {AXES[axis]} is told to: is that camera on this head, "
        "is its address right, or does it stand at a stop?"
    )


def _turns(bench: BlindBench, place: Place, view: BlindView, steps: tuple[int, int]) -> None:
    """Turn both axes to and fro at one step, as far as tags surely stay in view."""
    bounds = _bounds(place, view)
    for _ in range(_TURNS_EACH):
        here = view.angles_rad(bench.look())
        if here is None:
            raise PartialError(f"head {bench.name} has lost the tags it began with; hang more of them, closer together")
        rates = _expected(bench, view, steps)
        ways = [
            high - at if at < 0.5 * (low + high) else low - at for at, (low, high) in zip(here, bounds, strict=True)
        ]
        lasts_s = min(_LONGEST_S, *(abs(way / rate) for way, rate in zip(ways, rates, strict=True)))
        signs = [1 if way * rate > 0.0 else -1 for way, rate in zip(ways, rates, strict=True)]
        if lasts_s >= _SHORTEST_S:
            bench.run((signs[0] * steps[0], signs[1] * steps[1]), lasts_s)


def _bounds(place: Place, view: BlindView) -> list[tuple[float, float]]:
    """Return between which pans and tilts it may be turned: round where it began, within tilt's limits."""
    pan, tilt = (
        min(MOST_RAD, 2.0 * _VIEW_SHARE * math.atan(0.5 * size / focal))
        for size, focal in zip(place.lens.size_px, place.lens.focal_px, strict=True)
    )
    low, high = place.limits_rad[1]
    return [(-pan, pan), (max(view.tilt_rad - tilt, low), min(view.tilt_rad + tilt, high))]


def _expected(bench: BlindBench, view: BlindView, steps: tuple[int, int]) -> list[float]:
    """Return how fast each axis may turn at most at positive steps, signed, from the turns so far."""
    rates = []
    for axis in range(2):
        known: dict[int, list[float]] = {}
        for run in bench.runs:
            if run.steps[axis] and (turned := _turned(bench, view, run, axis)) is not None:
                known.setdefault(abs(run.steps[axis]), []).append(math.copysign(turned, turned * run.steps[axis]))
        slower = {step: float(np.mean(turned)) for step, turned in known.items()}
        nearest = max((step for step in slower if step <= steps[axis]), default=min(slower))
        grown = max(1.0, steps[axis] / nearest) ** (_STEEPEST if nearest < steps[axis] else 1)
        rate = slower[nearest]
        rates.append(math.copysign(max(abs(rate), math.radians(0.3)) * min(grown, 3.0), rate))
    return rates


def _turned(bench: BlindBench, view: BlindView, run: BlindRun, axis: int) -> float | None:
    """Return how fast an axis went on average in a turn, by the pictures before and after."""
    before = [frame for frame in bench.frames if frame.stamp_s <= run.told_s]
    after = [frame for frame in bench.frames if frame.stamp_s > run.ended_s + 0.3]
    ends = [view.angles_rad(corners_of(frame, bench.tags)) for frame in (*before[-1:], *after[:1])]
    if len(ends) < 2 or ends[0] is None or ends[1] is None:
        return None
    return float(ends[1][axis] - ends[0][axis]) / max(run.ended_s - run.told_s - 0.05, 0.1)


def _steps(offered: Mapping[str, Sequence[int]], share: float) -> tuple[int, int]:
    pan, tilt = (offered[axis][max(0, round(share * len(offered[axis])) - 1)] for axis in AXES)
    return pan, tilt


def _same(before: Corners, after: Corners) -> bool:
    shared = before.keys() & after.keys()
    return bool(shared) and max(float(np.abs(before[name] - after[name]).max()) for name in shared) < _STILL_PX
