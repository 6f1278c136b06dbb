"""The paper's interior-point solver (Zhang et al.): CasADi's IPOPT, exact Hessian, one random start. Pure.

Our reimplementation; ``smoothing`` says what is assumed. Building the graph is told apart from solving.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens_row import IS_FISHEYE
from camrig.optimise.comparators.common import Asked, Found, free_variables, random_rig
from camrig.optimise.comparators.graph import Graph, Symbol, graph_of
from camrig.optimise.comparators.smoothing import INSIDE, MM, MOST_ITERATIONS, STAGES, TOLERANCE, typical_m
from camrig.optimise.kernels.problem import FISHER

_QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "error_on_fail": False}


def find(asked: Asked) -> Found:
    """Return the last iterate of the last stage. Raises InputError where CasADi or a part of the model is missing."""
    problem = asked.task.problem
    if problem.quality == FISHER:
        raise InputError("solver 'ipopt' has no graph of quality 'fisher'; use pixel or perspective, or another solver")
    if (problem.lenses[:, IS_FISHEYE] > 0.0).any():
        raise InputError("solver 'ipopt' has no graph of a fisheye lens; use another solver")
    casadi = load_casadi()
    start = random_rig(problem, asked.rng)
    free = free_variables(problem)
    if not free.any():
        return Found(start)
    began_s = asked.now()
    smooth = _smooth(casadi, asked, graph_of(casadi, problem, start))
    alarm = _alarm(casadi, asked, smooth)  # held here: IPOPT does not keep it alive
    options = {**_QUIET, "ipopt.tol": TOLERANCE, "ipopt.max_iter": MOST_ITERATIONS, "iteration_callback": alarm}
    nlp = casadi.nlpsol("planner", "ipopt", smooth, options)
    build_s = asked.now() - began_s
    vectors = start.copy()
    vectors[free] = _solve(asked, nlp, start[free])
    return Found(vectors, build_s)


def load_casadi() -> ModuleType:
    """Return CasADi. Raises InputError where it is not installed."""
    try:
        return import_module("casadi")
    except ImportError as error:
        raise InputError("solver 'ipopt' needs CasADi: pip install 'camrig[ipopt]'") from error


def _smooth(casadi: ModuleType, asked: Asked, graph: Graph) -> dict[str, Symbol]:
    """Return the mean's problem, or the worst target's in epigraph form, by CasADi's names of its parts."""
    constraints = [view - math.log(0.5) - INSIDE for view in graph.view]
    variables = graph.variables
    if asked.task.worst:
        objective = casadi.SX.sym("highest")
        constraints += [objective - MM * quality_m for quality_m in graph.quality_m]
        variables = casadi.vertcat(variables, objective)
    else:
        share = asked.task.weights / asked.task.weights.sum()
        objective = MM * casadi.dot(casadi.DM(share), casadi.vertcat(*graph.quality_m))
    return {
        "x": variables,
        "p": casadi.vertcat(graph.sharpness, graph.unseen_m),
        "f": objective,
        "g": casadi.vertcat(*constraints),
    }


def _alarm(casadi: ModuleType, asked: Asked, smooth: Mapping[str, Symbol]) -> Symbol:
    """Return what ends IPOPT after an iteration when the time is up."""
    whose = {"x": "x", "lam_x": "x", "g": "g", "lam_g": "g", "f": "f"}
    sizes = {name: smooth[of].numel() for name, of in whose.items()}

    class Alarm(casadi.Callback):  # type: ignore[misc, name-defined]  # known only at run time
        def __init__(self) -> None:
            super().__init__()
            self.construct("alarm", {})

        def get_n_in(self) -> int:
            return int(casadi.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, at: int) -> str:
            return str(casadi.nlpsol_out(at))

        def get_sparsity_in(self, at: int) -> Symbol:
            return casadi.Sparsity.dense(sizes.get(casadi.nlpsol_out(at), 0), 1)

        def eval(self, _: object) -> list[int]:
            return [int(asked.expired())]

    return Alarm()


def _solve(asked: Asked, nlp: Symbol, start: Array) -> Array:
    """Return the joint variables (size,) that IPOPT reaches, stage by stage."""
    problem = asked.task.problem
    free, size = free_variables(problem), len(start)
    x, low, high = start, problem.low[free], problem.high[free]
    if asked.task.worst:  # one variable more, which begins where no quality is above it
        highest = MM * STAGES[0].unseen * typical_m(problem)
        x, low, high = np.append(x, highest), np.append(low, 0.0), np.append(high, math.inf)
    for stage in STAGES:
        if asked.expired():
            break
        parameters = [stage.sharpness, stage.unseen * typical_m(problem)]
        reached = nlp(x0=x, p=parameters, lbx=low, ubx=high, lbg=0.0, ubg=math.inf)
        x = np.array(reached["x"]).ravel()
    return x[:size] if np.isfinite(x).all() else start
