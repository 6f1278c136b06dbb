"""Bodies that drive about on a watched floor, frame after frame, and what is learnt of the lenses that see them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from camrig import fuse, locate
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import Event
from tests.watched_floor import LENS, Floor

SPEED_M_S = 0.3
LOW_M, HIGH_M = (0.4, 0.4), (4.6, 2.6)


def drive(floor: Floor, seconds: float, fps: float) -> Iterator[tuple[float, dict[str, Transform]]]:
    """Yield stamp and places while each body goes straight from one drawn goal to the next."""
    rng = np.random.default_rng(floor.seed + 1)
    at = np.array([T[:2, 3] for T in floor.places.values()])
    goal = rng.uniform(LOW_M, HIGH_M, at.shape)
    for k in range(int(seconds * fps)):
        step_m = SPEED_M_S / fps
        there = np.linalg.norm(goal - at, axis=1) <= step_m
        goal[there] = rng.uniform(LOW_M, HIGH_M, (int(there.sum()), 2))
        way = goal - at
        at = at + way * (step_m / np.linalg.norm(way, axis=1, keepdims=True))
        heading = np.arctan2(way[:, 1], way[:, 0])
        yield (
            1.0 + k / fps,
            {
                name: transform(rotation_z(angle), np.array([x, y, 0.0]))
                for name, angle, (x, y) in zip(floor.places, heading, at, strict=True)
            },
        )


def learnt(
    floor: Floor, seconds: float, fps: float, turns_s: float = math.inf, known: locate.Lenses = locate.AS_CALIBRATED
) -> tuple[locate.Lenses, list[Event]]:
    """Return what a daemon that knew so much knows of the lenses after so long, and what it has said of them; heads
    turn every ``turns_s``.
    """
    motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
    lenses, said, turned_s = known, list[Event](), 1.0
    for stamp_s, places in drive(floor, seconds, fps):
        if stamp_s >= turned_s + turns_s:
            floor.turn()
            turned_s = stamp_s
        views = [stamped(floor.view(name, places=places), stamp_s) for name in floor.rig.cameras]
        found = locate.joint(views, (), motions, floor.rig, lenses)
        lenses = found.lenses or lenses
        said += [note for note in found.notes if note.about in floor.rig.cameras]
    return lenses, said


def stamped(view: locate.View, stamp_s: float) -> locate.View:
    """Return a view as one of another instant."""
    sightings = tuple(replace(sighting, stamp_s=stamp_s) for sighting in view.sightings)
    return replace(view, stamp_s=stamp_s, sightings=sightings)


def true_errors(floor: Floor) -> dict[str, Array]:
    """Return what is wrong with each lens: (4,) as geometry.lens.errors has it."""
    return {
        name: np.array(
            [
                lens.focal_px[0] / LENS.focal_px[0] - 1.0,
                lens.centre_px[0] - LENS.centre_px[0],
                lens.centre_px[1] - LENS.centre_px[1],
                lens.distortion[0] - LENS.distortion[0],
            ]
        )
        for name, lens in floor.true_lenses.items()
    }


def known_exactly(floor: Floor) -> locate.Lenses:
    """Return what the best refinement could know."""
    refined = {name: locate.Refined(error, 1e-12 * np.eye(4)) for name, error in true_errors(floor).items()}
    return locate.Lenses(refined=refined)


def standing(floor: Floor, lenses: locate.Lenses) -> tuple[list[float], list[float]]:
    """Look once at the bodies where they stood at first: (metres off on the floor, NEES of the position) of each."""
    motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
    off_m, nees = [], []
    for fix in locate.joint(floor.views(), (), motions, floor.rig, lenses).fixes:
        error_m = fix.T_world_body[:3, 3] - floor.places[fix.target_id][:3, 3]
        off_m.append(math.hypot(*error_m[:2]))
        nees.append(float(error_m @ np.linalg.solve(fix.whole[:3, :3], error_m)))
    return off_m, nees
