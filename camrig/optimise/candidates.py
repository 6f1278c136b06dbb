"""Poses worth trying, from the geometry of the targets; the search picks one for each camera. Pure.

The paper's optimum mostly has two targets exactly on the edge of a field of view, so the axes that put two targets
there are candidates, for heads. For drones it is the points above targets, their pairs and triples, at the heights
at which they just fit, and a grid.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from camrig.geometry.airspace import inside_any
from camrig.geometry.arrays import Array
from camrig.optimise.places import bounds, camera_poses, head_vectors, within
from camrig.optimise.scene import DronePlace, FixedPlace, HeadPlace, SceneCamera
from camrig.optimise.sight import Problem, alpha_rad, gains

_FLOOR_STEPS = 12
_HEIGHTS = 5
_STEP_M = 0.25
_MOST_STEPS = 24
_SCAN_STEP_M = 0.5
_SCAN_HEIGHTS = 2
_MOST_TRIPLES = 600
_ALMOST = 1.0 - 1e-9


def candidates(problem: Problem, camera: SceneCamera) -> Array:
    """Return (K, d) vectors inside the camera's limits, K >= 1; a drone's keep out of the keep-out boxes."""
    match camera.place:
        case HeadPlace() as place:
            return _head_candidates(problem, camera, place)
        case DronePlace() as place:
            return _drone_candidates(problem, camera, place)
        case FixedPlace():
            return np.zeros((1, 0))


def floor_views(problem: Problem, camera: SceneCamera) -> Array:
    """Return (K, d) vectors spread evenly over what a camera can look at: for a scan of the targets' whole extent."""
    match camera.place:
        case HeadPlace() as place:
            origin = _nominal_position(place)
            return np.unique(head_vectors(place, _towards_floor(problem.targets.points_m, origin)).round(6), axis=0)
        case DronePlace() as place:
            return _outside(problem, _box_grid(place, _SCAN_STEP_M, _SCAN_HEIGHTS))
        case FixedPlace():
            return np.zeros((1, 0))


def useful(problem: Problem, camera: SceneCamera, vectors: Array) -> tuple[Array, Array]:
    """Return the vectors that see anything, and their (K, m) gains; where none does, the first alone."""
    table = gains(problem, camera, vectors)
    rows = np.flatnonzero(table.any(axis=1))
    rows = rows if rows.size else np.array([0])
    return vectors[rows], table[rows]


def _head_candidates(problem: Problem, camera: SceneCamera, place: HeadPlace) -> Array:
    origin = _nominal_position(place)
    rays = problem.targets.points_m - origin
    u = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    first, second = np.triu_indices(len(u), k=1)
    directions = [u]
    if first.size:
        middles, normals, half = _pairs(u[first], u[second])
        directions.append(middles)
        for edge_rad in _edges(problem, camera):
            reach = np.arccos(np.clip(math.cos(edge_rad) / np.cos(half), -1.0, 1.0))
            fits = half < edge_rad
            for share in (_ALMOST, 0.5):
                turn = (reach * share)[fits, None]
                across = np.sin(turn) * normals[fits]
                directions += [np.cos(turn) * middles[fits] + across, np.cos(turn) * middles[fits] - across]
    directions.append(_towards_floor(problem.targets.points_m, origin))
    return head_vectors(place, np.concatenate(directions))


