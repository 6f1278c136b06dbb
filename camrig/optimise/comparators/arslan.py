"""Every target to its best camera, best response in turns, after Arslan, Min and Koditschek (ICRA 2018). Pure.

"Voronoi-based coverage control of pan/tilt/zoom camera networks"; our reimplementation. A camera at o with axis n and
half angle a rates a point at distance rho, in the direction u from it, by the product of

    q_per = (u.n - cos a) / (1 - cos a)     and     q_res = rho^L (R cos a - L (rho - R cos a)) / R^(L + 1),

which falls to zero at rho = (L + 1) / L R cos a. Every point belongs to the camera that rates it highest (the conic
Voronoi partition). With its cell fixed, a camera does best to look along the mean over the cell of w u, where
w = (rho / R)^L (cos a - L rho / ((L + 1) R)) times the point's weight: the sum of q is linear in n.

Assumed: the density is the targets' weights; L = 2; R such that the farthest target any camera may have is just within
reach; the cone's half angle under either visibility; the random start of ``common``; a step counts only if the sum of
all points' best ratings rises; 200 rounds at most. A camera with an empty cell stays, zooms and mounts stay in the
middle of what they may be. The law is about directions: drones take, in turns, the place of a grid at which that sum is
highest. Lenses, separation and boxes play no part.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import ALPHA
from camrig.optimise.comparators.common import Asked, Found, looking_at, middle, random_rig
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import PAN, TILT, Problem, Z

_L = 2
_REACH_SLACK = 1.05
_ROUNDS = 200
_STILL = 1e-6
_STEP_M = 0.25
_HEIGHTS = 5


def find(asked: Asked) -> Found:
    """Let the cameras answer each other until none moves."""
    problem = asked.task.problem
    vectors = middle(problem)
    started = random_rig(problem, asked.rng)
    heads, drones = problem.low[:, TILT] < problem.high[:, TILT], problem.separation_m >= 0.0
    vectors[heads, PAN : TILT + 1] = started[heads, PAN : TILT + 1]
    vectors[drones, : Z + 1] = started[drones, : Z + 1]
    room = _Room(problem, vectors)
    movable = np.flatnonzero(heads | drones)
    for _ in range(_ROUNDS):
        moved = 0.0
        for i in movable:
            if asked.expired():
                return Found(room.vectors)
            before = room.vectors[i].copy()
            room.answer(int(i), drone=bool(drones[i]))
            moved = max(moved, float(np.abs(room.vectors[i] - before).max()))
        if moved < _STILL:
            break
    return Found(room.vectors)


class _Room:
    """All cameras' vectors (n, 6) and what they rate every target, (n, m)."""

    def __init__(self, problem: Problem, vectors: Array) -> None:
        self.vectors = vectors
        self._problem = problem
        count = range(len(vectors))
        self._cos = np.cos([lens_of(problem.cameras[i], problem.lenses, vectors[i])[ALPHA] for i in count])
        # The farthest corner of where a camera may be counts: a drone's R must not change as it flies.
        ends = np.array([problem.low[:, : Z + 1], problem.high[:, : Z + 1]])
        ways = np.abs(problem.points[:, None, None] - ends).max(axis=1)
        farthest_m = _REACH_SLACK * float(np.linalg.norm(ways, axis=2).max())
        self._R = farthest_m * _L / ((_L + 1) * self._cos)
        self._grids: dict[int, Array] = {}
        self._q = np.array([self._ratings(i, *self._view(i, vectors[i])) for i in count])

    def _view(self, i: int, vector: Array) -> tuple[Array, Array]:
        """Return a camera's place and axis, (3,) each."""
        R, origin = pose_of(self._problem.cameras[i], vector)
        return origin, R[:, 2]

    def _ratings(self, i: int, origins: Array, axis: Array) -> Array:
        """Return q (..., m) of all targets from places (..., 3) along an axis (3,)."""
        u, rho = self._rays(origins)
        cos, R = self._cos[i], self._R[i]
        q_per = (u @ axis - cos) / (1.0 - cos)
        q_res = rho**_L * (R * cos - _L * (rho - R * cos)) / R ** (_L + 1)
        return np.asarray(q_per * q_res)

    def _rays(self, origins: Array) -> tuple[Array, Array]:
        rays = self._problem.points - origins[..., None, :]
        rho = np.linalg.norm(rays, axis=-1)
        return rays / np.maximum(rho, 1e-9)[..., None], rho

    def answer(self, i: int, *, drone: bool) -> None:
        """Let camera ``i`` answer the others; it moves only if the sum of the best ratings rises."""
        others = np.delete(self._q, i, axis=0).max(axis=0, initial=-np.inf)
        vector = self._best_place(i, others) if drone else self._best_axis(i, others)
        q = self._ratings(i, *self._view(i, vector))
        weights = self._problem.weights
        if weights @ np.maximum(others, q) > weights @ np.maximum(others, self._q[i]):
            self.vectors[i], self._q[i] = vector, q

    def _best_axis(self, i: int, others: Array) -> Array:
        cell = self._q[i] >= others
        origin, _ = self._view(i, self.vectors[i])
        u, rho = self._rays(origin)
        w = self._problem.weights * (rho / self._R[i]) ** _L
        w = w * (self._cos[i] - _L * rho / ((_L + 1) * self._R[i]))
        mean = w[cell] @ u[cell]
        if not mean.any():
            return np.asarray(self.vectors[i])
        return looking_at(self._problem, i, self.vectors[i], origin + mean)

    def _best_place(self, i: int, others: Array) -> Array:
        if i not in self._grids:
            self._grids[i] = _grid(self._problem, i)
        origin, axis = self._view(i, self.vectors[i])
        offset = origin - self.vectors[i, : Z + 1]
        sums = np.maximum(others, self._ratings(i, self._grids[i] + offset, axis)) @ self._problem.weights
        vector = self.vectors[i].copy()
        vector[: Z + 1] = self._grids[i][int(sums.argmax())]
        return np.asarray(vector)


def _grid(problem: Problem, i: int) -> Array:
    """Return places (K, 3) all over a drone's box."""
    low, high = problem.low[i, : Z + 1], problem.high[i, : Z + 1]
    counts = [*np.ceil((high - low)[:Z] / _STEP_M).astype(int) + 1, _HEIGHTS]
    axes = [np.linspace(a, b, count) for a, b, count in zip(low, high, counts, strict=True)]
    return np.asarray(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))
