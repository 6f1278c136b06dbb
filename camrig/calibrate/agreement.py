"""How well cameras of known place agree: points that several saw at one instant, placed in space, and their misses.

Every point is placed by itself, so that nothing is assumed of boards or tags: what is left is of lenses, places,
stamps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.calibrate.sighted import Sighted
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pose import apply, invert

_STEPS = 5
_MM_PER_M = 1000.0

Station = tuple[str, int]
"""A camera and the stop of its head, 0 where it has none."""

Point = tuple[str, int, tuple[float, ...]]
"""A mark, an instant, and which point of the mark, by its place on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Of n views of points that more than one camera saw: by which ``camera`` (n,), (n, 2) pixels from where they were
    seen to where all cameras together put them, and how far that is in space, (n,) mm at the point's distance.
    """

    camera: tuple[str, ...]
    residual_px: Array
    residual_mm: Array
    points: int

    def of_camera(self, name: str) -> tuple[Array, Array]:
        """Return one camera's misses, in pixels and mm."""
        own = np.array([camera == name for camera in self.camera], dtype=bool)
        return np.linalg.norm(self.residual_px[own], axis=1), self.residual_mm[own]


def agreement(
    sighted: Sequence[Sighted], lenses: Mapping[str, Lens], T_world_camera: Mapping[Station, Transform]
) -> Agreement:
    """Place every point that cameras of known place saw at one instant; marks that stand may be of one instant, too."""
    views: dict[Point, list[tuple[Station, Array, Array, Array]]] = {}
    for each in sighted:
        station = (each.picture.camera, each.picture.stop)
        if station not in T_world_camera:
            continue
        rows = zip(np.round(each.points_m, 6).tolist(), each.pixels, each.ideal, each.px_per_ideal, strict=True)
        for at, pixel, ideal, scale in rows:
            point = (each.mark, each.picture.instant, tuple(at))
            views.setdefault(point, []).append((station, pixel, ideal, scale))
    T_camera_world = {name: invert(T) for name, T in T_world_camera.items()}
    cameras: list[str] = []
    px: list[Array] = []
    mm: list[Array] = []
    points = 0
    for seen in views.values():
        names = [camera for (camera, _), *_ in seen]
        if len(set(names)) < 2:
            continue
        T = np.stack([T_camera_world[station] for station, *_ in seen])
        ideal, scale = (np.stack([view[k] for view in seen]) for k in (2, 3))
        placed = _placed(T, ideal, scale)
        in_camera = np.stack([apply(each, placed) for each in T])
        off = np.stack(
            [lenses[name].project(at) - view[1] for name, at, view in zip(names, in_camera, seen, strict=True)]
        )
        focal_px = np.sqrt(np.abs(np.linalg.det(scale)))
        cameras += names
        px.append(off)
        mm.append(_MM_PER_M * np.linalg.norm(off, axis=1) * in_camera[:, 2] / focal_px)
        points += 1
    if not px:
        return Agreement((), np.zeros((0, 2)), np.zeros(0), 0)
    return Agreement(tuple(cameras), np.concatenate(px), np.concatenate(mm), points)


def _placed(T_camera_world: Array, ideal: Array, px_per_ideal: Array) -> Array:
    """Return the (3,) place of a point seen by k cameras: by the lines of sight, then by least squares of pixels."""
    R, t = T_camera_world[:, :3, :3], T_camera_world[:, :3, 3]
    rows = ideal[..., None] * R[:, None, 2] - R[:, :2]
    known = t[:, :2] - ideal * t[:, None, 2]
    at, *_ = np.linalg.lstsq(rows.reshape(-1, 3), known.ravel(), rcond=None)
    for _ in range(_STEPS):
        x, y, z = np.moveaxis(at @ R.swapaxes(1, 2) + t, -1, 0)
        off = (px_per_ideal @ (np.stack([x / z, y / z], axis=-1) - ideal)[..., None])[..., 0]
        slope = (R[:, :2] - np.stack([x / z, y / z], axis=-1)[..., None] * R[:, None, 2]) / z[:, None, None]
        J = (px_per_ideal @ slope).reshape(-1, 3)
        step, *_ = np.linalg.lstsq(J, -off.ravel(), rcond=None)
        at = at + step
    return np.asarray(at)
