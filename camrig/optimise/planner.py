"""Scene -> RigPlan: candidates, descent from many starts, polish; anytime, and deterministic for a seed. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from camrig.errors import InputError
from camrig.messages import Aim, PlanStatus, RigPlan
from camrig.optimise.answer import as_plan, nothing_to_do
from camrig.optimise.certificate import certified_infeasible
from camrig.optimise.check import check_aims
from camrig.optimise.configuration import Configuration, Task, configuration, permitted, task_of
from camrig.optimise.dealing import dealt
from camrig.optimise.hysteresis import Motion, settle
from camrig.optimise.kernels.aims import within
from camrig.optimise.kernels.descent import Table
from camrig.optimise.kernels.problem import Problem
from camrig.optimise.objective import better
from camrig.optimise.places import vector_of
from camrig.optimise.polish import compass, finish, kicked, quick_steps, sqp
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Scene, with_yaws
from camrig.optimise.search import Expired, Start, search, table_of
from camrig.optimise.widen import widened


class _Effort(NamedTuple):
    """How many greedy and random starts descend, how many of them are polished roughly and then well; how many kicks
    there are at most, and their rounds times cameras times pairs that can see each other.
    """

    greedy: int
    starts: int
    rough: int
    polished: int
    kicks: int
    kick_work: int


_PLAIN = _Effort(3, 10, 8, 4, 10, 1_250)
_HARD = _Effort(3, 16, 8, 8, 60, 1_500)
_HARDEST = _Effort(3, 24, 16, 16, 60, 15_000)
"""For the cone; for the image, whose edges make many more local optima; for the worst target, with more still: its cost
hardly tells a camera that does not see that target where to go, and a kick does.
"""
_LARGE = _Effort(1, 0, 1, 1, 0, 0)
"""For a rig in which hardly anybody shares a target: there, one start is nearly as good as many."""
_START_WORK = 1_200_000
"""Entries of all candidates' rows that the random starts together may look at in one sweep."""
_EMPHASIS = 0.3
"""Standard deviation of the logarithms of the weights that lead a random start somewhere else."""
_WIDENED_PAIRS = 500
"""Pairs that can see each other, up to which letting cameras see a target more is worth its time."""
STAYS_FREE = Motion()
_ADOPTED_SHARE = 0.025
"""A plan from elsewhere is followed instead of one from where the rig is if it is better by more than this share."""


def plan(
    scene: Scene,
    *,
    start: Mapping[str, Aim] | None = None,
    proposals: Sequence[Mapping[str, Aim]] = (),
    quick: bool = False,
    motion: Motion = STAYS_FREE,
    prove: bool = True,
    deadline_s: float = float("inf"),
    seed: int = 0,
    now: Callable[[], float],
) -> RigPlan:
    """Find where every camera should look or hover; never worse than ``start``, where that is a permitted rig.

    ``start`` holds the running aims by camera id. Where it has all of them, ``settings.gain`` decides whether moving
    is worth it, camera by camera; a camera that stays comes back with exactly its present aim. ``quick`` then looks
    about the running aims and ``proposals`` (aims found elsewhere) alone, unless that leaves a target unseen.
    ``deadline_s`` counts from the call, on the clock ``now``; when it has passed, the best so far is returned. Where
    there is no ``start``, targets left uncovered make it `infeasible` if ``prove`` and it is proven in time. Raises
    InputError where drones cannot keep apart, or a camera that must see an anchor sees none, and for a scene or an aim
    that no plan can be made of (optimise.check).
    """
    began_s = now()
    start = start or {}
    check_aims(start)
    scene = with_yaws(scene, start)
    if not scene.cameras or not scene.targets:
        return nothing_to_do(scene, start, now() - began_s)
    task = task_of(problem_of(scene), worst=scene.settings.objective == "worst")
    running = _running(task, scene, start)

    def expired() -> bool:
        return now() - began_s >= deadline_s

    best = None
    if quick and running is not None:
        best = _quick(task, running, [found for aims in proposals if (found := _running(task, scene, aims))], expired)
    if best is None or (best.score.uncovered > 0.0 and not expired()):
        best = _thorough(task, scene, best or running, np.random.default_rng(seed), expired)
    best = dealt(task, scene, start, best)
    if running is not None:
        best = settle(task, scene.cameras, running, best, scene.settings.gain, motion, expired)
    answer = as_plan(scene, best, start, began_s, now() - began_s)
    if prove and answer.uncovered and not start and certified_infeasible(task, expired):
        return replace(answer, status=PlanStatus.INFEASIBLE)
    return answer


def quality_at(scene: Scene, aims: Mapping[str, Aim]) -> RigPlan:
    """Evaluate a configuration as it is: the plan that moves nothing. Raises InputError for a missing or odd aim."""
    check_aims(aims)
    scene = with_yaws(scene, aims)
    if not scene.cameras or not scene.targets:
        return nothing_to_do(scene, aims, 0.0)
    task = task_of(problem_of(scene), worst=scene.settings.objective == "worst")
    vectors = [vector_of(camera, aims.get(camera.id)) for camera in scene.cameras]
    missing = [camera.id for camera, x in zip(scene.cameras, vectors, strict=True) if x is None]
    if missing:
        raise InputError(f"no aim is known for {', '.join(missing)}")
    return as_plan(scene, configuration(task, np.array(vectors)), aims, 0.0, 0.0)