def _pairs(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return the middles, the normals and half the angle of pairs of unit directions (P, 3)."""
    middles, normals = u + v, np.cross(u, v)
    middles /= np.maximum(np.linalg.norm(middles, axis=1, keepdims=True), 1e-9)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return middles, normals, np.arccos(np.clip((u * v).sum(axis=1), -1.0, 1.0)) / 2.0


def _edges(problem: Problem, camera: SceneCamera) -> list[float]:
    """Return the angles off the axis at which a field of view ends: one of a cone, those of an image's sides."""
    margin_rad = problem.settings.margin_rad
    if problem.settings.visibility == "cone":
        return [alpha_rad(camera) - margin_rad]
    (width, height), (cx, cy) = camera.lens.size_px, camera.lens.centre_px
    sides = camera.lens.unproject(np.array([[0.0, cy], [width, cy], [cx, 0.0], [cx, height]]))
    angles = np.arctan(np.nan_to_num(np.linalg.norm(sides, axis=1), nan=camera.lens.r_max)) - margin_rad
    return sorted({round(float(angle), 3) for angle in angles if angle > 0.0})


def _towards_floor(points_m: Array, origin: Array) -> Array:
    """Return directions from ``origin`` to a grid over the targets' extent, at their mean height."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    x, y = np.meshgrid(np.linspace(low[0], high[0], _FLOOR_STEPS), np.linspace(low[1], high[1], _FLOOR_STEPS))
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, points_m[:, 2].mean())])
    return np.asarray(grid - origin)


def _drone_candidates(problem: Problem, camera: SceneCamera, place: DronePlace) -> Array:
    ground = problem.targets.points_m
    offset = camera_poses(place, np.zeros((1, 3)))[1][0]
    slopes = [math.tan(edge_rad) for edge_rad in _edges(problem, camera)]
    grid = _box_grid(place, _STEP_M, _HEIGHTS)
    centres, radii = _circles(ground[:, :2])
    above = [grid]
    for slope in slopes:
        z = ground[:, 2].mean() + radii / (slope * _ALMOST)
        above.append(np.column_stack([centres, z]) - offset)
    above.append(_columns(ground[:, :2], np.unique(grid[:, 2])) - offset)
    return _outside(problem, within(place, np.concatenate(above)))


def _outside(problem: Problem, vectors: Array) -> Array:
    """Return the drone's places outside the keep-out boxes; one inside where there are no others."""
    free = vectors[~inside_any(vectors, problem.keep_out_m)]
    return free if len(free) else vectors[:1]


def _box_grid(place: DronePlace, step_m: float, heights: int) -> Array:
    low, high = bounds(place)
    steps = np.clip(np.ceil((high - low)[:2] / step_m).astype(int) + 1, 2, _MOST_STEPS)
    axes = [np.linspace(low[i], high[i], steps[i]) for i in range(2)]
    return np.stack(np.meshgrid(*axes, np.linspace(low[2], high[2], heights)), axis=-1).reshape(-1, 3)


def _nominal_position(place: HeadPlace) -> Array:
    """Return where the camera is, axis offsets apart, whatever it looks at."""
    low, high = bounds(place)
    return np.asarray(camera_poses(place, ((low + high) / 2.0)[None])[1][0])


def _columns(xy: Array, heights: Array) -> Array:
    return np.column_stack([np.repeat(xy, len(heights), axis=0), np.tile(heights, len(xy))])


def _circles(xy: Array) -> tuple[Array, Array]:
    """Return centres (C, 2) and radii of the circles on pairs and through triples of (m, 2) points."""
    first, second = np.triu_indices(len(xy), k=1)
    centres = [(xy[first] + xy[second]) / 2.0]
    radii = [np.linalg.norm(xy[first] - xy[second], axis=1) / 2.0]
    triples = np.array(list(itertools.islice(itertools.combinations(range(len(xy)), 3), _MOST_TRIPLES)), dtype=int)
    if triples.size:
        a = xy[triples[:, 0]]
        b, c = xy[triples[:, 1]] - a, xy[triples[:, 2]] - a
        cross = 2.0 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
        ok = np.abs(cross) > 1e-9
        a, b, c, cross = a[ok], b[ok], c[ok], cross[ok]
        bb, cc = (b * b).sum(axis=1), (c * c).sum(axis=1)
        centre = np.column_stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb]) / cross[:, None]
        centres.append(a + centre)
        radii.append(np.linalg.norm(centre, axis=1))
    return np.concatenate(centres), np.concatenate(radii)
