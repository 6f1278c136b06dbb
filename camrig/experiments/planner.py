"""Every solver on the same random scenes: what each finds and how long it takes.

Solvers take turns scene by scene, each time another one first, so that a machine that grows slower does so for all.
Each has an untimed call for every mode and size, on a scene that does not count: compiling is nobody's time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import get_args

from camrig.errors import InputError
from camrig.experiments import best_known
from camrig.experiments.best_known import Task, worth
from camrig.experiments.scenes import Mode, Place, random_scene
from camrig.messages import RigPlan
from camrig.optimise import PlannerSettings, Scene
from camrig.optimise.scene import Objective, Quality, Visibility
from camrig.optimise.solvers import SOLVERS, Solver, solve

Clock = Callable[[], float]
Worth = tuple[int, float]
"""Targets that nobody sees, then the objective in metres: less is better."""

MODES: tuple[Mode, ...] = get_args(Mode)
SIZES = ((3, 3), (3, 9), (5, 10), (5, 20), (7, 20))
BEST_KNOWN = "best known"
SAME = 1e-6
"""The share within which two objectives count as equally good."""

_TAG_SIZE_M = 0.15
"""Of every target under ``fisher``, which has no quality of a bare point."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """Seconds of the wall, and seconds of processor time of the whole process."""

    wall_s: Clock
    cpu_s: Clock


@dataclass(frozen=True, slots=True)
class Setup:
    """What is run: ``runs`` scenes of every mode and size (cameras, targets), seeds from ``seed`` on."""

    sizes: tuple[tuple[int, int], ...] = SIZES
    modes: tuple[Mode, ...] = MODES
    runs: int = 10
    seed: int = 0
    solvers: tuple[Solver, ...] = SOLVERS
    visibility: Visibility = "cone"
    objective: Objective = "mean"
    quality: Quality = "pixel"

    @property
    def scenes(self) -> int:
        """How many scenes that makes."""
        return len(self.sizes) * len(self.modes) * self.runs


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a solver found. ``solve_s`` (wall) and ``cpu_s`` leave out ``build_s``, the preparation (IPOPT's graph)."""

    plan: RigPlan
    solve_s: float
    cpu_s: float
    build_s: float
    permitted: bool

    @property
    def worth(self) -> Worth:
        """What it is compared by."""
        return worth(self.plan)


@dataclass(frozen=True, slots=True, eq=False)
class SceneRun:
    """All solvers' answers for one scene, and the best that is known of it, with whose it is."""

    place: Place
    scene: Scene
    answers: Mapping[Solver, Answer]
    best: Worth
    best_from: str

    def gap(self, solver: Solver) -> float | None:
        """Return the share by which a solver's objective is above the best; None where it covers less than that."""
        answer = self.answers[solver]
        uncovered, objective_m = answer.worth
        if not answer.permitted or uncovered > self.best[0]:
            return None
        return objective_m / self.best[1] - 1.0 if objective_m > self.best[1] else 0.0


def able(setup: Setup) -> tuple[Setup, dict[Solver, str]]:
    """Return the setup with the solvers that can do it, and why each of the others cannot."""
    tiny = replace(setup, sizes=((1, 1),), modes=setup.modes[:1])
    scene, left_out = _scene(tiny, Place(tiny.modes[0], 1, 1, setup.seed)), {}
    for solver in setup.solvers:
        try:
            solve(solver, scene, now=lambda: 0.0)
        except InputError as error:
            left_out[solver] = str(error)
    return replace(setup, solvers=tuple(each for each in setup.solvers if each not in left_out)), left_out


def run(setup: Setup, clocks: Clocks) -> Iterator[SceneRun]:
    """Yield scene after scene, solved by all."""
    known = best_known.load()
    for mode in setup.modes:
        for cameras, targets in setup.sizes:
            warming = _scene(setup, Place(mode, cameras, targets, setup.seed + setup.runs))
            for solver in setup.solvers:
                solve(solver, warming, now=clocks.wall_s)
            for turn in range(setup.runs):
                yield _scene_run(setup, Place(mode, cameras, targets, setup.seed + turn), turn, clocks, known)


def _scene(setup: Setup, place: Place) -> Scene:
    settings = PlannerSettings(quality=setup.quality, visibility=setup.visibility, objective=setup.objective)
    tag_size_m = _TAG_SIZE_M if setup.quality == "fisher" else None
    return random_scene(place.mode, place.cameras, place.targets, place.seed, settings, tag_size_m)


def _scene_run(setup: Setup, place: Place, turn: int, clocks: Clocks, known: Mapping[str, Worth]) -> SceneRun:
    scene = _scene(setup, place)
    first = turn % len(setup.solvers)
    order = setup.solvers[first:] + setup.solvers[:first]
    found = {solver: _answer(solver, scene, place.seed, clocks) for solver in order}
    answers = {solver: found[solver] for solver in setup.solvers}
    candidates: dict[str, Worth] = {name: answer.worth for name, answer in answers.items() if answer.permitted}
    key = _key(setup, place)
    if key in known:
        candidates[BEST_KNOWN] = known[key]
    best_from = min(candidates, key=lambda name: candidates[name], default="nobody")
    return SceneRun(place, scene, answers, candidates.get(best_from, (len(scene.targets), float("inf"))), best_from)


def _answer(solver: Solver, scene: Scene, seed: int, clocks: Clocks) -> Answer:
    wall_s, cpu_s = clocks.wall_s(), clocks.cpu_s()
    solution = solve(solver, scene, seed=seed, now=clocks.wall_s)
    wall_s, cpu_s = clocks.wall_s() - wall_s, clocks.cpu_s() - cpu_s
    solve_s = solution.plan.solve_s
    # The processor is read around the call; building and proving are taken to have their share of it as of the wall.
    share = solve_s / wall_s if wall_s > 0.0 else 1.0
    return Answer(solution.plan, solve_s, cpu_s * share, solution.build_s, solution.permitted)


def _key(setup: Setup, place: Place) -> str:
    """Return a scene's name among the best known; empty where nobody searches such scenes."""
    for variant in best_known.VARIANTS:
        if setup.quality == "pixel" and variant == f"{setup.visibility} {setup.objective}":
            return Task(variant, place.mode, place.cameras, place.targets, place.seed).key
    return ""
