"""Where a head is sent so that its calibration sees what it must: rows and columns of aims, each from both sides. Pure.

All angles are as the head reports them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camrig.calibrate.head_model import PAN, TILT, AxisModel, HeadModel
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert
from camrig.rig import Interval

LEAST_SIDE_PX = 20.0
_RIM = 1.3
_ACROSS = (9, 6)
"""Aims across pan's and tilt's range."""
_AS_GOOD = 0.6
"""A second row or column shows at least this share of what the first shows; of those the farthest is taken."""
APPROACH_RAD = math.radians(2.5)
"""From so far a row is entered, so that it is known on which side of the play it begins."""


@dataclass(frozen=True, slots=True)
class Stop:
    """One aim of a tour; at some nothing is looked at, they only prepare the next."""

    pan_rad: float
    tilt_rad: float
    look: bool = True


def safe_range(limits_rad: Interval, axis: AxisModel, here_rad: float, margin_rad: float, doubt: float) -> Interval:
    """Return the reports of an axis at which it truly is within its limits, as far as ``axis`` is right.

    The margin grows by ``doubt`` with the way from ``here_rad``, the present report.
    """
    at_rad = float(axis.line_rad(np.array(here_rad)))
    ways = []
    for limit_rad, inwards in zip(limits_rad, (1.0, -1.0), strict=True):
        way_rad = limit_rad - at_rad
        ways.append((way_rad + inwards * (margin_rad + doubt * abs(way_rad))) / axis.factor)
    low_rad, high_rad = min(ways), max(ways)
    return here_rad + low_rad, here_rad + high_rad


def tags_shown(
    model: HeadModel, T_world_tag: Mapping[str, Transform], sizes_m: Mapping[str, float], lens: Lens, aims_rad: Array
) -> npt.NDArray[np.int64]:
    """Return (n,): how many tags the pictures at (n, 2) reported aims show whole, from the front and large enough."""
    size = np.array(lens.size_px)
    shown = np.zeros(len(aims_rad), int)
    for k, angles in enumerate(model.angles_rad(aims_rad, np.zeros_like(aims_rad))):
        T_camera_world = invert(model.T_world_camera(*angles))
        for name, T in T_world_tag.items():
            T_camera_tag = T_camera_world @ T
            facing = float(T_camera_tag[:3, 2] @ T_camera_tag[:3, 3]) < 0.0
            pixels = lens.project(apply(T_camera_tag, _RIM * sizes_m[name] * TAG_CORNERS))
            inside = bool(np.isfinite(pixels).all() and (pixels > 0.0).all() and (pixels < size - 1.0).all())
            sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1)
            shown[k] += facing and inside and float(sides.min()) > _RIM * LEAST_SIDE_PX
    return shown


def grid(pan: Interval, tilt: Interval) -> tuple[Array, Array]:
    """Return the pans and tilts across both ranges."""
    return np.linspace(*pan, _ACROSS[PAN]), np.linspace(*tilt, _ACROSS[TILT])


def tour(pans: Array, tilts: Array, shows: npt.NDArray[np.bool_]) -> tuple[Stop, ...]:
    """Return rows and columns of a grid, forth and back; ``shows`` (pans, tilts) tells where tags are in pictures."""
    stops: list[Stop] = []
    for tilt in _best_two(shows.sum(axis=0), tilts):
        at = [float(pans[k]) for k in np.flatnonzero(shows[:, tilt])]
        stops += [Stop(pan, float(tilts[tilt]), look) for pan, look in _forth_and_back(at, (pans[0], pans[-1]))]
    for pan in _best_two(shows.sum(axis=1), pans):
        at = [float(tilts[k]) for k in np.flatnonzero(shows[pan])]
        stops += [Stop(float(pans[pan]), tilt, look) for tilt, look in _forth_and_back(at, (tilts[0], tilts[-1]))]
    return tuple(stops)


def repeats(pan_rad: float, tilt_rad: float, away_rad: Sequence[float], times: int) -> tuple[Stop, ...]:
    """Return one aim approached so often from either side, coming from ``away_rad`` (pan, tilt) below and above."""
    stops = []
    for side in (-1.0, 1.0):
        for _ in range(times):
            stops.append(Stop(pan_rad + side * away_rad[PAN], tilt_rad + side * away_rad[TILT], look=False))
            stops.append(Stop(pan_rad, tilt_rad))
    return tuple(stops)


def _best_two(counts: npt.NDArray[np.int64], places: Array) -> list[int]:
    """Return the row that shows most, and the farthest of those that show about as much."""
    best = int(np.argmax(counts))
    others = [k for k in range(len(counts)) if k != best and counts[k] >= max(2.0, _AS_GOOD * counts[best])]
    if counts[best] == 0:
        return []
    return [best, *([max(others, key=lambda k: abs(places[k] - places[best]))] if others else [])]


def _forth_and_back(at_rad: Sequence[float], ends_rad: tuple[float, float]) -> list[tuple[float, bool]]:
    """Return places in rising order, then falling, each way entered from outside as far as the range lets."""
    if not at_rad:
        return []
    below = max(ends_rad[0], at_rad[0] - APPROACH_RAD)
    above = min(ends_rad[1], at_rad[-1] + APPROACH_RAD)
    forth = [(below, False)] if below < at_rad[0] else []
    back = [(above, False)] if above > at_rad[-1] else []
    return [*forth, *((each, True) for each in at_rad), *back, *((each, True) for each in at_rad[::-1])]
