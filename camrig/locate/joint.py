"""Bodies and cameras estimated together from the newest frame of every camera: all corners of all tags at once.

Two cameras that see one body must agree on it, so bodies keep the cameras consistent with each other as anchors keep
them in place: what is left of a head's pointing error is what moves everything alike. Each camera's pose and lens have
their priors, and how each of these errors would move a body goes on with the fix (messages.Fix), so that nothing
averages it away later.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.bundle import Adjusted, Estimate, LensPriors, Views, adjust
from camrig.geometry.pnp import refine
from camrig.geometry.pose import PosePriors, transform
from camrig.locate.fit import angle_between, inflation
from camrig.locate.joint_problem import Problem, build
from camrig.locate.learn_lenses import learn
from camrig.locate.lenses import AS_CALIBRATED, Lenses
from camrig.locate.views import Together, View
from camrig.messages import CameraPose, Event, Fix, Level, Motion, Sighting
from camrig.rig import Body, Rig

AROUND_S = 0.25
"""Frames of other cameras stamped within this time of a new one are estimated with it."""

_CONTRADICTION = 9.0
"""A view more than three sigma from an orientation counts as three: one flipped pose must not rule."""


def joint(
    fresh: Sequence[View],
    others: Sequence[View],
    motions: Mapping[str, Motion],
    rig: Rig,
    lenses: Lenses = AS_CALIBRATED,
) -> Together:
    """Estimate the cameras and bodies of the ``fresh`` views and of the ``others`` near them in time; return a fix of
    every body that a fresh view shows, at that view's stamp, and the pose of every fresh camera.

    One view per camera. ``motions`` tells how each target moves, by id, ``lenses`` what earlier estimates have learnt.
    """
    if not fresh:
        return Together()
    newest_s = max(view.stamp_s for view in fresh)
    fresh_cameras = {view.camera_id for view in fresh}
    near = (view for view in others if abs(view.stamp_s - newest_s) <= AROUND_S)
    views = [*fresh, *(view for view in near if view.camera_id not in fresh_cameras)]
    sightings: dict[str, list[Sighting]] = {}
    for view in views:
        for sighting in view.sightings:
            sightings.setdefault(sighting.target_id, []).append(sighting)
    starts = {
        name: (seen[0].stamp_s, _start(seen[0].stamp_s, seen, motions[name], rig.targets[name]))
        for name, seen in sightings.items()
    }
    priors = lenses.priors([rig.cameras[view.camera_id] for view in views])
    carried = [view.carried for view in views]
    learnt = [pose and lenses.pose(pose, rig) for pose in carried]
    drawn_up = build(views, starts, motions, rig, priors, learnt)
    found, problem, spoilt = _solve(drawn_up)
    if learnt != carried and len(problem.rows) < len(drawn_up.rows):
        # Something does not fit: before a view is blamed for it, what was learnt of cameras that may since be knocked.
        found, problem, spoilt = _solve(build(views, starts, motions, rig, priors, carried))
    fresh_bodies = {seen.body.id for view in fresh for seen in view.bodies}
    wanted = [b for b, name in enumerate(problem.names) if name in fresh_bodies and b not in spoilt]
    fixes = _fixes(problem, wanted, found) if wanted else ()
    notes = [_contradiction(problem, b) for b in sorted(spoilt)]
    poses = [_camera_pose(problem, c, found) for c in range(len(fresh)) if problem.placed(c)]
    lenses, news = learn(lenses, problem, found, views, rig)
    return Together(tuple(fixes), tuple(poses), (*notes, *news), lenses)


def _start(stamp_s: float, seen: Sequence[Sighting], motion: Motion, body: Body) -> Transform:
    """Return where to begin with a body: where the best view puts it, which needs no track that may be wrong; turned,
    where it may be turned over, as its track and most views agree.
    """
    best = min(seen, key=lambda each: float(np.trace(each.covariance[:3, :3] + each.camera_covariance[:3, :3])))
    T = best.T_world_body
    T = transform(T[:3, :3], T[:3, 3] + motion.shift_m(stamp_s - best.stamp_s))
    if body.on_floor or sum(_disagreement(T, each) for each in seen) < _CONTRADICTION:
        return T
    poses = [each.T_world_body for each in seen]
    if motion.T_world_body is not None:
        poses.append(motion.T_world_body)
    turned = min(poses, key=lambda T: sum(_disagreement(T, each) for each in seen))
    return transform(turned[:3, :3], T[:3, 3])


def _disagreement(T_world_body: Transform, sighting: Sighting) -> float:
    """Return by how many sigma squared a view's orientation is another one, capped."""
    variance = float(np.trace(sighting.covariance[3:, 3:] + sighting.camera_covariance[3:, 3:])) / 3.0
    return min(angle_between(T_world_body, sighting.T_world_body) ** 2 / variance, _CONTRADICTION)


