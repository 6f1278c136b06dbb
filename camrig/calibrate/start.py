"""Where to begin: pictures and tags placed one by one from what single tags say, until nothing more hangs together.

Each tag in a picture has two poses (geometry.pnp). Pictures that show placed tags are placed, tags in placed pictures
are placed; of all candidates the one stays that most corners agree with. What a single tag leaves open waits until more
is placed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import ImagePoints, refine, square_poses, whitened_residuals
from camrig.geometry.pose import apply, invert
from camrig.geometry.rotation import rotation_log

_CLEAR = 0.25
"""A pose whose mean square miss is below this share of its rival's is the right one."""

_SAME_RAD = 0.05
"""Two poses turned by less against each other are one."""

_CAP_PX = 5.0
"""A corner further off than this tells nothing more: candidates are judged by what agrees."""

_ASKED = 50
"""Of about so many pictures it is asked where a tag may be."""

Picture = tuple[str, int]
"""A camera and an instant."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """A tag of ``size_m`` in a picture: its (4, 3) corners in its own frame, its (4, 2) pixels, these undistorted."""

    picture: Picture
    tag: str
    size_m: float
    corners_m: Array
    pixels: Array
    points: ImagePoints


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """``T_camera_world`` by picture and ``T_world_tag`` by tag; the world is the known tags' or that tag's.

    What is missing hangs on nothing that is placed.
    """

    pictures: Mapping[Picture, Transform]
    tags: Mapping[str, Transform]


def place(sighted: Sequence[Sighted], known: Mapping[str, Transform] | None = None) -> Placed:
    """Place everything that hangs together with the ``known`` tags or, without any, with the tag seen most often."""
    return _Placing(sighted, known or {}).run()


class _Placing:
    def __init__(self, sighted: Sequence[Sighted], known: Mapping[str, Transform]) -> None:
        self._candidates = {
            id(each): [
                pose.T_camera_tag for pose in square_poses(each.points.ideal, each.points.px_per_ideal, each.size_m)
            ]
            for each in sighted
        }
        self._in: dict[Picture, list[Sighted]] = {}
        self._of: dict[str, list[Sighted]] = {}
        for each in sighted:
            self._in.setdefault(each.picture, []).append(each)
            self._of.setdefault(each.tag, []).append(each)
        self._pictures: dict[Picture, Transform] = {}
        self._tags = dict(known) or {max(self._of, key=lambda tag: len(self._of[tag])): np.eye(4)}

    def run(self) -> Placed:
        while self._place_pictures(_CLEAR) or self._place_tag() or self._place_pictures(1.0):
            pass
        return Placed(self._pictures, self._tags)

    def _place_pictures(self, clear: float) -> bool:
        """Place the pictures whose placed tags leave no doubt; tell whether there was one."""
        before = len(self._pictures)
        for picture, sighted in self._in.items():
            known = [each for each in sighted if each.tag in self._tags]
            if picture not in self._pictures and (T := self._camera(known, clear)) is not None:
                self._pictures[picture] = T
        return len(self._pictures) > before

    def _camera(self, known: Sequence[Sighted], clear: float) -> Transform | None:
        """Return the ``T_camera_world`` that placed tags agree on best; None where another one is about as good."""
        starts = [T @ invert(self._tags[each.tag]) for each in known for T in self._candidates[id(each)]]
        if not starts:
            return None
        corners = np.concatenate([apply(self._tags[each.tag], each.corners_m) for each in known])
        ideal = np.concatenate([each.points.ideal for each in known])
        scale = np.concatenate([each.points.px_per_ideal for each in known])
        corners, ideal, scale = (np.repeat(part[None], len(starts), axis=0) for part in (corners, ideal, scale))
        T = refine(np.stack(starts), corners, ideal, scale).T_camera_body
        off = _disagreement(T, corners, ideal, scale)
        best = int(np.argmin(off))
        rivals = (off[k] for k in range(len(T)) if _angle(T[k], T[best]) > _SAME_RAD)
        return None if any(off[best] > clear * rival for rival in rivals) else T[best]

    def _place_tag(self) -> bool:
        """Place the tag that most placed pictures show; tell whether there was one."""
        showing = {
            tag: [each for each in sighted if each.picture in self._pictures]
            for tag, sighted in self._of.items()
            if tag not in self._tags
        }
        tag = max(showing, key=lambda name: len(showing[name]), default=None)
        if tag is None:
            return False
        asked = showing[tag][:: 1 + len(showing[tag]) // _ASKED]
        T = [invert(self._pictures[each.picture]) @ T for each in asked for T in self._candidates[id(each)]]
        if not T:
            return False
        T_camera_world = np.stack([self._pictures[each.picture] for each in showing[tag]])
        corners = np.stack([each.corners_m for each in showing[tag]])
        ideal = np.stack([each.points.ideal for each in showing[tag]])
        scale = np.stack([each.points.px_per_ideal for each in showing[tag]])
        off = [_disagreement(T_camera_world @ each, corners, ideal, scale).sum() for each in T]
        self._tags[tag] = T[int(np.argmin(off))]
        return True


def agreed(poses: Iterable[Transform]) -> Transform:
    """Return that of several poses of one thing from which the others are turned least."""
    several = list(poses)
    asked = several[:: 1 + len(several) // _ASKED]
    off = [sum(min(_angle(T, other), _SAME_RAD) for other in several) for T in asked]
    return asked[int(np.argmin(off))]


def _disagreement(T: Array, points: Array, ideal: Array, scale: Array) -> Array:
    """Return the (m,) mean square misses in pixels of (m, n) corners, each capped."""
    residual_px, _ = whitened_residuals(T, points, ideal, scale)
    return np.asarray(np.minimum(np.square(residual_px).sum(axis=2), _CAP_PX**2).mean(axis=1))


def _angle(T_a: Transform, T_b: Transform) -> float:
    return float(np.linalg.norm(rotation_log(T_a[:3, :3] @ T_b[:3, :3].T)))
