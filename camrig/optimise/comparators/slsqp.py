"""The paper's sequential quadratic programming (Zhang et al.): SciPy's SLSQP from one random start. Pure.

Our reimplementation; ``smoothing`` says what is assumed. Slopes are ours, compiled: the paper's are not published.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import fmin_slsqp

from camrig.geometry.arrays import Array
from camrig.optimise.comparators.common import Asked, Found, free_variables, random_rig
from camrig.optimise.comparators.smoothing import INSIDE, MM, MOST_ITERATIONS, STAGES, TOLERANCE, Stage, typical_m
from camrig.optimise.configuration import Task
from camrig.optimise.kernels.problem import Flags, Ints
from camrig.optimise.kernels.smoothed import smoothed

Evaluation = tuple[float, Array, Array, Array]
"""Value in mm, gradient, constraints (>= 0), their Jacobian."""


class _OutOfTimeError(Exception):
    """Ends SciPy's loop."""


def find(asked: Asked) -> Found:
    """Return the last iterate of the last stage."""
    problem = asked.task.problem
    start = random_rig(problem, asked.rng)
    free = free_variables(problem)
    if not free.any():
        return Found(start)
    column = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1).astype(np.int64)
    x = start[free]
    for stage in STAGES:
        if not asked.expired():
            x = _Smooth(asked, stage, start, free, column).solve(x)
    vectors = start.copy()
    vectors[free] = x
    return Found(vectors)


@dataclass(eq=False)
class _Smooth:
    """One stage: over all free variables together, and for the worst target one more."""

    asked: Asked
    stage: Stage
    start: Array
    free: Flags
    column: Ints
    _cache: tuple[bytes, Evaluation] | None = field(default=None, init=False)

    @property
    def task(self) -> Task:
        """What is minimised."""
        return self.asked.task

    def solve(self, x: Array) -> Array:
        """Return the joint variables that SLSQP reaches from others."""
        problem = self.task.problem
        bounds = list(zip(problem.low[self.free].tolist(), problem.high[self.free].tolist(), strict=True))
        start = x
        if self.task.worst:
            bounds.append(
                (0.0, MM * self.stage.unseen * typical_m(problem))
            )  # worse than what everybody knows is nothing
            start = np.append(x, MM * self._qualities(x)[0].max())
        iterates = [start]

        def remember(x: Array) -> None:
            iterates.append(x.copy())  # SciPy's own array goes on changing

        try:
            reached: Array = fmin_slsqp(
                self._value,
                start,
                fprime=self._gradient,
                f_ieqcons=self._constraints,
                fprime_ieqcons=self._constraint_slopes,
                bounds=bounds,
                iter=MOST_ITERATIONS,
                acc=TOLERANCE,
                iprint=0,
                callback=remember,
            )
        except _OutOfTimeError:
            reached = iterates[-1]
        return np.asarray(reached[: len(x)]) if np.isfinite(reached).all() else x

    def _value(self, x: Array) -> float:
        return self._evaluated(x)[0]

    def _gradient(self, x: Array) -> Array:
        return self._evaluated(x)[1]

    def _constraints(self, x: Array) -> Array:
        return self._evaluated(x)[2]

    def _constraint_slopes(self, x: Array) -> Array:
        return self._evaluated(x)[3]

    def _evaluated(self, x: Array) -> Evaluation:
        """Return everything at the joint variables; asked for four times at each place, computed once."""
        key = x.tobytes()
        if self._cache is None or self._cache[0] != key:
            if self.asked.expired():
                raise _OutOfTimeError
            self._cache = key, self._compute(x)
        return self._cache[1]

    def _qualities(self, x: Array) -> tuple[Array, Array, Array, Array]:
        problem = self.task.problem
        vectors, size = self.start.copy(), int(self.column.max()) + 1
        vectors[self.free] = x[:size]
        unseen_m = self.stage.unseen * typical_m(problem)
        return smoothed(problem, vectors, self.column, size, self.stage.sharpness, unseen_m)

    def _compute(self, x: Array) -> Evaluation:
        quality_m, slopes, view, view_slopes = self._qualities(x)
        inside = view - np.log(0.5) - INSIDE
        if not self.task.worst:
            share = self.task.weights / self.task.weights.sum()
            return MM * float(share @ quality_m), MM * (share @ slopes), inside, view_slopes
        count, size = slopes.shape
        wide = np.zeros((2 * count, size + 1))
        wide[:count, :size], wide[:count, size], wide[count:, :size] = -MM * slopes, 1.0, view_slopes
        return float(x[-1]), np.append(np.zeros(size), 1.0), np.concatenate([x[-1] - MM * quality_m, inside]), wide
