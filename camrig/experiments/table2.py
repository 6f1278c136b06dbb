"""The paper's second table: one rig, several ways to aim it, through the running daemon.

Scene by scene the daemon finds the targets and aims as camrig does; then every other method aims the same heads at the
same targets, each after its own plan of where camrig believes them to be. Positions are scored as they are published,
and the paper's means are taken of the same frames' single-camera poses, with heads where they say they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from camrig.errors import HardwareError
from camrig.experiments.scenes import PAPER
from camrig.geometry.arrays import Array
from camrig.geometry.pose import invert
from camrig.interfaces import Published
from camrig.locate import View
from camrig.messages import DroneAim, HeadAim, PlanRequest, PlanTarget, TargetStatus
from camrig.optimise import Scene, SceneTarget
from camrig.optimise.scene import scene_of
from camrig.optimise.solvers import Solver, solve
from camrig.rig import HeadMount
from camrig.runtime.daemon import Daemon
from camrig.sensing import fused

Method = Literal["camrig", "manual", "arslan", "paper-sqp", "paper-ipopt"]
METHODS: tuple[Method, ...] = get_args(Method)
Estimator = Literal["mean", "quality", "published"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)
"""Equal weights and weights 1/Q of single cameras' poses, as in the paper; and what the daemon publishes."""

_SOLVERS: Mapping[Method, Solver] = {
    "manual": "hold",
    "arslan": "arslan",
    "paper-sqp": "slsqp",
    "paper-ipopt": "ipopt",
}

FOUND_TIMEOUT_S = 90.0
SETTLE_TIMEOUT_S = 20.0
STILL_RAD = math.radians(0.05)
STILL_S = 1.0
PLANNED_S = 3.0
"""How long camrig may plan before it is scored: three periods."""
MEASURED_S = 2.0
TURN_S = 0.1

Truth = Callable[[float], Mapping[str, Array]]
"""Where every target truly is at a stamp, (3,) m by id."""


@dataclass(frozen=True, slots=True)
class Score:
    """One method on one scene, plain numbers: errors (m) by estimator and target, absent where it was not seen; the
    paper's fused Q (m) of those that were.
    """

    scene: int
    method: Method
    targets: int
    error_m: dict[Estimator, dict[str, float]]
    quality_m: dict[str, float]


@dataclass(frozen=True, slots=True)
class Sample:
    """What is known at one time: the newest frame of every camera, and what is published."""

    views: tuple[View, ...]
    published: Published


def play(daemon: Daemon, truth: Truth, scene: int, methods: tuple[Method, ...]) -> Iterator[Score]:
    """Score every method on one scene; the daemon is started and its targets stand still. camrig goes first.

    Raises HardwareError where targets are not found or heads do not come to rest in time, KeyboardInterrupt where the
    daemon was asked to stop.
    """
    _wait(daemon, lambda: _all_found(daemon), FOUND_TIMEOUT_S, "targets were not all found")
    heads = tuple(daemon.config.rig.heads)
    problem = _problem(daemon)
    for method in methods:
        if method == "camrig":
            daemon.resume(heads)
            _pass(daemon, PLANNED_S)
        else:
            for head, aim in _aims(method, problem, daemon, scene).items():
                daemon.aim(head, aim)
        _settle(daemon)
        yield _scored(_samples(daemon), truth, scene, method, len(daemon.config.rig.targets))


def _all_found(daemon: Daemon) -> bool:
    latest, mission = daemon.control.latest, daemon.control.state.mission
    return (
        latest is not None
        and not mission.scanning
        and mission.plan is not None
        and all(target.status is TargetStatus.TRACKED for target in latest.targets)
    )


def _problem(daemon: Daemon) -> Scene:
    """Return the paper's problem: where the targets are believed to be, as points."""
    latest, rig = daemon.control.latest, daemon.config.rig
    assert latest is not None  # they were found
    targets = []
    for target in latest.targets:
        x, y, z = (float(value) for value in target.position_m)
        height_m = float(rig.targets[target.id].tags[0].T_body_tag[2, 3])
        targets.append(PlanTarget(target.id, (x, y, z + height_m)))
    available = tuple(camera.id for camera in rig.cameras.values() if isinstance(camera.mount, HeadMount))
    aims: dict[str, HeadAim | DroneAim] = {name: HeadAim(0.0, 0.0) for name in available}
    return scene_of(rig, PlanRequest(0, 0.0, tuple(targets), aims, available, math.inf), PAPER)


