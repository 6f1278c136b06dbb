"""Scene -> RigPlan: candidates, descent from many starts, polish; anytime, and deterministic for a seed. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.assignment import least_travel
from camrig.messages import Aim, PlanStatus, RigPlan, TargetQuality
from camrig.optimise.candidates import candidates, useful
from camrig.optimise.configuration import Configuration, configuration, permitted, separations
from camrig.optimise.hysteresis import settle
from camrig.optimise.objective import better, scores
from camrig.optimise.places import aim_of, vector_of, within
from camrig.optimise.polish import Expired, polish
from camrig.optimise.scene import DronePlace, Scene, SceneCamera, with_yaws
from camrig.optimise.search import Table, descend, greedy_start, random_start, totals
from camrig.optimise.sight import Indices, Problem, problem_of

_GREEDY_STARTS = 4
_RANDOM_STARTS = (16, 64)
_START_WORK = 2_000_000
"""Gains looked at in one sweep of all starts: small scenes can afford more starts."""

_POLISHED = 3
_HOPELESS_SHARE = 0.25
"""Polishing gains less than this: a start that is worse by more than this cannot win."""
_SAME_SHARE = 0.005


def plan(
    scene: Scene,
    *,
    start: Mapping[str, Aim] | None = None,
    deadline_s: float = float("inf"),
    seed: int = 0,
    now: Callable[[], float],
) -> RigPlan:
    """Find where every camera should look or hover; never worse than ``start``, where that is a permitted rig.

    ``start`` holds the running aims by camera id. Where it has all of them, ``settings.gain`` decides whether moving
    is worth it, camera by camera; a camera that stays comes back with exactly its present aim. ``deadline_s`` counts
    from the call, on the clock ``now``; when it has passed, the best so far is returned. Raises InputError where
    drones cannot keep apart.
    """
    began_s = now()
    scene = with_yaws(scene, start or {})
    problem = problem_of(scene)
    if not scene.cameras or not scene.targets:
        return _nothing_to_do(scene, start or {}, now() - began_s)
    running = _running(problem, start or {})
    best = _best(problem, running, np.random.default_rng(seed), lambda: now() - began_s >= deadline_s)
    best = _least_travel(problem, start or {}, best)
    if running is not None:
        best = settle(problem, running, best, scene.settings.gain)
    return _as_plan(scene, best, start or {}, began_s, now() - began_s)


def quality_at(scene: Scene, aims: Mapping[str, Aim]) -> RigPlan:
    """Evaluate a configuration as it is: the plan that moves nothing. Raises InputError for a missing aim."""
    scene = with_yaws(scene, aims)
    problem = problem_of(scene)
    vectors = [vector_of(camera.place, aims.get(camera.id)) for camera in scene.cameras]
    missing = [camera.id for camera, x in zip(scene.cameras, vectors, strict=True) if x is None]
    if missing:
        raise InputError(f"no aim is known for {', '.join(missing)}")
    return _as_plan(scene, configuration(problem, tuple(x for x in vectors if x is not None)), aims, 0.0, 0.0)


def _running(problem: Problem, start: Mapping[str, Aim]) -> Configuration | None:
    """Return the running configuration inside its limits; None where an aim is unknown or drones are not permitted."""
    vectors = [vector_of(camera.place, start.get(camera.id)) for camera in problem.cameras]
    known = [
        within(camera.place, x[None])[0] for camera, x in zip(problem.cameras, vectors, strict=True) if x is not None
    ]
    if len(known) < len(vectors) or not permitted(problem, separations(problem), tuple(known)):
        return None
    return configuration(problem, tuple(known))


def _best(problem: Problem, running: Configuration | None, rng: np.random.Generator, expired: Expired) -> Configuration:
    if running is not None and expired():
        return running
    table = _table(problem, running)
    ranked = _ranked(table, descend(table, _starts(table, running, rng), expired))
    found = [tuple(x[i] for x, i in zip(table.vectors, chosen, strict=True)) for chosen in ranked]
    allowed = [vectors for vectors in found if permitted(problem, table.separation_m, vectors)]
    if not allowed and running is None:
        raise InputError(
            "found no places for the drones outside the keep-out boxes and apart from each other; "
            "enlarge their boxes or lower min_separation_m"
        )
    best = running
    for vectors in allowed[:_POLISHED]:
        proposal = configuration(problem, vectors)
        if best is not None and better(best.score, proposal.score, _HOPELESS_SHARE):
            break
        if not expired():
            proposal = polish(problem, table.separation_m, proposal, expired)
        if best is None or better(proposal.score, best.score):
            best = proposal
        if expired():
            break
    if best is None:
        raise AssertionError("there is a running configuration or an allowed one")
    return best


def _least_travel(problem: Problem, start: Mapping[str, Aim], found: Configuration) -> Configuration:
    """Deal the places of identical drones out so that all together they fly least from where they are.

    Drones of one kind may differ in yaw, and then in what they see from one place: it must hardly matter.
    """
    kinds: dict[object, list[int]] = {}
    for i, camera in enumerate(problem.cameras):
        if isinstance(camera.place, DronePlace) and vector_of(camera.place, start.get(camera.id)) is not None:
            kinds.setdefault(_kind(camera), []).append(i)
    order = np.arange(len(problem.cameras))
    for group in kinds.values():
        present = [vector_of(problem.cameras[i].place, start[problem.cameras[i].id]) for i in group]
        positions = np.array([x for x in present if x is not None])
        order[group] = np.array(group)[least_travel(positions, np.array([found.vectors[i] for i in group]))]
    if np.array_equal(order, np.arange(len(order))):
        return found
    dealt = configuration(problem, tuple(found.vectors[i] for i in order))
    return found if better(found.score, dealt.score, _SAME_SHARE) else dealt


def _table(problem: Problem, running: Configuration | None) -> Table:
    """Return the candidates of all cameras; that of a running rig is each camera's candidate 0."""
    shared: dict[object, tuple[Array, Array]] = {}
    vectors: list[Array] = []
    table: list[Array] = []
    for i, camera in enumerate(problem.cameras):
        key = _kind(camera), camera.place.yaw_rad if isinstance(camera.place, DronePlace) else 0.0
        if key not in shared:
            shared[key] = useful(problem, camera, candidates(problem, camera))
        x, gain = shared[key]
        if running is not None:
            x, gain = np.vstack([running.vectors[i][None], x]), np.vstack([running.gains[i][None], gain])
        vectors.append(x)
        table.append(gain)
    return Table(tuple(vectors), tuple(table), problem.targets.weights, separations(problem))