def _running(task: Task, scene: Scene, aims: Mapping[str, Aim]) -> Configuration | None:
    """Return a configuration inside its limits; None where an aim is unknown or the rig is not permitted so."""
    vectors = []
    for i, camera in enumerate(scene.cameras):
        vector = vector_of(camera, aims.get(camera.id))
        if vector is None or not np.isfinite(vector).all():
            return None
        vectors.append(within(task.problem, i, vector[None])[0])
    known = np.array(vectors)
    return configuration(task, known) if permitted(task.problem, known) else None


def _quick(task: Task, running: Configuration, proposed: list[Configuration], expired: Expired) -> Configuration:
    """Return the best of what lies about the running configuration, or about a proposal that is clearly better."""
    steps = quick_steps(task)
    best = sqp(task, compass(task, running, expired, steps=steps), expired, rough=True)
    for other in proposed:
        if expired():
            break
        improved = sqp(task, compass(task, other, expired, steps=steps), expired, rough=True)
        if better(improved.score, best.score, _ADOPTED_SHARE):
            best = improved
    return best


def _thorough(
    task: Task, scene: Scene, running: Configuration | None, rng: np.random.Generator, expired: Expired
) -> Configuration:
    if running is not None and expired():
        return running
    table = table_of(task, scene.cameras, None if running is None else running.vectors)
    ranked = _ranked(_descended(task, table, running is not None, rng, expired))
    allowed = [found for found in ranked if permitted(task.problem, found.vectors)]
    if not allowed and running is None:
        raise InputError(_nowhere(task.problem, scene))
    polished = _polished(task, table, allowed, rng, expired)
    if task.worst and not expired():
        # The mean's optimum is often near that of the worst target, which has less to tell it where to go.
        mean = _polished(replace(task, worst=False), table, allowed, rng, expired)
        polished += [sqp(task, configuration(task, found.vectors), expired) for found in mean]
    best = running or allowed[0]
    for found in polished:
        if better(found.score, best.score) and permitted(task.problem, found.vectors):
            best = found
    if not expired() and not task.problem.cone and len(task.reachable) <= _WIDENED_PAIRS:
        best = widened(task, best, expired)
    return best if expired() or task.large else finish(task, best, table, expired)


def _polished(
    task: Task, table: Table, found: list[Configuration], rng: np.random.Generator, expired: Expired
) -> list[Configuration]:
    """Polish in two rounds, the dearer one for the few that came out best of the cheaper one."""
    if expired() or not found:
        return found[:1]
    effort = _effort(task)
    rough = _ranked([compass(task, each, expired) for each in found[: effort.rough]])
    rounds = min(effort.kicks, effort.kick_work // max(len(table.block) * len(task.reachable), 1))
    rough = [kicked(task, table, rough[0], rounds, rng, expired), *rough]
    return [sqp(task, each, expired, rough=True) for each in _ranked(rough)[: effort.polished]]


def _effort(task: Task) -> _Effort:
    if task.large:
        return _LARGE
    if task.worst:
        return _HARDEST
    return _PLAIN if task.problem.cone else _HARD


def _nowhere(problem: Problem, scene: Scene) -> str:
    if problem.needs_anchor.any():
        names = ", ".join(camera.id for camera in scene.cameras if camera.needs_anchor)
        return f"found no places from which {names} see an anchor; enlarge their limits or put up more anchors"
    return (
        "found no places for the drones outside the keep-out boxes and apart from each other; "
        "enlarge their boxes or lower min_separation_m"
    )


def _descended(
    task: Task, table: Table, has_present: bool, rng: np.random.Generator, expired: Expired
) -> list[Configuration]:
    """Return what descent reaches from the present rig, from greedy and from random starts."""
    found: list[Configuration] = []
    known: set[bytes] = set()
    reference_m = 0.0
    for k, start in enumerate(_starts(table, _effort(task), has_present, rng)):
        if found and expired():
            break
        # The worst target's cost needs a scale, which the first descent, for the mean, gives; and what is good for the
        # mean is often where the worst is best too, so every other start goes on that way.
        reached = search(task, table, start, reference_m if k % 2 else 0.0, expired)
        if reached.tobytes() in known:
            continue
        known.add(reached.tobytes())
        found.append(configuration(task, table.vectors[reached]))
        reference_m = reference_m or found[0].quality_m[np.isfinite(found[0].quality_m)].max(initial=0.0)
    return found


def _starts(table: Table, effort: _Effort, has_present: bool, rng: np.random.Generator) -> Iterator[Start]:
    count = len(table.block)
    entries = int((table.ends[table.block[:, 1]] - table.ends[table.block[:, 0]]).sum())
    randoms = min(effort.starts, _START_WORK // max(entries, 1))
    unset, greedy = np.full(count, -1, dtype=np.int64), np.full(count, -1.0)
    plain = np.ones(len(table.watch_ends) - 1)
    if has_present:
        yield Start(table.block[:, 0].copy(), np.arange(count), greedy, plain)
    for _ in range(effort.greedy):
        yield Start(unset, rng.permutation(count), greedy, plain)
    for k in range(randoms):
        # Descent mostly ends in the same few places; a polish may prefer what is best for slightly other weights.
        emphasis = np.exp(_EMPHASIS * rng.standard_normal(len(plain))) if k % 2 else plain
        yield Start(unset, rng.permutation(count), rng.uniform(size=count), emphasis)


def _ranked(found: list[Configuration]) -> list[Configuration]:
    """Return the configurations, best first, one of each worth: identical drones swapped are the same plan."""
    ordered = sorted(found, key=lambda each: (round(each.score.uncovered, 9), each.score.quality_m))
    distinct: list[Configuration] = []
    for each in ordered:
        if not distinct or better(distinct[-1].score, each.score, 1e-9):
            distinct.append(each)
    return distinct
