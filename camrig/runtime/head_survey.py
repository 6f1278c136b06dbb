"""The motion of a head's calibration: a first small turn, a walk to where tags are, rows and columns, speeds, repeats.

It stays within the limits by what the head reports, and from the first turn on also by how far that really turned it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from camrig.calibrate.head import LEAST_SHOTS, calibrate_head, on_a_pivot
from camrig.calibrate.head_aims import Stop, grid, repeats, safe_range, tags_shown, tour
from camrig.calibrate.head_model import PAN, TILT, HeadModel, HeadShot, views_of
from camrig.calibrate.head_start import Turn, begin, expected_axes, turn, with_turns
from camrig.calibrate.head_timing import Run
from camrig.errors import InputError, PartialError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.interfaces import TurnsByStep
from camrig.messages import TagDetections
from camrig.rig import Interval
from camrig.runtime.head_bench import AXES, HeadBench

FIRST_TURN_RAD = math.radians(4.0)
MARGIN_RAD = math.radians(1.0)
FIRST_DOUBT = 0.04
"""By how much of itself a way may be longer than the first small turn makes it."""
_FAR_RAD = math.radians(178.0)
"""Reports wrap at half a turn; no head is sent across."""
_WALK_SHARE = 0.45
"""Part of the picture's width that a step of the walk moves it."""
_MOST_WALK_RAD = math.radians(20.0)
_EMPTY_STOPS = 2
_REPEATS = 4
_STEP_SHARES = (0.03, 0.06, 0.12, 0.25, 0.4, 0.6, 0.8, 1.0)
"""Which of the steps of speed are measured, as parts of the fastest."""
_RUN_S, _LEAST_RUN_S = 1.6, 0.5
_FIRST_RUN_S = 1.0
_STEEPEST = 4
"""How a head's speed may grow with its step, as a power."""
Tell = Callable[[str, float], None]
"""Is told what is being done, and what part of all is done."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What the calibration knows beforehand; limits are the file's, and what a person narrowed them to."""

    lens: Lens
    sizes_m: Mapping[str, float]
    file: HeadModel
    limits_rad: tuple[Interval, Interval]
    speed_rad_s: float
    anchors: Mapping[str, Transform]


@dataclass(slots=True, eq=False)
class Survey:
    """What was seen: ``start`` is a roughly right head, ``runs`` by axis."""

    start: HeadModel
    shots: list[HeadShot] = field(default_factory=list)
    runs: dict[str, list[Run]] = field(default_factory=lambda: {axis: [] for axis in AXES})
    frames: list[TagDetections] = field(default_factory=list)
    ranges_rad: tuple[Interval, Interval] = ((0.0, 0.0), (0.0, 0.0))
    moving_s: float = 0.0
    settles_s: Sequence[float] = ()


def survey(bench: HeadBench, place: Place, tell: Tell) -> Survey:
    """Move an enabled head through all of it. Raises PartialError where the head or its tags do not let it."""
    bench.begin()
    found = Survey(on_a_pivot(place.file, bench.reported_rad))
    tell("first turn", 0.0)
    _first_turns(bench, place, found)
    tell("looking for tags", 0.05)
    _walk(bench, place, found)
    model, tags = _roughly(place, found)
    walked = found.ranges_rad
    _keep_within(bench, place, found, model, 0.0)
    pan, tilt = (
        (max(low, low_walked), min(high, high_walked))
        for (low, high), (low_walked, high_walked) in zip(found.ranges_rad, walked, strict=True)
    )
    found.ranges_rad = (pan, tilt)
    stops = _tour(place, found, model, tags)
    for number, stop in enumerate(stops):
        tell("rows and columns", 0.15 + 0.55 * number / len(stops))
        found.shots += bench.visit([stop])
    tell("speeds", 0.7)
    if isinstance(bench.head, TurnsByStep):
        _speeds(bench, place, found, tell)
    tell("repeats", 0.9)
    found.shots += bench.visit(_repeats(place, found, model, tags))
    bench.go(*np.mean(found.ranges_rad, axis=1))
    found.frames, found.moving_s, found.settles_s = bench.frames, bench.moving_s, bench.settles_s
    return found


