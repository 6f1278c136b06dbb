"""Vectors worth trying, from the geometry of the targets; the search picks one for each camera. Pure.

The paper's optimum mostly has two targets exactly on the edge of a field of view, so the axes that put two targets
there are candidates, for heads. For drones it is the points above targets, their pairs and triples, at the heights
at which they just fit, and a grid. A large scene takes fewer of each: ``effort`` bounds the vectors of one camera.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from camrig.geometry.airspace import inside_any
from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import ALPHA
from camrig.optimise.kernels.aims import directions_worth_a_look, grid_directions, head_vectors, pairs_of, within
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import MARGIN, PAN, POINT, VARIABLES, ZOOM, Ints, Problem, X, Y, Z
from camrig.optimise.kernels.vertex import vertices
from camrig.sensing.view import side_angles

_FLOOR_AIMS, _FLOOR_LOOKS = (81, 400), 4_000
"""Fewest and most aims at a grid on the floor; small scenes can afford to look at more of them."""
_SCAN_STEPS = 12
_HEIGHTS = 5
_STEP_M = 0.25
_MOST_STEPS = 24
_SCAN_STEP_M = 0.5
_SCAN_HEIGHTS = 2
_MOST_TRIPLES = 600
_MOST_PAIRS = 200
_MOST_VERTEX_PAIRS = 60
_MOST_MOUNTS = 48
_ALMOST = 1.0 - 1e-9
_YAWS = 4


def candidates(problem: Problem, i: int, reachable: Ints, effort: int) -> Array:
    """Return (K, 6) vectors inside the limits of camera ``i``; a camera with nothing free has one."""
    free = problem.low[i] < problem.high[i]
    points = problem.points[reachable]
    if problem.needs_anchor[i]:  # where no target takes it, an anchor must
        points = np.concatenate([points, problem.anchors[:, POINT : POINT + 3]])
    if not free.any() or not len(points):
        return np.asarray((problem.low[i] + problem.high[i]) / 2.0)[None]
    if problem.separation_m[i] >= 0.0:
        return _thinned(_drone_candidates(problem, i, points, effort), effort)
    if free[: Z + 1].any():
        return _mounted_candidates(problem, i, points, effort)
    stands = problem.low[i, : Z + 1]
    vectors = _thinned(_head_candidates(problem, i, stands, points, effort), effort)
    return np.concatenate([vectors, _vertices(problem, i, stands, reachable)])


def floor_views(problem: Problem, i: int) -> Array:
    """Return (K, 6) vectors spread evenly over what a camera can look at: for a scan of the targets' whole extent."""
    if problem.separation_m[i] >= 0.0:
        return _outside(problem, _box_grid(problem, i, _SCAN_STEP_M, _SCAN_HEIGHTS))
    stands = problem.low[i, : Z + 1]
    directions = grid_directions(problem.points, _eye(problem, i, stands), _SCAN_STEPS)
    return np.unique(head_vectors(problem, i, stands, directions, 0.0).round(6), axis=0)


def _thinned(vectors: Array, effort: int) -> Array:
    """Return at most ``effort`` of the vectors, evenly out of the whole list."""
    if len(vectors) <= effort:
        return vectors
    return np.asarray(vectors[np.linspace(0, len(vectors) - 1, effort).astype(int)])


