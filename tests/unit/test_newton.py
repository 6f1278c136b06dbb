"""The joint polish against SciPy's SLSQP on the very same smooth problem."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import fmin_slsqp

from camrig.experiments.scenes import Mode, random_scene
from camrig.geometry.arrays import Array
from camrig.optimise import PlannerSettings
from camrig.optimise.configuration import Configuration, Task, configuration
from camrig.optimise.frozen import frozen
from camrig.optimise.kernels.frozen import Frozen, joint, kept_of, qualities_of, totals, values, with_joint
from camrig.optimise.kernels.newton import newton
from camrig.optimise.scene import Objective, Visibility
from camrig.optimise.search import Start, search, table_of
from tests.planner_scenes import task


def descended(mode: Mode, seed: int, settings: PlannerSettings) -> tuple[Task, Configuration]:
    """Where cameras go one after the other, each to its best candidate: no optimum of them all together."""
    scene = random_scene(mode, 3, 9, seed, settings)
    whole = task(scene)
    table = table_of(whole, scene.cameras)
    start = Start(np.full(3, -1), np.arange(3), np.full(3, -1.0), np.ones(9))
    return whole, configuration(whole, table.vectors[search(whole, table, start, 0.0, lambda: False)])


def by_slsqp(whole: Task, smooth: Frozen, here: Configuration) -> float:
    """The mean that SciPy reaches, in mm."""
    problem, size = whole.problem, int(smooth.column.max()) + 1
    low, high = joint(smooth, problem.low), joint(smooth, problem.high)

    def vectors(x: Array) -> Array:
        return with_joint(smooth, here.vectors, np.clip(x, low, high))

    def value(x: Array) -> float:
        return float(smooth.share @ values(problem, smooth, vectors(x))[0])

    def slopes(x: Array) -> Array:
        total, by = totals(problem, smooth, vectors(x))
        return np.asarray(smooth.share @ qualities_of(problem, total, by, smooth.share)[1])

    def kept(x: Array) -> Array:
        return np.asarray(values(problem, smooth, vectors(x))[1])

    def kept_slopes(x: Array) -> Array:
        return np.asarray(kept_of(problem, smooth, vectors(x), size)[1])

    bounds = list(zip(low.tolist(), high.tolist(), strict=True))
    reached = fmin_slsqp(
        value,
        joint(smooth, here.vectors),
        fprime=slopes,
        f_ieqcons=kept,
        fprime_ieqcons=kept_slopes,
        bounds=bounds,
        iter=200,
        acc=1e-10,
        iprint=0,
    )
    return value(np.asarray(reached))


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("mode", ["ptz", "drone"])
@pytest.mark.parametrize("seed", range(4))
def test_it_ends_where_slsqp_ends_or_lower_and_inside_all_limits(mode: Mode, visibility: Visibility, seed: int) -> None:
    whole, here = descended(mode, seed, PlannerSettings(visibility=visibility))
    smooth, vectors = frozen(whole, here), here.vectors.copy()
    iterations = newton(whole.problem, smooth, vectors, 60, 1e-9)
    assert iterations < 60
    quality_mm, inside = values(whole.problem, smooth, vectors)
    assert inside.min(initial=0.0) > -1e-9
    assert (vectors >= whole.problem.low).all()
    assert (vectors <= whole.problem.high).all()
    assert smooth.share @ quality_mm <= by_slsqp(whole, smooth, here) * (1.0 + 1e-6)


@pytest.mark.parametrize("objective", ["mean", "worst"])
@pytest.mark.parametrize("mode", ["ptz", "drone"])
def test_no_step_from_where_it_ends_is_better(mode: Mode, objective: Objective) -> None:
    whole, here = descended(mode, 5, PlannerSettings(visibility="cone", objective=objective))
    smooth, vectors = frozen(whole, here), here.vectors.copy()
    newton(whole.problem, smooth, vectors, 60, 1e-9)

    def height(at: Array) -> float:
        quality_mm, inside = values(whole.problem, smooth, at)
        within = (
            (at >= whole.problem.low).all() and (at <= whole.problem.high).all() and inside.min(initial=0.0) > -1e-9
        )
        value = quality_mm.max() if objective == "worst" else smooth.share @ quality_mm
        return float(value) if within else np.inf

    rng, best = np.random.default_rng(0), height(vectors)
    assert best <= height(here.vectors)
    around = joint(smooth, vectors)
    for length in (1e-2, 1e-3, 1e-4):
        for _ in range(500):
            step = rng.normal(size=len(around))
            tried = with_joint(smooth, vectors, around + length * step / np.linalg.norm(step))
            assert height(tried) > best - 1e-7