def _first_turns(bench: HeadBench, place: Place, found: Survey) -> None:
    """Turn each axis a little, forth and back, and take sign and scale from it."""
    here = bench.reported_rad
    shot = bench.look(bench.go(*here), here)
    if shot is None or not shot.corners_px:
        raise PartialError(
            f"head {bench.name} sees no tag where it looks now (pan {math.degrees(here[0]):.0f}, tilt "
            f"{math.degrees(here[1]):.0f} deg): aim it at fixed tags of a known size, or give --tag-size-m"
        )
    turns: dict[int, list[Turn]] = {PAN: [], TILT: []}
    during: list[float] = []
    middle = [0.5 * (low + high) for low, high in place.limits_rad]
    expected = expected_axes(place.file.T_mount_camera, middle[TILT])
    for axis in (PAN, TILT):
        aim = here.copy()
        aim[axis] += math.copysign(FIRST_TURN_RAD, middle[axis] - here[axis])
        for target in (aim, here):
            before, shot = shot, bench.look(bench.go(*target), target)
            if shot is None or before is None:
                break
            found.shots.append(shot)
            seen = turn(place.lens, before, shot, axis, expected[axis])
            if seen is not None:
                turns[axis].append(seen)
                during += [float(here[TILT])] if axis == PAN else []
        if not turns[axis]:
            raise PartialError(
                f"head {bench.name} reports that its {AXES[axis]} turned by {math.degrees(FIRST_TURN_RAD):.0f} deg, "
                "and its camera's picture did not turn: is that camera on this head, and do its tags stand still?"
            )
    found.start = with_turns(found.start, turns[PAN], turns[TILT], during)
    _keep_within(bench, place, found, _with_anchors(place, found), FIRST_DOUBT)


def _with_anchors(place: Place, found: Survey) -> HeadModel:
    """Return the rough head, pan's zero by the anchors that were seen so far, or as it reports itself."""
    views = views_of(found.shots, place.lens, place.sizes_m)
    if any(name in place.anchors for name in views.tags):
        return begin(found.start, views, place.anchors)[0]
    return found.start


def _keep_within(bench: HeadBench, place: Place, found: Survey, model: HeadModel, doubt: float) -> None:
    """Set the ranges to where the limits are by a model. Raises PartialError for a head that is outside of them."""
    here = bench.reported_rad
    pan, tilt = (
        safe_range(limits, axis, float(at), MARGIN_RAD, doubt)
        for limits, axis, at in zip(place.limits_rad, model.axes, here, strict=True)
    )
    pan, tilt = ((max(low, -_FAR_RAD), min(high, _FAR_RAD)) for low, high in (pan, tilt))
    for axis, at, (low, high) in zip(AXES, here, (pan, tilt), strict=True):
        if not low <= at <= high:
            raise PartialError(
                f"head {bench.name} stands within {math.degrees(MARGIN_RAD):g} deg of a limit of its {axis}, or "
                "beyond: turn it inwards"
            )
    found.ranges_rad = (pan, tilt)


def _walk(bench: HeadBench, place: Place, found: Survey) -> None:
    """Step outwards along each axis until no tag is seen any more; narrow the ranges to where there were some."""
    here = bench.reported_rad
    ranges = list(found.ranges_rad)
    for axis in (PAN, TILT):
        size, focal = place.lens.size_px[axis], place.lens.focal_px[axis]
        view_rad = 2.0 * math.atan(0.5 * size / focal)
        step_rad = min(_MOST_WALK_RAD, _WALK_SHARE * view_rad) / abs(found.start.axes[axis].factor)
        ends = [float(here[axis]), float(here[axis])]
        for side in (1, 0):
            ends[side] = _walk_out(bench, found, axis, here, step_rad if side else -step_rad, ranges[axis][side])
        ranges[axis] = (ends[0], ends[1])
        bench.go(*here)
    found.ranges_rad = (ranges[PAN], ranges[TILT])


def _walk_out(bench: HeadBench, found: Survey, axis: int, here: Array, step_rad: float, end_rad: float) -> float:
    """Return how far out tags were seen, and a step further, within the end."""
    aim, empty, last = here.copy(), 0, float(here[axis])
    while empty < _EMPTY_STOPS and abs(end_rad - aim[axis]) > 1e-6:
        way = end_rad - aim[axis]
        aim[axis] += way if abs(way) < abs(step_rad) else step_rad
        shots = bench.visit([Stop(*aim)])
        found.shots += shots
        empty = 0 if shots else empty + 1
        last = float(aim[axis]) if shots else last
    return last


