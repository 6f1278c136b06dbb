"""Have every kernel compiled, for an environment in which nothing is to wait for it later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

COMPILE = """\
from camrig import detect, locate
from camrig.optimise import PlannerSettings, warm_up
detect.warm_up()
locate.warm_up()
warm_up(PlannerSettings(quality="fisher", visibility="image"))
"""
"""All of it, in one process."""

_OVER_THE_TAG = np.array([[0.0, 0.0, 2.5, 0.0, -1.0, 0.0], [0.5, 0.5, 1.5, 0.0, 0.0, 0.0]])
"""Where head and drone of the small scene see its tag."""


def compile_side_by_side() -> None:
    """Compile on two processors what takes longest; then the rest. Raises CalledProcessError."""
    programs = [f"from tests.kernels import {half.__name__}; {half.__name__}()" for half in (polish, all_but_polish)]
    halves = [subprocess.Popen([sys.executable, "-c", program], cwd=Path(__file__).parents[1]) for program in programs]
    codes = [half.wait() for half in halves]
    if any(codes):
        raise subprocess.CalledProcessError(max(codes), programs)
    subprocess.run([sys.executable, "-c", COMPILE], check=True)


def polish() -> None:
    """Have the planner's steps with exact curvature compiled."""
    from camrig.optimise import PlannerSettings
    from camrig.optimise.configuration import configuration, task_of
    from camrig.optimise.polish import sqp
    from camrig.optimise.problem import problem_of
    from camrig.optimise.warming_up import small_scene

    task = task_of(problem_of(small_scene(PlannerSettings(visibility="image"))), worst=False)
    sqp(task, configuration(task, _OVER_THE_TAG), lambda: False, rough=True)


def all_but_polish() -> None:
    """Have the cameras' and the estimate's kernels compiled, and what finds a plan's neighbourhood."""
    from camrig import detect, locate
    from camrig.optimise import PlannerSettings
    from camrig.optimise.configuration import configuration, task_of
    from camrig.optimise.polish import compass
    from camrig.optimise.problem import problem_of
    from camrig.optimise.search import table_of
    from camrig.optimise.warming_up import small_scene

    locate.warm_up()
    detect.warm_up()
    scene = small_scene(PlannerSettings(visibility="image"))
    task = task_of(problem_of(scene), worst=False)
    table = table_of(task, scene.cameras, None)
    compass(task, configuration(task, table.vectors[table.block[:, 0]]), lambda: False, table)
