"""Directions worth looking in from one place, and the vectors of a head that looks so. Compiled."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.pose import pose_of
from camrig.optimise.kernels.problem import (
    ARM_R,
    BASE_R,
    CAMERA_R,
    HIGH,
    LOW,
    PAN,
    TILT,
    VARIABLES,
    ZOOM,
    Ints,
    Problem,
    X,
    Y,
    Z,
)

_ALMOST = 1.0 - 1e-9
_AROUND = 0.25
"""An axis may well point beside all targets, by this share of their extent."""
_CLUSTERS = np.array([3, 4, 6, 8, 10, 13, 16, 20])
_TINY = 1e-9


@compiled
def within(problem: Problem, i: int, vectors: Array) -> Array:
    """Return (K, 6) vectors inside the limits of camera ``i``: a pan by whole turns if that helps, then clamped."""
    out = vectors.copy()
    for k in range(len(out)):
        _bring_within(problem.cameras[i], out[k])
    return out


@compiled
def _bring_within(camera: Array, u: Array) -> None:
    low, high = camera[LOW + PAN], camera[HIGH + PAN]
    if not (low <= u[PAN] <= high):
        middle = (low + high) / 2.0
        u[PAN] = middle + (u[PAN] - middle + math.pi) % (2.0 * math.pi) - math.pi
    for variable in range(VARIABLES):
        u[variable] = min(max(u[variable], camera[LOW + variable]), camera[HIGH + variable])


@compiled
def head_vectors(problem: Problem, i: int, stands: Array, directions: Array, zoom: float) -> Array:
    """Return the (K, 6) vectors, inside the limits, of a head standing at (3,) whose optical axes best follow
    (K, 3) world directions.

    A camera that does not look along the mount's x is met by correcting the angles by what its axis misses.
    """
    camera = problem.cameras[i]
    vectors = np.zeros((len(directions), VARIABLES))
    ahead = _looks_ahead(camera)
    axis = np.empty(3)
    for k in range(len(directions)):
        u = vectors[k]
        u[X], u[Y], u[Z], u[ZOOM] = stands[X], stands[Y], stands[Z], zoom
        pan, tilt = _angles(camera, directions[k])
        u[PAN], u[TILT] = pan, tilt
        for _ in range(0 if ahead else 3):
            R, _origin = pose_of(camera, u)
            axis[0], axis[1], axis[2] = R[0, 2], R[1, 2], R[2, 2]
            pan_now, tilt_now = _angles(camera, axis)
            u[PAN] += (pan - pan_now + math.pi) % (2.0 * math.pi) - math.pi
            u[TILT] += tilt - tilt_now
        _bring_within(camera, u)
    return vectors


@compiled
def _looks_ahead(camera: Array) -> bool:
    off = abs(camera[CAMERA_R + 2] - 1.0) + abs(camera[CAMERA_R + 5]) + abs(camera[CAMERA_R + 8])
    for k in range(3):
        for h in range(3):
            off += abs(camera[ARM_R + 3 * k + h] - (1.0 if k == h else 0.0))
    return bool(off < 1e-12)


@compiled
def _angles(camera: Array, direction: Array) -> tuple[float, float]:
    """Return the pan and the tilt of a world direction, seen from the pan axis."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        x += direction[k] * camera[BASE_R + 3 * k]
        y += direction[k] * camera[BASE_R + 3 * k + 1]
        z += direction[k] * camera[BASE_R + 3 * k + 2]
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


@compiled
def directions_worth_a_look(
    points: Array, eye: Array, edges_rad: Array, first: Ints, second: Ints, clusters: int, steps: int
) -> Array:
    """Return (K, 3) directions from an eye (3,): to each point (m, 3); those that put a pair of points (first, second)
    on an edge of view, whose angles off the axis are given; to the middles of about so many clusters; to a grid of so
    many steps each way over the points' extent and beyond.
    """
    rays = np.empty(points.shape)
    for k in range(len(points)):
        rays[k] = _unit(points[k] - eye)
    middles = _cluster_middles(rays, clusters)
    count = len(rays)
    out = np.empty((count + 2 * len(first) * len(edges_rad) + len(middles) + steps * steps, 3))
    out[:count] = rays
    for edge_rad in edges_rad:
        for p in range(len(first)):
            count = _add_on_edge(rays[first[p]], rays[second[p]], edge_rad, out, count)
    out[count : count + len(middles)] = middles
    count += len(middles)
    out[count : count + steps * steps] = grid_directions(points, eye, steps)
    return out[: count + steps * steps].copy()


@compiled
def pairs_of(count: int) -> tuple[Ints, Ints]:
    """Return all pairs of ``count`` things: the numbers of the one and of the other."""
    first, second = np.empty((2, count * (count - 1) // 2), dtype=np.int64)
    at = 0
    for k in range(count):
        for h in range(k + 1, count):
            first[at], second[at] = k, h
            at += 1
    return first, second


@compiled
def _unit(vector: Array) -> Array:
    return vector / max(math.sqrt((vector * vector).sum()), _TINY)


@compiled
def _add_on_edge(u: Array, v: Array, edge_rad: float, out: Array, count: int) -> int:
    """Add the two axes that are ``edge_rad`` away from both directions, if there are any; return how many there are."""
    half = math.acos(min(max((u * v).sum(), -1.0), 1.0)) / 2.0
    if half >= edge_rad:
        return count
    middle, normal = _unit(u + v), _unit(np.cross(u, v))
    turn = _ALMOST * math.acos(min(max(math.cos(edge_rad) / math.cos(half), -1.0), 1.0))
    out[count] = math.cos(turn) * middle + math.sin(turn) * normal
    out[count + 1] = math.cos(turn) * middle - math.sin(turn) * normal
    return count + 2


@compiled
def _cluster_middles(rays: Array, most: int) -> Array:
    """Return the directions in the middle of each ray's nearest neighbours, three, four … of them: to see many."""
    centres = min(len(rays), max(1, most // 4))
    sizes = np.unique(np.minimum(_CLUSTERS, len(rays)))
    out = np.empty((centres * len(sizes), 3))
    at = 0
    for c in range(centres):
        middle = rays[c * (len(rays) - 1) // max(centres - 1, 1)]
        cosines = np.empty(len(rays))
        for k in range(len(rays)):
            cosines[k] = -(rays[k] * middle).sum()
        nearest = np.argsort(cosines)
        low, high = middle.copy(), middle.copy()
        for k in range(sizes[-1]):
            for axis in range(3):
                low[axis] = min(low[axis], rays[nearest[k], axis])
                high[axis] = max(high[axis], rays[nearest[k], axis])
            if (sizes == k + 1).any():
                out[at] = (low + high) / 2.0
                at += 1
    return out


@compiled
def grid_directions(points: Array, eye: Array, steps: int) -> Array:
    """Return directions (steps * steps, 3) to a grid over the points' extent and beyond, at their mean height."""
    out, low, high = np.empty((steps * steps, 3)), np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis], high[axis] = points[:, axis].min(), points[:, axis].max()
        beyond = _AROUND * (high[axis] - low[axis])
        low[axis], high[axis] = low[axis] - beyond, high[axis] + beyond
    height = points[:, Z].mean()
    for k in range(steps * steps):
        share_x, share_y = (k % steps) / max(steps - 1, 1), (k // steps) / max(steps - 1, 1)
        out[k, X] = low[X] + share_x * (high[X] - low[X]) - eye[X]
        out[k, Y] = low[Y] + share_y * (high[Y] - low[Y]) - eye[Y]
        out[k, Z] = height - eye[Z]
    return out