def _roughly(place: Place, found: Survey) -> tuple[HeadModel, dict[str, Transform]]:
    """Return the head and its tags from what the walk showed. Raises PartialError where that is too little."""
    if len(found.shots) < LEAST_SHOTS:
        raise PartialError(
            f"tags were seen at only {len(found.shots)} stops, and {LEAST_SHOTS} are needed: hang tags where the head "
            "can look, or give it wider limits"
        )
    try:
        rough = calibrate_head(found.shots, place.lens, place.sizes_m, found.start, place.anchors)
    except InputError as error:
        raise PartialError(str(error)) from error
    return rough.fit.model, dict(rough.fit.T_world_tag)


def _tour(place: Place, found: Survey, model: HeadModel, tags: Mapping[str, Transform]) -> tuple[Stop, ...]:
    pans, tilts = grid(*found.ranges_rad)
    aims = np.array([(pan, tilt) for pan in pans for tilt in tilts])
    shows = tags_shown(model, tags, place.sizes_m, place.lens, aims).reshape(len(pans), len(tilts)) > 0
    return tour(pans, tilts, shows)


def _repeats(place: Place, found: Survey, model: HeadModel, tags: Mapping[str, Transform]) -> tuple[Stop, ...]:
    """Return the repeated aim: where most tags are seen, with room to come from either side."""
    away = [min(math.radians(12.0), 0.25 * (high - low)) for low, high in found.ranges_rad]
    pans, tilts = grid(*((low + by, high - by) for (low, high), by in zip(found.ranges_rad, away, strict=True)))
    aims = np.array([(pan, tilt) for pan in pans for tilt in tilts])
    best = aims[int(np.argmax(tags_shown(model, tags, place.sizes_m, place.lens, aims)))]
    return repeats(float(best[PAN]), float(best[TILT]), away, _REPEATS)


def _speeds(bench: HeadBench, place: Place, found: Survey, tell: Tell) -> None:
    """Turn both axes at growing steps of speed, forth and back, each as long as there is room for it."""
    assert isinstance(bench.head, TurnsByStep)
    offered = bench.head.steps()
    most_rad_s = place.speed_rad_s / min(abs(axis.factor) for axis in found.start.axes)
    room_rad = min(high - low for low, high in found.ranges_rad)
    for number, share in enumerate(_STEP_SHARES):
        tell("speeds", 0.7 + 0.2 * number / len(_STEP_SHARES))
        steps = [offered[axis][max(0, round(share * len(offered[axis])) - 1)] for axis in AXES]
        expected = _fastest(found.runs, max(steps), most_rad_s)
        lasts_s = min(_RUN_S, 0.8 * room_rad / expected) if expected else _FIRST_RUN_S
        if lasts_s < _LEAST_RUN_S:
            return
        for forth in (1, -1):
            bench.go(*_begin_at(found, 0.5 * forth * expected * lasts_s))
            for run in bench.run((forth * steps[PAN], forth * steps[TILT]), lasts_s, found.ranges_rad):
                found.runs[AXES[run.axis]].append(run)


def _begin_at(found: Survey, half_rad: float) -> Array:
    """Return where to begin a turn that is to pass the middle half way; the file may have the drive's sign wrong."""
    at = []
    for axis, (low, high) in zip(AXES, found.ranges_rad, strict=True):
        along = sum(math.copysign(1.0, run.step) * _way_rad(run) for run in found.runs[axis])
        at.append(float(np.clip(0.5 * (low + high) - math.copysign(half_rad, half_rad * along), low, high)))
    return np.array(at)


def _way_rad(run: Run) -> float:
    return float(run.reported_rad[-1] - run.reported_rad[0])


def _fastest(runs: Mapping[str, Sequence[Run]], step: int, most_rad_s: float) -> float:
    """Return how fast a step may turn at most, from slower ones; 0 while nothing is known."""
    rates = {
        abs(run.step): abs(_way_rad(run)) / max(run.ended_s - run.told_s, 0.1) for own in runs.values() for run in own
    }
    if not rates:
        return 0.0
    last = max(rates)
    return min(most_rad_s, max(rates[last], math.radians(0.2)) * (step / last) ** _STEEPEST)