def _solve(problem: Problem) -> tuple[Adjusted, Problem, frozenset[int]]:
    """Adjust; leave out views whose corners lie further off than corners may, the worst first.

    A body that loses half of its views by that is not believed at all: which half is right nobody knows.
    """
    spoilt: frozenset[int] = frozenset()
    had = np.bincount(problem.views.body[problem.views.body >= 0], minlength=len(problem.names))
    found = adjust(problem.views, problem.cameras, problem.lenses, problem.bodies, problem.start)
    while (excess := problem.excess(found.chi2)).max(initial=0.0) > 1.0:
        worst = int(np.argmax(excess))
        b = int(problem.views.body[worst])
        left = np.ones(len(excess), dtype=bool)
        left[worst] = False
        if b >= 0 and 2 * int((problem.views.body[left] == b).sum()) <= had[b]:
            spoilt |= {b}
            left &= problem.views.body != b
        problem = problem.only(left)
        spoilt |= problem.unseen()
        found = adjust(problem.views, problem.cameras, problem.lenses, problem.bodies, found.estimate)
    return found, problem, spoilt


def _fixes(problem: Problem, wanted: Sequence[int], found: Adjusted) -> Iterator[Fix]:
    """Yield where bodies are, with what the corners and what each camera's errors make uncertain apart."""
    factors = found.sensitivity[wanted].swapaxes(1, 2) @ problem.prior_roots
    alone = found.body_alone[wanted]
    # The rest is what the corners leave of the cameras' poses: a small difference where a prior is weak.
    rest = found.body_covariance[wanted] - alone - (factors @ factors.swapaxes(2, 3)).sum(axis=1)
    covariances = alone + _positive(rest)
    for k, b in enumerate(wanted):
        own = problem.views.body == b
        freedoms = max(8 * int(own.sum()) - 4, 4)
        cameras = {problem.camera_ids[c] for c in problem.views.camera[own]}
        yield Fix(
            target_id=problem.names[b],
            stamp_s=problem.stamps_s[b],
            T_world_body=found.estimate.bodies[b],
            covariance=covariances[k] * inflation(float(found.chi2[own].sum()), freedoms),
            sources=problem.camera_ids,
            factors=factors[k],
            seen=tuple(each for each in problem.seen[b] if each.camera_id in cameras),
        )


def _positive(covariances: Array) -> Array:
    """Return (..., n, n) symmetric matrices without their negative eigenvalues, which rounding leaves."""
    values, vectors = np.linalg.eigh(0.5 * (covariances + covariances.swapaxes(-1, -2)))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ vectors.swapaxes(-1, -2))


def _camera_pose(problem: Problem, c: int, found: Adjusted) -> CameraPose:
    T_world_camera, covariance = found.estimate.cameras[c], found.camera_covariance[c, :6, c, :6]
    return CameraPose(problem.camera_ids[c], problem.camera_stamps_s[c], T_world_camera, covariance)


def _contradiction(problem: Problem, b: int) -> Event:
    cameras = sorted(each.camera_id for each in problem.seen[b])
    says = "do not agree on it" if len(cameras) > 1 else "does not see it where its other tags and the anchors put it"
    text = f"{', '.join(cameras)} {says}: hidden in part, or a tag's size or place or a calibration is wrong; not used"
    return Event(problem.stamps_s[b], Level.WARNING, problem.names[b], text)


def warm_up() -> None:
    """Load the machine code of the estimate, or compile it: half a minute, once after an installation."""
    square, eye = np.array([[[0.0, 0.0, 2.0], [0.1, 0.0, 2.0], [0.1, 0.1, 2.0], [0.0, 0.1, 2.0]]]), np.eye(4)[None]
    ideal, whitener = square[..., :2] / 2.0, np.tile(np.eye(2), (1, 4, 1, 1))
    refine(eye, square, ideal, whitener)
    first = np.zeros(1, dtype=np.int64)
    moved = np.zeros((1, 3)), np.eye(6)[None], np.eye(3)[None], np.zeros((1, 3))
    views = Views(first, first, square, *moved, ideal, whitener, np.zeros((1, 4, 2, 4)))
    known = PosePriors(eye, np.eye(6)[None])
    lenses = LensPriors(np.zeros((1, 4)), np.eye(4)[None])
    adjust(views, known, lenses, known, Estimate(eye, np.zeros((1, 4)), eye))
