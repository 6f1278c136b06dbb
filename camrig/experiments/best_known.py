"""The best that a long search finds in each random scene: what plans are measured against.

    python -m camrig.experiments.best_known --seconds 60

searches every scene for so long on one processor, by plans of many seeds and by polishing random rigs in turn, and
keeps in ``best_known.json`` whatever beats what is there. Not proven optimal.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from camrig import optimise
from camrig.errors import InputError
from camrig.experiments.scenes import Mode, random_scene
from camrig.messages import Aim, DroneAim, HeadAim, RigPlan
from camrig.optimise import HeadPlace, PlannerSettings, Scene
from camrig.optimise.places import bounds

FILE = Path(__file__).with_name("best_known.json")
SIZES = ((3, 3), (5, 10), (7, 20))
SEEDS = range(10)

Variant = Literal["cone mean", "image mean", "cone worst"]
VARIANTS: tuple[Variant, ...] = get_args(Variant)

_ROUNDS_BETWEEN_SEEDS = 3


@dataclass(frozen=True, slots=True)
class Task:
    """One scene of the collection and how it is judged."""

    variant: Variant
    mode: Mode
    cameras: int
    targets: int
    seed: int

    @property
    def key(self) -> str:
        """Its name in the file."""
        return f"{self.variant} {self.mode} {self.cameras}x{self.targets} {self.seed}"

    def scene(self) -> Scene:
        """Draw it."""
        visibility, objective = self.variant.split()
        settings = PlannerSettings(
            visibility="cone" if visibility == "cone" else "image", objective="mean" if objective == "mean" else "worst"
        )
        return random_scene(self.mode, self.cameras, self.targets, self.seed, settings)


def tasks(variants: tuple[Variant, ...] = VARIANTS) -> Iterator[Task]:
    """Yield the collection: 60 scenes a variant."""
    modes: tuple[Mode, ...] = ("ptz", "drone")
    for variant, seed, (cameras, targets), mode in itertools.product(variants, SEEDS, SIZES, modes):
        yield Task(variant, mode, cameras, targets, seed)


def load() -> dict[str, tuple[int, float]]:
    """Return the uncovered targets and the objective in metres of the best plan known, by key; none without a file."""
    if not FILE.exists():
        return {}
    return {key: (int(n), float(value)) for key, (n, value) in json.loads(FILE.read_text()).items()}


def search(scene: Scene, seconds: float) -> tuple[int, float]:
    """Return the uncovered targets and the objective in metres of the best found in so many processor seconds."""
    rng = np.random.default_rng(2026)
    best = (len(scene.targets), float("inf"))
    until_s = time.process_time() + seconds  # not the clock: other work must not shorten the search
    for k in itertools.count():
        start = None if k % (1 + _ROUNDS_BETWEEN_SEEDS) == 0 else _random_rig(scene, rng)
        try:
            found = optimise.plan(scene, start=start, quick=start is not None, seed=k, now=time.monotonic)
        except InputError:
            continue
        best = min(best, worth(found))
        if time.process_time() > until_s:
            return best
    raise AssertionError("the count never ends")


def worth(plan: RigPlan) -> tuple[int, float]:
    """Return what plans of one scene are compared by."""
    return len(plan.uncovered), float("inf") if plan.objective_m is None else plan.objective_m


def _random_rig(scene: Scene, rng: np.random.Generator) -> dict[str, Aim]:
    aims: dict[str, Aim] = {}
    for camera in scene.cameras:
        x, y, z, pan_rad, tilt_rad, _ = rng.uniform(*bounds(camera.place))
        head = isinstance(camera.place, HeadPlace)
        aims[camera.id] = HeadAim(pan_rad, tilt_rad) if head else DroneAim((x, y, z), pan_rad)
    return aims


def main() -> None:
    """Search all scenes and keep what is better."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long each scene is searched")
    parser.add_argument("--variant", choices=VARIANTS, action="append", help="which problems (all)")
    given = parser.parse_args()
    everything = list(tasks(tuple(given.variant or VARIANTS)))
    for count, task in enumerate(everything, 1):
        found = search(task.scene(), given.seconds)
        known = load()
        better = task.key not in known or found < known[task.key]
        if better:
            FILE.write_text(json.dumps(dict(sorted({**known, task.key: found}.items())), indent=1) + "\n")
        print(f"{count}/{len(everything)} {task.key}: {found} {'better' if better else 'kept'}", file=sys.stderr)


if __name__ == "__main__":
    main()
