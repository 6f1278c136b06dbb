"""Where to begin: pictures and marks of one body placed one by one, until nothing more hangs together.

Each mark in a picture has two poses (geometry.pnp). Pictures that show placed marks are placed, marks in placed
pictures are placed; of all candidates the one stays that most points agree with. What a single mark leaves open waits
until more is placed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.calibrate.sighted import Picture, Sighted
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import refine, whitened_residuals
from camrig.geometry.pose import apply, invert
from camrig.geometry.rotation import rotation_log

_CLEAR = 0.25
"""A pose whose mean square miss is below this share of its rival's is the right one."""

_SAME_RAD = 0.05
"""Two poses turned by less against each other are one."""

_CAP_PX = 5.0
"""A point further off than this tells nothing more: candidates are judged by what agrees."""

_ASKED = 50
"""Of about so many pictures it is asked where a mark may be."""

_JUDGES = 200
"""About so many pictures judge the answers."""

_STARTS = 4
"""So many marks of a picture, the widest, are asked where it was taken from; all are asked whether that is right."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """``T_camera_body`` by picture and ``T_body_mark`` by mark; the body's frame is the known marks' or that mark's.

    What is missing hangs on nothing that is placed.
    """

    pictures: Mapping[Picture, Transform]
    marks: Mapping[str, Transform]


def place(
    sighted: Sequence[Sighted],
    known: Mapping[str, Transform] | None = None,
    pictures: Mapping[Picture, Transform] | None = None,
) -> Placed:
    """Place everything that hangs together with ``known`` marks and ``pictures`` or, without any, with the mark of
    which most is seen.
    """
    return _Placing(sighted, known or {}, pictures or {}).run()


class _Placing:
    def __init__(
        self, sighted: Sequence[Sighted], known: Mapping[str, Transform], pictures: Mapping[Picture, Transform]
    ) -> None:
        self._in: dict[Picture, list[Sighted]] = {}
        self._of: dict[str, list[Sighted]] = {}
        for each in sighted:
            self._in.setdefault(each.picture, []).append(each)
            self._of.setdefault(each.mark, []).append(each)
        self._pictures = dict(pictures)
        self._marks = dict(known)
        self._asked: dict[Picture, tuple[int, float]] = {}
        if not known and not pictures:
            self._marks = {max(self._of, key=lambda mark: sum(len(each.pixels) for each in self._of[mark])): np.eye(4)}

    def run(self) -> Placed:
        while self._place_pictures(_CLEAR) or self._place_mark() or self._place_pictures(1.0):
            pass
        return Placed(self._pictures, self._marks)

    def _place_pictures(self, clear: float) -> bool:
        """Place the pictures whose placed marks leave no doubt; tell whether there was one."""
        before = len(self._pictures)
        for picture, sighted in self._in.items():
            if picture in self._pictures:
                continue
            known = [each for each in sighted if each.mark in self._marks]
            question = (len(known), clear)
            if self._asked.get(picture) == question:
                continue
            self._asked[picture] = question
            if (T := _camera(known, self._marks, clear)) is not None:
                self._pictures[picture] = T
        return len(self._pictures) > before

    def _place_mark(self) -> bool:
        """Place the mark that most placed pictures show; tell whether there was one."""
        showing = {
            mark: [each for each in sighted if each.picture in self._pictures]
            for mark, sighted in self._of.items()
            if mark not in self._marks
        }
        for mark in sorted(showing, key=lambda name: -len(showing[name])):
            asked = showing[mark][:: 1 + len(showing[mark]) // _ASKED]
            T = [invert(self._pictures[each.picture]) @ T for each in asked for T in each.poses]
            if T:
                self._marks[mark] = self._best(showing[mark], T)
                return True
        return False

    def _best(self, showing: Sequence[Sighted], T: Sequence[Transform]) -> Transform:
        """Return that ``T_body_mark`` of several on which most pictures agree."""
        judges = showing[:: 1 + len(showing) // _JUDGES]
        T_camera_body = np.stack([self._pictures[each.picture] for each in judges])
        points, ideal, scale = _padded(judges)
        off = [_disagreement(T_camera_body @ each, points, ideal, scale).sum() for each in T]
        return T[int(np.argmin(off))]


def agreed(poses: Iterable[Transform]) -> Transform:
    """Return that of several poses of one thing from which the others are turned least."""
    several = list(poses)
    asked = several[:: 1 + len(several) // _ASKED]
    off = [sum(min(_angle(T, other), _SAME_RAD) for other in several) for T in asked]
    return asked[int(np.argmin(off))]


def _camera(known: Sequence[Sighted], marks: Mapping[str, Transform], clear: float) -> Transform | None:
    """Return the ``T_camera_body`` that placed marks agree on best; None where another one is about as good."""
    widest = sorted(known, key=lambda each: -each.width_px)[:_STARTS]
    starts = [T @ invert(marks[each.mark]) for each in widest for T in each.poses]
    if not starts:
        return None
    points = np.concatenate([apply(marks[each.mark], each.points_m) for each in known])
    ideal = np.concatenate([each.ideal for each in known])
    scale = np.concatenate([each.px_per_ideal for each in known])
    points, ideal, scale = (np.repeat(part[None], len(starts), axis=0) for part in (points, ideal, scale))
    T = refine(np.stack(starts), points, ideal, scale).T_camera_body
    off = _disagreement(T, points, ideal, scale)
    best = int(np.argmin(off))
    rivals = (off[k] for k in range(len(T)) if _angle(T[k], T[best]) > _SAME_RAD)
    return None if any(off[best] > clear * rival for rival in rivals) else T[best]


def _padded(sighted: Sequence[Sighted]) -> tuple[Array, Array, Array]:
    """Return (m, n, 3) points, (m, n, 2) ideal and (m, n, 2, 2) scales; of points that are not seen the scale is 0."""
    m, n = len(sighted), max(len(each.pixels) for each in sighted)
    points, ideal, scale = np.zeros((m, n, 3)), np.zeros((m, n, 2)), np.zeros((m, n, 2, 2))
    for k, each in enumerate(sighted):
        seen = len(each.pixels)
        points[k, :seen], ideal[k, :seen], scale[k, :seen] = each.points_m, each.ideal, each.px_per_ideal
    return points, ideal, scale


def _disagreement(T: Array, points: Array, ideal: Array, scale: Array) -> Array:
    """Return the (m,) mean square misses in pixels of (m, n) points, each capped."""
    residual_px, _ = whitened_residuals(T, points, ideal, scale)
    return np.asarray(np.minimum(np.square(residual_px).sum(axis=2), _CAP_PX**2).mean(axis=1))


def _angle(T_a: Transform, T_b: Transform) -> float:
    return float(np.linalg.norm(rotation_log(T_a[:3, :3] @ T_b[:3, :3].T)))
