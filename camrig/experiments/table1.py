"""The paper's first table through the whole pipeline: random rooms, pictures, detections, estimates, errors.

Every configuration of a room meets the same bodies, the same errors of its cameras and the same noise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np

from camrig.errors import InputError
from camrig.experiments.configurations import CONFIGURATIONS, Configuration, planned
from camrig.experiments.estimators import ESTIMATORS, Estimated, Estimates, Estimator, estimates, fused_quality_m
from camrig.experiments.photographs import photograph
from camrig.experiments.rooms import Room, Wrong, draw_room
from camrig.experiments.scenes import Mode, Place
from camrig.geometry.arrays import Array, Transform
from camrig.messages import Aim, DroneAim

MODES: tuple[Mode, ...] = get_args(Mode)
SIZES = ((3, 3), (5, 10), (7, 20))
Condition = Literal["exact", "off", "anchored"]
CONDITIONS: tuple[Condition, ...] = get_args(Condition)

_POINTING_RAD, _POSITION_M = math.radians(0.1), 0.005
_OFF = Wrong(_POINTING_RAD, _POSITION_M, lenses=True)
WRONG: Mapping[Condition, Wrong] = {"exact": Wrong(), "off": _OFF, "anchored": _OFF}
ANCHORED: frozenset[Condition] = frozenset({"anchored"})

PAPER_BEST_MM: Mapping[tuple[Mode, int, int], float] = {
    ("ptz", 3, 3): 11.9,
    ("ptz", 5, 10): 22.0,
    ("ptz", 7, 20): 23.6,
    ("drone", 3, 3): 5.1,
    ("drone", 5, 10): 14.6,
    ("drone", 7, 20): 17.4,
}
"""The best mean error that the paper prints for a mode and size, of whichever of its methods."""


@dataclass(frozen=True, slots=True)
class Setup:
    """What is run: ``runs`` rooms of every mode and size (cameras, targets), seeds from ``seed`` on."""

    sizes: tuple[tuple[int, int], ...] = SIZES
    modes: tuple[Mode, ...] = MODES
    runs: int = 10
    seed: int = 0
    conditions: tuple[Condition, ...] = CONDITIONS
    configurations: tuple[Configuration, ...] = CONFIGURATIONS


@dataclass(frozen=True, slots=True)
class Job:
    """One room under one condition, in all configurations."""

    place: Place
    condition: Condition
    configurations: tuple[Configuration, ...]

    @property
    def key(self) -> str:
        """Its name among kept results."""
        place, names = self.place, "+".join(self.configurations)
        return f"{place.mode} {place.cameras}x{place.targets} {place.seed} {self.condition} {names}"


@dataclass(frozen=True, slots=True)
class Trial:
    """One configuration of one room: plain numbers, as they are kept in a file.

    ``errors_m``: [x, y, z] by estimator and body, absent where a body was not found; ``nees`` of those estimators that
    have a covariance; ``quality_m`` the paper's fused Q of every detected body. ``detected`` of ``in_picture`` tags
    that lie wholly in a picture were found. ``aims``: [pan, tilt] rad or [x, y, z, yaw] by camera.
    """

    mode: Mode
    cameras: int
    targets: int
    seed: int
    condition: Condition
    configuration: Configuration
    aims: dict[str, list[float]]
    in_picture: int
    detected: int
    quality_m: dict[str, float]
    errors_m: dict[Estimator, dict[str, list[float]]]
    nees: dict[Estimator, dict[str, float]]
    plan_s: float


def unable(setup: Setup) -> dict[Configuration, str]:
    """Return why configurations of the setup cannot be planned, by name: those whose solver is not installed."""
    room, left_out = draw_room(Place("ptz", 1, 1, 0), Wrong(), anchors=False), dict[Configuration, str]()
    for name in setup.configurations:
        try:
            planned(name, room, time.perf_counter)
        except InputError as error:
            left_out[name] = str(error)
    return left_out


def jobs(setup: Setup) -> Iterator[Job]:
    """Yield all that is to be done, cell by cell."""
    for mode in setup.modes:
        for cameras, targets in setup.sizes:
            for seed in range(setup.seed, setup.seed + setup.runs):
                for condition in setup.conditions:
                    yield Job(Place(mode, cameras, targets, seed), condition, setup.configurations)


def room_of(job: Job) -> Room:
    """Draw the room of a job."""
    return draw_room(job.place, WRONG[job.condition], anchors=job.condition in ANCHORED)


def work(job: Job) -> list[dict[str, Any]]:
    """Do a job: plan, photograph, detect, estimate, compare with the truth. Trials come as they are kept."""
    room = room_of(job)
    return [asdict(_trial(job, room, configuration)) for configuration in job.configurations]


def _trial(job: Job, room: Room, configuration: Configuration) -> Trial:
    plan = planned(configuration, room, time.perf_counter)
    photographs = {name: photograph(room, name, plan.aims[name]) for name in room.rig.cameras}
    found = estimates(room, plan.aims, photographs)
    in_picture = {(name, key) for name, each in photographs.items() for key in each.in_picture}
    detected = {(name, tag.key) for name, each in photographs.items() for tag in each.detected.tags}
    place = job.place
    return Trial(
        mode=place.mode,
        cameras=place.cameras,
        targets=place.targets,
        seed=place.seed,
        condition=job.condition,
        configuration=configuration,
        aims={name: _numbers(aim) for name, aim in plan.aims.items()},
        in_picture=len(in_picture),
        detected=len(in_picture & detected),
        quality_m=fused_quality_m(room, plan.aims, photographs),
        errors_m={
            estimator: {name: _error_m(each, room.bodies[name]).tolist() for name, each in found[estimator].items()}
            for estimator in ESTIMATORS
        },
        nees={estimator: _nees(found[estimator], room.bodies) for estimator in ESTIMATORS},
        plan_s=plan.solve_s,
    )


def _error_m(found: Estimated, T_world_body: Transform) -> Array:
    return np.asarray(found.position_m - T_world_body[:3, 3])


def _nees(found: Estimates, bodies: Mapping[str, Transform]) -> dict[str, float]:
    nees = {}
    for name, each in found.items():
        if each.covariance_m2 is not None:
            error_m = _error_m(each, bodies[name])
            nees[name] = float(error_m @ np.linalg.solve(each.covariance_m2, error_m))
    return nees


def _numbers(aim: Aim) -> list[float]:
    if isinstance(aim, DroneAim):
        return [*aim.position_m, aim.yaw_rad]
    return [aim.pan_rad, aim.tilt_rad]