def _aims(method: Method, problem: Scene, daemon: Daemon, seed: int) -> dict[str, HeadAim]:
    """Return where a method aims every head; by hand all of them look at the middle of the floor."""
    rig = daemon.config.rig
    if method == "manual":
        x, y = (float(value) for value in np.mean(rig.space.floor_m, axis=0))
        targets: tuple[SceneTarget, ...] = (SceneTarget("middle", (x, y, 0.0)),)
        problem = Scene(problem.cameras, targets, problem.settings)
    plan = solve(_SOLVERS[method], problem, seed=seed, now=daemon.clock.now_s).plan
    found = {}
    for name, aim in plan.aims.items():
        mount = rig.cameras[name].mount
        if isinstance(mount, HeadMount) and isinstance(aim, HeadAim):
            found[mount.head] = HeadAim(aim.pan_rad, aim.tilt_rad)
    return found


def _settle(daemon: Daemon) -> None:
    """Wait until no head has moved for a while."""
    began_s = daemon.clock.now_s()
    still_since_s, before = began_s, _angles(daemon)

    def still() -> bool:
        nonlocal still_since_s, before
        now_s, angles = daemon.clock.now_s(), _angles(daemon)
        if angles.shape != before.shape or np.abs(angles - before).max(initial=0.0) > STILL_RAD:
            still_since_s, before = now_s, angles
        return now_s - still_since_s >= STILL_S and now_s - began_s >= 2.0 * STILL_S

    _wait(daemon, still, SETTLE_TIMEOUT_S, "heads did not come to rest")


def _angles(daemon: Daemon) -> Array:
    """Return the newest readings of all axes."""
    newest = [
        axis.readings[-1].angle_rad
        for head in daemon.control.state.histories.heads.values()
        for axis in (head.pan, head.tilt)
        if axis.readings
    ]
    return np.array(newest)


def _wait(daemon: Daemon, ready: Callable[[], bool], timeout_s: float, trouble: str) -> None:
    deadline_s = daemon.clock.now_s() + timeout_s
    while not ready():
        if daemon.clock.now_s() > deadline_s:
            raise HardwareError(f"{trouble} within {timeout_s:.0f} s: {daemon.status_line()}")
        _pass(daemon, TURN_S)


def _pass(daemon: Daemon, seconds: float) -> None:
    daemon.supervise(daemon.clock.now_s() + seconds)
    if daemon.stop_requested:
        raise KeyboardInterrupt


def _samples(daemon: Daemon) -> list[Sample]:
    """Watch the rig for a while; views older than that are none of it."""
    began_s, found = daemon.clock.now_s(), []
    while daemon.clock.now_s() < began_s + MEASURED_S:
        _pass(daemon, TURN_S)
        views = tuple(view for view in daemon.control.state.views.values() if view.stamp_s >= began_s - STILL_S / 2.0)
        if daemon.control.latest is not None:
            found.append(Sample(views, daemon.control.latest))
    return found


def _scored(samples: list[Sample], truth: Truth, scene: int, method: Method, targets: int) -> Score:
    """Score what was known while heads stood still: means over samples of the distance from the truth."""
    errors: dict[Estimator, dict[str, list[float]]] = {name: {} for name in ESTIMATORS}
    qualities: dict[str, list[float]] = {}
    for sample in samples:
        true, singles = truth(sample.published.stamp_s), _singles(sample.views)
        published = {target.id: target.position_m for target in sample.published.targets}
        for target, seen in singles.items():
            places, quality_m = np.array([place for place, _ in seen]), np.array([quality for _, quality in seen])
            said: dict[Estimator, Array] = {
                "mean": places.mean(axis=0),
                "quality": np.average(places, axis=0, weights=1.0 / quality_m),
                "published": published[target],
            }
            for estimator, position_m in said.items():
                off_m = float(np.linalg.norm(position_m - true[target]))
                errors[estimator].setdefault(target, []).append(off_m)
            qualities.setdefault(target, []).append(float(fused(1.0 / quality_m)))
    return Score(
        scene,
        method,
        targets,
        {name: {target: float(np.mean(values)) for target, values in own.items()} for name, own in errors.items()},
        {target: float(np.mean(values)) for target, values in qualities.items()},
    )


def _singles(views: tuple[View, ...]) -> dict[str, list[tuple[Array, float]]]:
    """Return where each camera by itself has every target, its pose as its head says it is (no anchor), and Q."""
    found: dict[str, list[tuple[Array, float]]] = {}
    for view in views:
        if view.carried is not None:
            as_said = view.carried.T_world_camera @ invert(view.found.T_world_camera)
            for sighting in view.sightings:
                place = (as_said @ sighting.T_world_body)[:3, 3]
                found.setdefault(sighting.target_id, []).append((place, sighting.quality_m))
    return found