def _kind(camera: SceneCamera) -> object:
    """Return what identical drones share; every other camera is of its own kind."""
    place = camera.place
    if not isinstance(place, DronePlace):
        return camera.id
    # A lens is a frozen dataclass: its repr is all it is.
    return (
        repr(camera.lens),
        camera.alpha_rad,
        place.min_separation_m,
        place.box_m,
        place.T_body_camera.tobytes(),
    )


def _starts(table: Table, running: Configuration | None, rng: np.random.Generator) -> Indices:
    n = len(table.gains)
    starts = [greedy_start(table, rng.permutation(n)) for _ in range(_GREEDY_STARTS)]
    work = sum(gain.size for gain in table.gains)
    fewest, most = _RANDOM_STARTS
    count = fewest if running is not None else int(np.clip(_START_WORK // max(work, 1), fewest, most))
    starts += [random_start(table, rng) for _ in range(count)]
    if running is not None:
        starts.insert(0, np.zeros(n, dtype=np.intp))
    return np.array(starts)


def _ranked(table: Table, chosen: Indices) -> Indices:
    """Return the choices, best first, one of each worth: identical drones swapped are the same plan."""
    uncovered, mean = scores(totals(table, chosen), table.weights)
    _, first = np.unique(np.column_stack([uncovered, mean]).round(9), axis=0, return_index=True)
    order = first[np.lexsort((mean[first], uncovered[first]))]
    return np.asarray(chosen[order])


def _nothing_to_do(scene: Scene, start: Mapping[str, Aim], solve_s: float) -> RigPlan:
    """Return the plan that leaves the rig as it is: there is nothing to see, or nothing to see it with."""
    names = tuple(target.id for target in scene.targets)
    return RigPlan(
        request_id=0,
        stamp_s=0.0,
        status=PlanStatus.PARTIAL if names else PlanStatus.OPTIMISED,
        objective_m=None,
        aims={camera.id: start[camera.id] for camera in scene.cameras if camera.id in start},
        targets={name: TargetQuality(None, ()) for name in names},
        uncovered=names,
        solve_s=solve_s,
    )


def _as_plan(scene: Scene, found: Configuration, start: Mapping[str, Aim], stamp_s: float, solve_s: float) -> RigPlan:
    total = found.gains.sum(axis=0)
    targets = {
        target.id: TargetQuality(
            1.0 / float(total[j]) if total[j] > 0.0 else None,
            tuple(camera.id for i, camera in enumerate(scene.cameras) if found.gains[i, j] > 0.0),
        )
        for j, target in enumerate(scene.targets)
    }
    uncovered = tuple(name for name, quality in targets.items() if quality.quality_m is None)
    return RigPlan(
        request_id=0,
        stamp_s=stamp_s,
        status=PlanStatus.PARTIAL if uncovered else PlanStatus.OPTIMISED,
        objective_m=found.score.mean_m if len(uncovered) < len(targets) else None,
        aims=_aims(scene, found, start),
        targets=targets,
        uncovered=uncovered,
        solve_s=solve_s,
    )


def _aims(scene: Scene, found: Configuration, start: Mapping[str, Aim]) -> dict[str, Aim]:
    aims: dict[str, Aim] = {}
    for camera, vector in zip(scene.cameras, found.vectors, strict=True):
        present = vector_of(camera.place, start.get(camera.id))
        stays = present is not None and np.array_equal(present, vector)
        aim = start.get(camera.id) if stays else aim_of(camera.place, vector)
        if aim is not None:
            aims[camera.id] = aim
    return aims
