"""A scan: few stops of all cameras together that show every floor cell the rig can reach. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from camrig.geometry.airspace import inside_any
from camrig.geometry.arrays import Array
from camrig.messages import Aim, DroneAim, HeadAim, PlanRequest, ScanPlan, ScanRequest
from camrig.optimise.candidates import floor_views
from camrig.optimise.kernels.problem import Flags, Problem
from camrig.optimise.kernels.table import rows_of
from camrig.optimise.places import aim_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import FixedPlace, PlannerSettings, Scene, SceneTarget, scene_of, speeds_of
from camrig.optimise.search import Expired
from camrig.rig import Rig

_CELL_M = 0.25
_MOST_STOPS = 40

Stop = Mapping[str, Aim]


def scan_for(rig: Rig, request: ScanRequest, settings: PlannerSettings, now: Callable[[], float]) -> ScanPlan:
    """Return the stops, in the order of least travel from the present aims; ``covered`` counts all floor cells.

    Tags are assumed flat, of the smallest size and the mean height that the rig's targets carry, and seen as
    ``image`` says, large enough to be detected. After the deadline no further stop is added.
    """
    began_s = now()
    scene = _floor_scene(rig, request, settings)
    problem = problem_of(scene)
    views = [floor_views(problem, i) for i in range(len(scene.cameras))]
    shown = [_shown(problem, i, view) for i, view in enumerate(views)]
    picks, covered = _cover(problem, views, shown, lambda: now() - began_s >= request.deadline_s)
    stops = [{scene.cameras[i].id: _aim(scene, i, views[i][k]) for i, k in pick.items()} for pick in picks]
    return ScanPlan(
        request_id=request.request_id,
        stamp_s=request.stamp_s,
        stops=tuple(_nearest_first(stops, request.aims, speeds_of(rig))),
        covered=float(covered.mean()) if covered.size else 0.0,
        solve_s=now() - began_s,
    )


def _floor_scene(rig: Rig, request: ScanRequest, settings: PlannerSettings) -> Scene:
    """Return the movable cameras, and a tag on every floor cell outside the keep-out boxes."""
    tags = [tag for body in rig.targets.values() for tag in body.tags]
    size_m = min((tag.size_m for tag in tags), default=0.1)
    height_m = float(np.mean([tag.T_body_tag[2, 3] for tag in tags])) if tags else 0.0
    axes = [
        low + (np.arange(count) + 0.5) * (high - low) / count
        for low, high in zip(*rig.space.floor_m, strict=True)
        for count in [max(1, math.ceil((high - low) / _CELL_M))]
    ]
    x, y = np.meshgrid(*axes)
    cells = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])
    cells = cells[~inside_any(cells, rig.space.keep_out_m)]
    targets = tuple(SceneTarget(f"cell{i}", tuple(cell.tolist()), size_m) for i, cell in enumerate(cells))
    asked = PlanRequest(request.request_id, request.stamp_s, (), request.aims, request.available, request.deadline_s)
    # A scan takes the time it takes: what a plan must reach within its period does not bind it.
    scene = scene_of(rig, asked, replace(settings, reach_s=math.inf))
    return Scene(
        cameras=tuple(camera for camera in scene.cameras if not isinstance(camera.place, FixedPlace)),
        targets=targets,
        settings=replace(settings, quality="pixel", visibility="image"),
        keep_out_m=scene.keep_out_m,
    )


def _cover(
    problem: Problem, views: Sequence[Array], shown: Sequence[Flags], expired: Expired
) -> tuple[list[dict[int, int]], Flags]:
    """Pick stops greedily: within a stop, camera after camera takes the view that adds most cells.

    Returns for each stop the view's index by camera index, and which cells are shown in the end.
    """
    covered: Flags = np.zeros(len(problem.targets), dtype=np.bool_)
    stops: list[dict[int, int]] = []
    while len(stops) < _MOST_STOPS and not expired():
        stop: dict[int, int] = {}
        while len(stop) < len(views):
            added = [
                (-1, i, 0) if i in stop else _most_added(problem, i, views, shown[i], covered, stop)
                for i in range(len(views))
            ]
            count, i, k = max(added)
            if count <= 0:
                break
            stop[i] = k
            covered |= shown[i][k]
        if not stop:
            break
        stops.append(stop)
    return stops, covered


def _shown(problem: Problem, i: int, views: Array) -> Flags:
    """Return which cells (m,) each of the views (K, 6) of camera i shows."""
    ends, cells, _ = rows_of(problem, i, views, np.arange(len(problem.points)))
    shown = np.zeros((len(views), len(problem.points)), dtype=np.bool_)
    shown[np.repeat(np.arange(len(views)), np.diff(ends)), cells] = True
    return shown


def _most_added(
    problem: Problem, i: int, views: Sequence[Array], shown: Flags, covered: Flags, stop: Mapping[int, int]
) -> tuple[int, int, int]:
    """Return how many cells the best view of camera i adds, i, and the view, apart from the drones of this stop."""
    count = (shown & ~covered).sum(axis=1)
    for j, k in stop.items():
        if min(problem.separation_m[i], problem.separation_m[j]) >= 0.0:
            least_m = max(problem.separation_m[i], problem.separation_m[j])
            count[np.linalg.norm(views[i][:, :2] - views[j][k][:2], axis=1) < least_m] = 0
    best = int(count.argmax())
    return int(count[best]), i, best


def _aim(scene: Scene, i: int, vector: Array) -> Aim:
    aim = aim_of(scene.cameras[i], vector)
    if aim is None:
        raise TypeError("a bolted camera takes no part in a scan")
    return aim


def _nearest_first(stops: Sequence[Stop], present: Stop, speeds: Mapping[str, float]) -> list[Stop]:
    """Order stops by going on to the one that is reached first; a camera without an aim in a stop stays."""
    at, left, ordered = dict(present), list(stops), []
    while left:
        following = min(left, key=lambda stop: _travel_s(at, stop, speeds))
        left.remove(following)
        ordered.append(following)
        at |= following
    return ordered


def _travel_s(at: Stop, stop: Stop, speeds: Mapping[str, float]) -> float:
    """Return how long the slowest camera moves."""
    return max((_distance(at.get(name), aim) / speeds[name] for name, aim in stop.items()), default=0.0)


def _distance(present: Aim | None, aim: Aim) -> float:
    match present, aim:
        case HeadAim(), HeadAim():
            return max(abs(aim.pan_rad - present.pan_rad), abs(aim.tilt_rad - present.tilt_rad))
        case DroneAim(), DroneAim():
            return math.dist(aim.position_m, present.position_m)
    return 0.0
