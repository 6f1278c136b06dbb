"""All planners by name, on the same scene and judged by the same hard objective. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from camrig.messages import RigPlan
from camrig.optimise.answer import as_plan, nothing_to_do
from camrig.optimise.comparators import arslan, greedy, hold, ipopt, slsqp, swarm
from camrig.optimise.comparators.common import Asked, Found
from camrig.optimise.configuration import configuration, permitted, task_of
from camrig.optimise.planner import plan
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Scene

Solver = Literal["camrig", "slsqp", "ipopt", "swarm", "greedy", "arslan", "hold"]
SOLVERS: tuple[Solver, ...] = get_args(Solver)

_COMPARATORS: Mapping[str, Callable[[Asked], Found]] = {
    "slsqp": slsqp.find,
    "ipopt": ipopt.find,
    "swarm": swarm.find,
    "greedy": greedy.find,
    "arslan": arslan.find,
    "hold": hold.find,
}


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solver's plan; ``plan.solve_s`` leaves out ``build_s``, which is what preparing a solver took (IPOPT's graph).

    ``permitted``: drones are outside the keep-out boxes and apart, and whoever must see an anchor sees one. camrig's
    plans always are; those of slsqp, ipopt, arslan and hold, which know nothing of it, are told as they come.
    """

    plan: RigPlan
    build_s: float
    permitted: bool


def solve(
    name: Solver, scene: Scene, *, deadline_s: float = float("inf"), seed: int = 0, now: Callable[[], float]
) -> Solution:
    """Plan a scene from nothing. ``deadline_s``, on the clock ``now``, counts building too; then the best so far is it.

    Raises InputError for what a solver cannot do.
    """
    if name == "camrig":
        return Solution(plan(scene, deadline_s=deadline_s, seed=seed, now=now), 0.0, permitted=True)
    began_s = now()
    if not scene.cameras or not scene.targets:
        return Solution(nothing_to_do(scene, {}, now() - began_s), 0.0, permitted=True)
    task = task_of(problem_of(scene), worst=scene.settings.objective == "worst")
    asked = Asked(scene, task, np.random.default_rng(seed), now, began_s + deadline_s)
    found = _COMPARATORS[name](asked)
    problem = task.problem
    reached = configuration(task, np.clip(found.vectors, problem.low, problem.high))
    solve_s = now() - began_s - found.build_s
    answer = as_plan(scene, reached, {}, began_s, solve_s)
    return Solution(answer, found.build_s, permitted(problem, reached.vectors))
