"""Small scenes for the planner's tests: a 5 m x 3 m room, heads below its ceiling, drones that look straight down."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations, count

import numpy as np
from hypothesis import strategies as st

from camrig import optimise
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, Lens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.messages import Aim, DroneAim, HeadAim, RigPlan
from camrig.optimise import DronePlace, HeadPlace, PlannerSettings, PoseSigma, Scene, SceneCamera, SceneTarget
from camrig.optimise.configuration import Configuration, Task, configuration, task_of
from camrig.optimise.kernels.problem import Flags, Problem
from camrig.optimise.kernels.table import rows_of
from camrig.optimise.places import vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import Visibility

LAB = BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0))
PAN, TILT = (-2.9, 2.9), (-math.pi / 2, -0.1)
BOX = ((0.0, 0.0, 0.5), (5.0, 3.0, 2.5))
LEVEL = transform(R_MOUNT_OPTICAL, np.zeros(3))
DOWN = transform(R_BODY_OPTICAL_DOWN, np.zeros(3))
USUAL_SIGMA, PAPER = PoseSigma(), PlannerSettings()


def head(
    name: str,
    x: float,
    y: float,
    T_mount_camera: Array | None = None,
    *,
    z: float = 2.7,
    lens: Lens = LAB,
    pose_sigma: PoseSigma = USUAL_SIGMA,
) -> SceneCamera:
    mounted = LEVEL if T_mount_camera is None else T_mount_camera
    kinematics = PanTilt(transform(np.eye(3), np.array([x, y, z])))
    return SceneCamera(name, lens, HeadPlace(kinematics, mounted, PAN, TILT), pose_sigma=pose_sigma)


def drone(name: str, separation_m: float = 0.0, *, lens: Lens = LAB, yaw_free: bool = False) -> SceneCamera:
    yaw_limits_rad = (-1.5, 1.5) if yaw_free else None
    return SceneCamera(name, lens, DronePlace(DOWN, BOX, separation_m, yaw_limits_rad=yaw_limits_rad))


def targets(*places: tuple[float, float], tag_size_m: float | None = None) -> tuple[SceneTarget, ...]:
    return tuple(SceneTarget(f"t{i}", (x, y, 0.0), tag_size_m) for i, (x, y) in enumerate(places))


def room_scene(
    heads: int,
    drones: int,
    count_: int,
    seed: int,
    settings: PlannerSettings = PAPER,
    tag_size_m: float | None = None,
) -> Scene:
    """A scene drawn from a seed: heads and targets anywhere in the room."""
    rng = np.random.default_rng([seed, heads, drones, count_])
    places = rng.uniform((0.0, 0.0), (5.0, 3.0), (count_, 2))
    cameras = [
        *(
            head(f"h{i}", float(x), float(y))
            for i, (x, y) in enumerate(rng.uniform((0.0, 0.0), (5.0, 3.0), (heads, 2)))
        ),
        *(drone(f"d{i}") for i in range(drones)),
    ]
    return Scene(tuple(cameras), targets(*((float(x), float(y)) for x, y in places), tag_size_m=tag_size_m), settings)


def under(scene: Scene, **changes: object) -> Scene:
    """The scene with some of its settings changed."""
    return replace(scene, settings=replace(scene.settings, **changes))  # type: ignore[arg-type]


def jittered(scene: Scene, distance_m: float, seed: int) -> Scene:
    """The scene with every target moved by a distance over the floor, in directions drawn from a seed."""
    turns = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(scene.targets))

    def step(target: SceneTarget, turn: float) -> SceneTarget:
        x, y, z = target.position_m
        return replace(target, position_m=(x + distance_m * math.cos(turn), y + distance_m * math.sin(turn), z))

    return replace(scene, targets=tuple(step(t, turn) for t, turn in zip(scene.targets, turns, strict=True)))


def solve(scene: Scene, start: Mapping[str, Aim] | None = None, seed: int = 0) -> RigPlan:
    return optimise.plan(scene, start=start, seed=seed, now=lambda: 0.0)


def clock(step_s: float) -> Callable[[], float]:
    """A clock that goes on by so much whenever it is asked."""
    ticks = count()
    return lambda: next(ticks) * step_s


def rank(plan: RigPlan) -> tuple[int, float]:
    """Targets of equal weight: what plans are compared by."""
    return len(plan.uncovered), plan.objective_m or 0.0


def task(scene: Scene) -> Task:
    return task_of(problem_of(scene), worst=scene.settings.objective == "worst")


def at(scene: Scene, aims: Mapping[str, Aim]) -> Configuration:
    """The configuration of known aims."""
    vectors = [vector_of(camera, aims.get(camera.id)) for camera in scene.cameras]
    known = [vector for vector in vectors if vector is not None]
    assert len(known) == len(vectors)
    return configuration(task(scene), np.array(known))


def shown(problem: Problem, i: int, vectors: Array) -> Flags:
    """Which targets (K, m) camera i sees from vectors (K, 6)."""
    ends, found, _ = rows_of(problem, i, vectors, np.arange(len(problem.points)))
    seen = np.zeros((len(vectors), len(problem.points)), dtype=np.bool_)
    seen[np.repeat(np.arange(len(vectors)), np.diff(ends)), found] = True
    return seen


XY = st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 3.0))
VISIBILITIES: st.SearchStrategy[Visibility] = st.sampled_from(["cone", "image"])


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Heads and drones over a few targets and a keep-out box."""
    places = draw(st.lists(XY, min_size=1, max_size=5))
    heads = draw(st.lists(XY, min_size=0, max_size=2))
    return Scene(
        cameras=(
            *(head(f"h{i}", x, y) for i, (x, y) in enumerate(heads)),
            *(drone(f"d{i}") for i in range(draw(st.integers(1, 2)))),
        ),
        targets=targets(*places, tag_size_m=draw(st.sampled_from([None, 0.12]))),
        settings=PlannerSettings(
            visibility=draw(VISIBILITIES), margin_rad=draw(st.sampled_from([0.0, 0.02])), min_separation_m=0.8
        ),
        keep_out_m=(((2.0, 1.0, 0.0), (2.6, 1.6, 2.0)),),
    )


def check_permitted(scene: Scene, plan: RigPlan) -> None:
    """Limits, boxes, keep-out boxes and separation hold."""
    flown = []
    for camera in scene.cameras:
        aim = plan.aims[camera.id]
        if isinstance(camera.place, HeadPlace):
            assert isinstance(aim, HeadAim)
            assert PAN[0] <= aim.pan_rad <= PAN[1]
            assert TILT[0] <= aim.tilt_rad <= TILT[1]
        elif isinstance(camera.place, DronePlace):
            assert isinstance(aim, DroneAim)
            low, high = (0.0, 0.0, 1.0), BOX[1]
            assert all(a <= value <= b for a, value, b in zip(low, aim.position_m, high, strict=True))
            for box_low, box_high in scene.keep_out_m:
                assert not all(a < v < b for a, v, b in zip(box_low, aim.position_m, box_high, strict=True))
            flown.append(aim.position_m)
    for a, b in combinations(flown, 2):
        assert math.dist(a[:2], b[:2]) >= scene.settings.min_separation_m - 1e-6