def _head_candidates(problem: Problem, i: int, stands: Array, points: Array, effort: int) -> Array:
    first, second = _some_pairs(len(points), effort // 5)
    looks = _FLOOR_LOOKS // (len(problem.cameras) * len(points))
    steps = math.isqrt(int(np.clip(looks, min(_FLOOR_AIMS[0], effort // 4), _FLOOR_AIMS[1])))
    edges = np.array(_edges(problem, i, stands))
    eye = _eye(problem, i, stands)
    directions = directions_worth_a_look(points, eye, edges, first, second, effort // 4, max(steps, 3))
    zooms = np.linspace(0.0, problem.high[i, ZOOM], 1 + min(4, 2 * int(problem.high[i, ZOOM])))
    return np.concatenate([head_vectors(problem, i, stands, directions, float(zoom)) for zoom in zooms])


def _mounted_candidates(problem: Problem, i: int, points: Array, effort: int) -> Array:
    """Return aims from places all over the box in which the head may be mounted."""
    low, high = problem.low[i, : Z + 1], problem.high[i, : Z + 1]
    free = int((low < high).sum())
    steps = max(2, round(_MOST_MOUNTS ** (1.0 / free)))
    axes = [np.linspace(a, b, steps) if a < b else np.array([a]) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    each = max(24, 2 * effort // len(places))
    return np.concatenate([_thinned(_head_candidates(problem, i, place, points, each), each) for place in places])


def _some_pairs(count: int, most: int) -> tuple[Ints, Ints]:
    """Return the pairs of ``count`` things, thinned out evenly to ``most``."""
    if count * (count - 1) // 2 <= min(most, _MOST_PAIRS):
        return pairs_of(count)
    few = max(2, math.isqrt(2 * min(most, _MOST_PAIRS)))
    chosen = np.linspace(0, count - 1, min(few, count)).astype(np.int64)
    first, second = pairs_of(len(chosen))
    return chosen[first], chosen[second]


def _vertices(problem: Problem, i: int, stands: Array, reachable: Ints) -> Array:
    """Return the aims that put two targets on two sides of the picture; none where those are too many."""
    count = len(reachable) * (len(reachable) - 1) // 2
    if problem.cone or not count or len(problem.cameras) * count > _MOST_VERTEX_PAIRS:
        return np.zeros((0, VARIABLES))
    first, second = pairs_of(len(reachable))
    pairs = np.column_stack([reachable[first], reachable[second]])
    middles = problem.points[pairs].mean(axis=1) - _eye(problem, i, stands)
    return vertices(problem, i, head_vectors(problem, i, stands, middles, 0.0), pairs)


def _edges(problem: Problem, i: int, stands: Array) -> list[float]:
    """Return the angles off the axis at which a field of view ends: one of a cone, those of an image's sides."""
    vector = np.zeros(VARIABLES)
    vector[: Z + 1] = stands
    lens, margin_rad = lens_of(problem.cameras[i], problem.lenses, vector), float(problem.settings[MARGIN])
    if problem.cone:
        return [float(lens[ALPHA]) - margin_rad]
    return sorted({round(angle - margin_rad, 3) for angle in side_angles(lens) if angle > margin_rad})


def _drone_candidates(problem: Problem, i: int, points: Array, effort: int) -> Array:
    vector = ((problem.low[i] + problem.high[i]) / 2.0)[None]
    offset = _eye(problem, i, vector[0, : Z + 1]) - vector[0, : Z + 1]
    grid = _box_grid(problem, i, _STEP_M * max(1.0, math.sqrt(2500.0 / effort)), _HEIGHTS)[:, : Z + 1]
    centres, radii = _circles(_thinned(points[:, :2], max(3, math.isqrt(effort) // 2)))
    places = [grid]
    for edge_rad in _edges(problem, i, vector[0, : Z + 1]):
        heights = points[:, 2].mean() + radii / (math.tan(edge_rad) * _ALMOST)
        places.append(np.column_stack([centres, heights]) - offset)
    places.append(_columns(_thinned(points[:, :2], effort // 8), np.unique(grid[:, 2])) - offset)
    everywhere = np.concatenate(places)
    yaws = _yaws(problem, i)
    vectors = np.zeros((len(everywhere) * len(yaws), VARIABLES))
    vectors[:, : Z + 1] = np.repeat(everywhere, len(yaws), axis=0)
    vectors[:, PAN] = np.tile(yaws, len(everywhere))
    return _outside(problem, within(problem, i, vectors))


def _yaws(problem: Problem, i: int) -> Array:
    low, high = problem.low[i, PAN], problem.high[i, PAN]
    return np.linspace(low, high, _YAWS, endpoint=high - low < math.pi) if low < high else np.array([low])


def _outside(problem: Problem, vectors: Array) -> Array:
    """Return the drone's places outside the keep-out boxes; one inside where there are no others."""
    free = vectors[~inside_any(vectors[:, : Z + 1], [(low, high) for low, high in problem.boxes])]
    return free if len(free) else vectors[:1]


def _box_grid(problem: Problem, i: int, step_m: float, heights: int) -> Array:
    low, high = problem.low[i, : Z + 1], problem.high[i, : Z + 1]
    steps = np.clip(np.ceil((high - low)[:Z] / step_m).astype(int) + 1, 2, _MOST_STEPS)
    axes = [np.linspace(low[axis], high[axis], steps[axis]) for axis in (X, Y)]
    places = np.stack(np.meshgrid(*axes, np.linspace(low[Z], high[Z], heights)), axis=-1).reshape(-1, 3)
    vectors = np.zeros((len(places), VARIABLES))
    vectors[:, : Z + 1], vectors[:, PAN] = places, (problem.low[i, PAN] + problem.high[i, PAN]) / 2.0
    return vectors


def _eye(problem: Problem, i: int, stands: Array) -> Array:
    """Return about where the camera is (axis offsets apart), whatever it looks at."""
    vector = (problem.low[i] + problem.high[i]) / 2.0
    vector[: Z + 1] = stands
    return pose_of(problem.cameras[i], vector)[1]


def _columns(xy: Array, heights: Array) -> Array:
    return np.column_stack([np.repeat(xy, len(heights), axis=0), np.tile(heights, len(xy))])


def _circles(xy: Array) -> tuple[Array, Array]:
    """Return centres (C, 2) and radii of the circles on pairs and through triples of (m, 2) points."""
    first, second = pairs_of(len(xy))
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
