"""What pictures say of marks: tags, or boards with many corners, by their points in the mark's frame and in pixels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import TAG_CORNERS, square_poses
from camrig.geometry.pose import transform

ROOM = ""
"""The body of marks that stand in the room."""

ALWAYS = -1
"""The instant of the room: it is the same in every picture."""

LEAST_POINTS = 4
"""A board of which fewer points are seen says nothing by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoard:
    """The (n, 3) points of a flat board (z = 0) that a picture shows, and their (n, 2) pixels (OpenCV's)."""

    points_m: Array
    pixels: Array


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What one camera saw at one instant: of tags (4, 2) corners p0..p3 in pixels (OpenCV's), and boards, by name.

    ``aim_rad`` is pan and tilt of the head that carried the camera, as it said itself.
    """

    camera_id: str
    instant: int
    corners_px: Mapping[str, Array]
    boards: Mapping[str, SeenBoard] = field(default_factory=dict)
    aim_rad: tuple[float, float] | None = None


class Picture(NamedTuple):
    """A camera, the stop of its head (0 where there is none), an instant."""

    camera: str
    stop: int
    instant: int


@dataclass(frozen=True, eq=False)
class Sighted:
    """A mark in a picture: (n, 3) points in its frame, (n, 2) pixels, these undistorted (``ideal``) with the lens's
    scale there (n, 2, 2), and the ``size_m`` of a tag.
    """

    picture: Picture
    mark: str
    points_m: Array
    pixels: Array
    ideal: Array
    px_per_ideal: Array
    size_m: float | None

    @cached_property
    def poses(self) -> tuple[Transform, ...]:
        """The up to two ``T_camera_mark`` that the points allow by themselves; few sightings are ever asked."""
        if self.size_m is None:
            return _board_poses(self.points_m, self.ideal)
        found = square_poses(self.ideal, self.px_per_ideal, self.size_m)
        return tuple(pose.T_camera_tag for pose in found)

    @property
    def width_px(self) -> float:
        """The diagonal of what is seen of it."""
        return float(np.linalg.norm(np.ptp(self.pixels, axis=0)))


def stops(shots: Sequence[Shot], camera_id: str) -> list[tuple[float, float]]:
    """Return the different aims of a camera's shots, in their order; of one that no head carries none."""
    return list(dict.fromkeys(shot.aim_rad for shot in shots if shot.camera_id == camera_id and shot.aim_rad))


def sighted(
    shots: Sequence[Shot], lenses: Mapping[str, Lens], sizes_m: Mapping[str, float], still: frozenset[str]
) -> tuple[Sighted, ...]:
    """Undistort all marks, those that stand ``still`` once a stop; leaves out tags with a corner past the lens's
    ``r_max``, and boards of which too little is within.
    """
    return tuple(each for name, lens in lenses.items() for each in _of_camera(name, lens, shots, sizes_m, still))


def _of_camera(
    camera_id: str, lens: Lens, shots: Sequence[Shot], sizes_m: Mapping[str, float], still: frozenset[str]
) -> Iterator[Sighted]:
    aims = {aim: k for k, aim in enumerate(stops(shots, camera_id))}
    found: list[tuple[Picture, str, Array, Array]] = []
    repeated: dict[tuple[Picture, str], list[tuple[Array, Array]]] = {}
    for shot in shots:
        if shot.camera_id != camera_id:
            continue
        stop = aims[shot.aim_rad] if shot.aim_rad else 0
        seen = {tag: (sizes_m[tag] * TAG_CORNERS, corners_px) for tag, corners_px in shot.corners_px.items()}
        seen |= {name: (board.points_m, board.pixels) for name, board in shot.boards.items()}
        for mark, (points_m, pixels) in seen.items():
            if mark in still:
                repeated.setdefault((Picture(camera_id, stop, ALWAYS), mark), []).append((points_m, pixels))
            else:
                found.append((Picture(camera_id, stop, shot.instant), mark, points_m, pixels))
    found += [(picture, mark, *_once(seen)) for (picture, mark), seen in repeated.items()]
    if not found:
        return
    counts = np.array([len(pixels) for *_, pixels in found])
    ideal = lens.unproject(np.concatenate([pixels for *_, pixels in found]))
    scale = lens.jacobian(ideal) * np.asarray(lens.focal_px)[:, None]
    ends = np.cumsum(counts)
    for (picture, mark, points_m, pixels), first, end in zip(found, ends - counts, ends, strict=True):
        inside = np.isfinite(ideal[first:end]).all(axis=1)
        size_m = sizes_m.get(mark)
        if not inside.all() and (size_m is not None or inside.sum() < LEAST_POINTS):
            continue
        own = (points_m[inside], pixels[inside], ideal[first:end][inside], scale[first:end][inside])
        yield Sighted(picture, mark, *own, size_m)


def _once(seen: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return what one picture of many shows of what does not move: most of its noise is the same in each of them, so
    that many are worth hardly more than one.
    """
    points_m, _ = max(seen, key=lambda each: len(each[0]))
    alike = [pixels for points, pixels in seen if points.shape == points_m.shape and (points == points_m).all()]
    return points_m, np.asarray(np.median(alike, axis=0))


def _board_poses(points_m: Array, ideal: Array) -> tuple[Transform, ...]:
    """Return the poses of a flat board before a camera: two, the better first; none where its points say too little."""
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(points_m, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return ()
    poses = (
        transform(np.asarray(cv2.Rodrigues(r)[0], float), np.asarray(t, float)[:, 0])
        for r, t in zip(rotations, translations, strict=True)
    )
    return tuple(T for T in poses if np.isfinite(T).all() and (points_m @ T[2, :3] + T[2, 3] > 0.0).all())
