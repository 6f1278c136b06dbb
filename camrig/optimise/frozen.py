"""The smooth problem beside a configuration, for SLSQP: what each camera sees now it must go on seeing. Pure.

Values in mm, constraints dimensionless and >= 0. The worst target's problem is in epigraph form: one more variable,
which no target's quality may exceed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import fmin_slsqp

from camrig.geometry.arrays import Array
from camrig.optimise.configuration import Configuration, Task
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import Flags, Ints, X, Y
from camrig.optimise.kernels.sight import cone_cosine, sees
from camrig.optimise.kernels.smooth import active_edges, clearances, qualities

_EDGE_SHARE = 0.15
"""Edges of view farther away than this share of the view cannot become active within one polish."""

_INSIDE = 1e-9
"""How far inside its limits the smooth problem stays, so that the hard visibility agrees."""

_MM = 1e3

Evaluation = tuple[float, Array, Array, Array]
"""Value, gradient, constraints, their Jacobian."""


class _OutOfTime(Exception):  # noqa: N818 - the way out of a solver that cannot be asked to stop
    """The deadline has passed while SLSQP was at work."""


@dataclass(eq=False)
class FrozenProblem:
    """Over all free variables together; ``column`` (n, 6) is a variable's place among them, -1 for what is not free."""

    task: Task
    start: Configuration
    column: Ints
    seen: Flags
    edges: Ints
    pairs: tuple[tuple[int, int, float], ...]
    _cache: tuple[bytes, Evaluation] | None = field(default=None, init=False)

    @classmethod
    def at(cls, task: Task, start: Configuration) -> FrozenProblem:
        """Freeze who sees whom at a configuration."""
        problem = task.problem
        free = problem.low < problem.high
        column = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1).astype(np.int64)
        seen = start.seen()
        edges = active_edges(problem, start.vectors, seen, _anchors(task, start), _EDGE_SHARE)
        drones = np.flatnonzero(problem.separation_m >= 0.0)
        pairs = [
            (int(i), int(j), float(max(problem.separation_m[i], problem.separation_m[j])))
            for i, j in itertools.combinations(drones, 2)
        ]
        return cls(task, start, column, seen, edges, tuple(pair for pair in pairs if pair[2] > 0.0))

    @property
    def size(self) -> int:
        """The number of free variables; 0 too where nothing is seen."""
        return int(self.column.max(initial=-1)) + 1 if self.seen.any() else 0

    def vectors(self, x: Array) -> Array:
        """Return vectors (n, 6) from the joint variables, inside their bounds."""
        out = self.start.vectors.copy()
        free = self.column >= 0
        out[free] = x[: self.size]
        return np.clip(out, self.task.problem.low, self.task.problem.high)

    def variables(self) -> Array:
        """Return the joint variables at the start."""
        return self.start.vectors[self.column >= 0]

    def solve(self, most_iterations: int, accuracy: float, expired: Callable[[], bool]) -> Array | None:
        """Return the joint variables that SLSQP reaches from the start; None where time runs out on the way."""
        free = self.column >= 0
        problem = self.task.problem
        bounds = list(zip(problem.low[free].tolist(), problem.high[free].tolist(), strict=True))
        start = self.variables()
        if self.task.worst:
            highest = _MM * float(self.start.quality_m[self.seen.any(axis=0)].max())
            start, bounds = np.append(start, highest), [*bounds, (0.0, 2.0 * highest)]
        bound = self.task.worst or bool(self.pairs) or bool(len(self.edges))

        def value(x: Array) -> float:
            if expired():
                raise _OutOfTime
            return self.evaluate(x)[0]

        try:
            reached = fmin_slsqp(
                value,
                start,
                fprime=lambda x: self.evaluate(x)[1],
                f_ieqcons=(lambda x: self.evaluate(x)[2]) if bound else None,
                fprime_ieqcons=(lambda x: self.evaluate(x)[3]) if bound else None,
                bounds=bounds,
                iter=most_iterations,
                acc=accuracy,
                iprint=0,
            )
        except _OutOfTime:
            return None
        return np.asarray(reached)[: self.size]

    def evaluate(self, x: Array) -> Evaluation:
        """Return everything at the joint variables; asked for four times at each place, computed once."""
        key = x.tobytes()
        if self._cache is None or self._cache[0] != key:
            self._cache = key, self._compute(x)
        return self._cache[1]

    def _compute(self, x: Array) -> Evaluation:
        problem, size = self.task.problem, self.size
        vectors = self.vectors(x)
        quality_m, slopes = qualities(problem, vectors, self.seen, self.column, size)
        covered = self.seen.any(axis=0)
        clearance, clearance_slopes = clearances(problem, self.edges, vectors, self.column, size)
        gap, gap_slopes = self._gaps(vectors)
        kept = np.concatenate([clearance - _INSIDE, gap])
        kept_slopes = np.vstack([clearance_slopes, gap_slopes])
        if self.task.worst:
            below = x[-1] - _MM * quality_m[covered]
            wide = np.column_stack([np.vstack([-_MM * slopes[covered], kept_slopes]), np.zeros(len(below) + len(kept))])
            wide[: len(below), -1] = 1.0
            return float(x[-1]), np.append(np.zeros(size), 1.0), np.concatenate([below, kept]), wide
        share = np.where(covered, problem.weights, 0.0) / problem.weights[covered].sum()
        return _MM * float(quality_m @ share), _MM * (share @ slopes), kept, kept_slopes

    def _gaps(self, vectors: Array) -> tuple[Array, Array]:
        """Return by how much the squared distance of each pair of drones exceeds what it must be, and its slopes."""
        gaps, slopes = np.empty(len(self.pairs)), np.zeros((len(self.pairs), self.size))
        for row, (i, j, least_m) in enumerate(self.pairs):
            gap = vectors[i, : Y + 1] - vectors[j, : Y + 1]
            gaps[row] = gap @ gap - least_m**2 - _INSIDE
            for axis in (X, Y):
                for drone, sign in ((i, 2.0), (j, -2.0)):
                    if self.column[drone, axis] >= 0:
                        slopes[row, self.column[drone, axis]] = sign * gap[axis]
        return gaps, slopes


def _anchors(task: Task, start: Configuration) -> Flags:
    """Return the anchors (n, A) that a camera must go on seeing: those in view of who must see one."""
    problem = task.problem
    out = np.zeros((len(start.vectors), len(problem.anchors)), dtype=np.bool_)
    for i in np.flatnonzero(problem.needs_anchor):
        lens = lens_of(problem.cameras[i], problem.lenses, start.vectors[i])
        R, origin = pose_of(problem.cameras[i], start.vectors[i])
        cosine = cone_cosine(problem.settings, lens)
        out[i] = [sees(problem.settings, problem.boxes, lens, cosine, R, origin, anchor) for anchor in problem.anchors]
    return out
