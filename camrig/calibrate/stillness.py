"""What stands and what is carried, by the pictures of cameras that keep still; what was moved meanwhile, and when.

A mark that a camera sees at one place stands in the room; one that is elsewhere again and again is carried. One that
keeps to one place and from some picture on to another was moved, and if all marks of a camera did so at once and
another camera says that they stood, the camera was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from camrig.calibrate.sighted import Shot
from camrig.geometry.arrays import Array

SAME_PX = 2.0
"""Corners that differ by less on average are at the same place."""

LEAST_PICTURES = 3
"""A mark was at a place if it was there in so many pictures, one after the other."""

MISREAD_SHARE = 0.2
"""So many pictures may show a mark elsewhere, once each: they were misread."""

_SQUARE_M = 0.1
"""Side of the square by which boards are compared."""


@dataclass(frozen=True, slots=True)
class Moved:
    """What was moved - a mark or, ``mark`` empty, the camera itself - as a camera saw it: by how much, and from which
    instant on.
    """

    camera: str
    mark: str
    instant: int
    by_px: float


@dataclass(frozen=True, slots=True)
class Stillness:
    """The marks that stand in the room, those that are carried, and what was moved; ``walking`` are the cameras before
    which even anchors move.
    """

    still: frozenset[str]
    carried: frozenset[str]
    moved: tuple[Moved, ...]
    walking: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Stays:
    """The places of one mark before one camera (at one stop of its head): how it looks, and when it was moved."""

    word: str  # "still", "carried", "moved" or, of one picture, "seen"
    moved: Moved | None = None


def stillness(shots: Sequence[Shot], anchors: frozenset[str]) -> Stillness:
    """Sort all marks; a mark of which nothing else is known stands."""
    stays: dict[str, dict[str, list[_Stays]]] = {}
    for (camera, _), of_stop in _by_stop(shots).items():
        for mark, seen in _by_mark(of_stop).items():
            stays.setdefault(camera, {}).setdefault(mark, []).append(_stay(camera, mark, seen))
    bumped = tuple(filter(None, (_bumped(camera, by_mark, stays, anchors) for camera, by_mark in stays.items())))
    for moved in bumped:
        stays.pop(moved.camera)
    together = {moved.camera: _at_once(by_mark) for moved, by_mark in _moves(stays)}
    alone = [moved for moved, _ in _moves(stays) if moved.mark in anchors or together[moved.camera][moved.instant] == 1]
    still_before = {moved.mark for moved in alone}
    carried = {
        mark
        for by_mark in stays.values()
        for mark, several in by_mark.items()
        if mark not in anchors | still_before and any(each.word in ("carried", "moved") for each in several)
    }
    walking = tuple(
        camera
        for camera, by_mark in stays.items()
        if any(each.word == "carried" for mark in anchors & by_mark.keys() for each in by_mark[mark])
    )
    every = {mark for shot in shots for mark in (*shot.corners_px, *shot.boards)}
    first = {moved.mark: moved for moved in sorted(alone, key=lambda moved: -moved.instant)}
    return Stillness(frozenset(every - carried), frozenset(carried), (*bumped, *first.values()), walking)


def without_moved(shots: Sequence[Shot], moved: Sequence[Moved]) -> list[Shot]:
    """Return the shots with only those pictures of what was moved that were taken before."""
    cameras = {each.camera: each.instant for each in moved if not each.mark}
    marks = {each.mark: each.instant for each in moved if each.mark}
    kept = []
    for shot in shots:
        if shot.instant >= cameras.get(shot.camera_id, shot.instant + 1):
            continue
        here = {mark for mark in (*shot.corners_px, *shot.boards) if shot.instant < marks.get(mark, shot.instant + 1)}
        corners_px = {mark: px for mark, px in shot.corners_px.items() if mark in here}
        boards = {mark: board for mark, board in shot.boards.items() if mark in here}
        kept.append(replace(shot, corners_px=corners_px, boards=boards))
    return kept


def _by_stop(shots: Sequence[Shot]) -> Mapping[tuple[str, tuple[float, float] | None], list[Shot]]:
    found: dict[tuple[str, tuple[float, float] | None], list[Shot]] = {}
    for shot in sorted(shots, key=lambda shot: shot.instant):
        found.setdefault((shot.camera_id, shot.aim_rad), []).append(shot)
    return found


def _by_mark(shots: Sequence[Shot]) -> Mapping[str, list[tuple[int, Array]]]:
    found: dict[str, list[tuple[int, Array]]] = {}
    for shot in shots:
        for mark, pixels in shot.corners_px.items():
            found.setdefault(mark, []).append((shot.instant, pixels))
        for mark, board in shot.boards.items():
            found.setdefault(mark, []).append((shot.instant, _outline(board.points_m, board.pixels)))
    return found


def _outline(points_m: Array, pixels: Array) -> Array:
    """Return (4, 2) where a square of the board would be: comparable, whatever part of the board is seen."""
    affine, *_ = np.linalg.lstsq(np.hstack([points_m[:, :2], np.ones((len(points_m), 1))]), pixels, rcond=None)
    square = np.array([[0.0, 0.0, 1.0], [_SQUARE_M, 0.0, 1.0], [_SQUARE_M, _SQUARE_M, 1.0], [0.0, _SQUARE_M, 1.0]])
    return np.asarray(square @ affine)


def _stay(camera: str, mark: str, seen: Sequence[tuple[int, Array]]) -> _Stays:
    """Judge the (instant, corners) of one mark before one camera, in their order."""
    if len(seen) == 1:
        return _Stays("seen")
    places: list[Array] = []
    at = []
    for _, corners in seen:
        near = (k for k, place in enumerate(places) if _apart(place, corners) < SAME_PX)
        at.append(next(near, len(places)))
        if at[-1] == len(places):
            places.append(corners)
    counts = np.bincount(at)
    kept = [place for place, count in enumerate(counts) if count >= LEAST_PICTURES]
    if len(counts) == 1:
        return _Stays("still")
    if sum(counts[place] for place in kept) < (1.0 - MISREAD_SHARE) * len(seen) or len(kept) > 2:
        return _Stays("carried")
    if len(kept) == 1:
        return _Stays("still")
    runs = [place for place, _ in groupby(place for place in at if place in kept)]
    if len(runs) > 2:
        return _Stays("carried")
    first = seen[at.index(runs[1])]
    return _Stays("moved", Moved(camera, mark, first[0], _apart(places[runs[0]], first[1])))


def _apart(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b, axis=1).mean())


def _moves(
    stays: Mapping[str, Mapping[str, Sequence[_Stays]]],
) -> Iterator[tuple[Moved, Mapping[str, Sequence[_Stays]]]]:
    for by_mark in stays.values():
        for several in by_mark.values():
            yield from ((each.moved, by_mark) for each in several if each.moved is not None)


def _at_once(by_mark: Mapping[str, Sequence[_Stays]]) -> Mapping[int, int]:
    """Return how many marks were moved from each instant on."""
    instants = [each.moved.instant for several in by_mark.values() for each in several if each.moved is not None]
    return {instant: instants.count(instant) for instant in instants}


def _bumped(
    camera: str,
    by_mark: Mapping[str, Sequence[_Stays]],
    stays: Mapping[str, Mapping[str, Sequence[_Stays]]],
    anchors: frozenset[str],
) -> Moved | None:
    """Tell when a camera was moved: all that it could see stand jumped at once, and what jumped is known to stand."""
    moves = [each.moved for several in by_mark.values() for each in several if each.moved is not None]
    stood = any(each.word == "still" for several in by_mark.values() for each in several)
    if not moves or stood or len({moved.instant for moved in moves}) > 1:
        return None
    known = anchors | {
        mark
        for other, theirs in stays.items()
        for mark, several in theirs.items()
        if other != camera and any(each.word == "still" for each in several)
    }
    jumped = [moved for moved in moves if moved.mark in known]
    # A single anchor that jumps is more likely to have been moved itself than the camera.
    if len(jumped) < 2 and not any(moved.mark not in anchors for moved in jumped):
        return None
    return replace(max(jumped, key=lambda moved: moved.by_px), mark="")
