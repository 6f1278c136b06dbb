"""How good, and how honest, the joint estimate of bodies and cameras is, against the paper's mean of single cameras.

python -m tests.joint_study --scenes 40 --seed 1
python -m tests.joint_study --refine --scenes 8 --seed 1
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np

from camrig import fuse, locate
from tests.driven_floor import known_exactly, learnt, standing, true_errors
from tests.watched_floor import LENS_SIGMA, Errors, Floor

SIZES = ((3, 3), (5, 10), (7, 20))
KINDS = {
    "nothing wrong": Errors(),
    "heads 0.2 deg": Errors(math.radians(0.2)),
    "heads 0.2 deg, mounts": Errors(math.radians(0.2), mounts=True),
    "heads 0.1 deg, mounts, lenses": Errors(math.radians(0.1), mounts=True, lenses=True),
}

REFINED_ERRORS = Errors(math.radians(0.2), lenses=True)
REFINED_S, REFINED_FPS = 120.0, 2.0


@dataclass(frozen=True)
class Row:
    """Of n bodies: mean error on the floor, its 95th percentile and that of the mean of single cameras (mm); NEES."""

    mean_mm: float
    p95_mm: float
    single_mm: float
    nees: float
    largest_nees: float
    n: int


def study(
    size: tuple[int, int], anchors: bool, errors: Errors, scenes: int, seed: int, known_height: bool, known_lenses: bool
) -> Row:
    """Draw scenes of a size, look once with every camera, and place every body that is seen."""
    joint_m, single_m, nees = [], [], []
    for scene in range(scenes):
        floor = Floor(1000 * seed + scene, *size, anchors, known_height, errors)
        views = floor.views()
        motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
        lenses = known_exactly(floor) if known_lenses else locate.AS_CALIBRATED
        for fix in locate.joint(views, (), motions, floor.rig, lenses).fixes:
            error_m = fix.T_world_body[:3, 3] - floor.places[fix.target_id][:3, 3]
            joint_m.append(math.hypot(*error_m[:2]))
            nees.append(float(error_m @ np.linalg.solve(fix.whole[:3, :3], error_m)))
        single = locate.apart(views).fixes
        for name in {fix.target_id for fix in single}:
            mean_m = np.mean([fix.T_world_body[:2, 3] for fix in single if fix.target_id == name], axis=0)
            single_m.append(math.hypot(*(mean_m - floor.places[name][:2, 3])))
    mean_mm, p95_mm = 1e3 * float(np.mean(joint_m)), 1e3 * float(np.quantile(joint_m, 0.95))
    return Row(mean_mm, p95_mm, 1e3 * float(np.mean(single_m)), float(np.mean(nees)), max(nees), len(nees))


def refined(size: tuple[int, int], anchors: bool, scenes: int, seed: int) -> str:
    """Return a row: bodies at rest before and after two minutes in which they drove about and lenses were refined."""
    off_m: dict[str, list[float]] = {"calibrated": [], "refined": [], "exact": []}
    nees, left, honest = [], [], []
    for scene in range(scenes):
        floor = Floor(1000 * seed + scene, *size, anchors=anchors, errors=REFINED_ERRORS, refine_lenses=True)
        lenses, _ = learnt(floor, REFINED_S, REFINED_FPS)
        for name, known in (("calibrated", locate.AS_CALIBRATED), ("refined", lenses), ("exact", known_exactly(floor))):
            found_m, found_nees = standing(floor, known)
            off_m[name] += found_m
            nees += found_nees if name == "refined" else []
        for name, error in true_errors(floor).items():
            off = lenses.refined[name].mean - error
            left.append(off / LENS_SIGMA)
            honest.append(float(off @ np.linalg.solve(lenses.refined[name].covariance, off)))
    means = " | ".join(f"{1e3 * float(np.mean(each)):.2f}" for each in off_m.values())
    sigmas = " ".join(f"{value:.2f}" for value in np.sqrt(np.mean(np.square(left), axis=0)))
    return (
        f"| {4 if anchors else 0} | {size[0]}, {size[1]} | {len(nees)} | {means} | {np.mean(nees):.2f} "
        f"| {sigmas} | {np.mean(honest):.2f} |"
    )


def main() -> None:
    """Print the table as Markdown."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    asked.add_argument("--scenes", type=int, default=40)
    asked.add_argument("--seed", type=int, default=1)
    asked.add_argument("--known-height", action="store_true", help="bodies' heights stand in the rig's file")
    asked.add_argument("--known-lenses", action="store_true", help="camrig knows the lenses exactly")
    asked.add_argument(
        "--refine", action="store_true", help="two minutes of refining lenses; 0.2 deg of pointing error"
    )
    options = asked.parse_args()
    if options.refine:
        print("| anchors | heads, bodies | n | as calibrated mm | refined mm | lenses exact mm | NEES | left | NEES |")
        print("|--|--|--|--|--|--|--|--|--|")
        for anchors in (False, True):
            for size in SIZES:
                print(refined(size, anchors, options.scenes, options.seed), flush=True)
        return
    print("| what is wrong | anchors | heads, bodies | n | mean mm | 95 % mm | mean of singles mm | NEES | largest |")
    print("|--|--|--|--|--|--|--|--|--|")
    for kind, errors in KINDS.items():
        for anchors in (False, True):
            for size in SIZES:
                known = options.known_height, options.known_lenses
                row = study(size, anchors, errors, options.scenes, options.seed, *known)
                print(
                    f"| {kind} | {4 if anchors else 0} | {size[0]}, {size[1]} | {row.n} | {row.mean_mm:.2f} "
                    f"| {row.p95_mm:.2f} | {row.single_mm:.2f} | {row.nees:.2f} | {row.largest_nees:.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
