"""Views of several cameras written out as the arrays that ``geometry.bundle`` solves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.bundle import Estimate, LensPriors, Views
from camrig.geometry.bundle_kernel import CAMERA
from camrig.geometry.pose import PosePriors
from camrig.geometry.rotation import rotation_exp, rotation_log, upright_rotation
from camrig.locate.fit import residual_limit_px
from camrig.locate.sightings import UPRIGHT_SIGMA_RAD
from camrig.locate.tags import SeenTag
from camrig.locate.views import View
from camrig.messages import CameraPose, Motion, Seen
from camrig.rig import Body, Rig

FLOOR_SIGMA_M = 0.001
"""One sigma of the height of a body of which the rig's file says it: floors are not flat, nor wheels round."""

FAR_RAD = 0.5
"""What seems turned by more between two frames may be turned over in one of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is to be adjusted, and who is who: cameras by ``camera_ids``, bodies by ``names``, each with its stamp.

    ``prior_roots`` (c, 10, 10) turns the covariance of anything with a camera's unknowns into the factor by which that
    camera's prior errors, as unit normal numbers, move it: the transposed inverse of the prior's Cholesky factor, zero
    where a camera has no prior. ``limit_chi2`` (m,) is what a view's chi2 may be,
    ``rows`` (m) each view's camera and tag.
    """

    camera_ids: tuple[str, ...]
    camera_stamps_s: tuple[float, ...]
    names: tuple[str, ...]
    stamps_s: tuple[float, ...]
    seen: tuple[tuple[Seen, ...], ...]
    views: Views
    cameras: PosePriors
    lenses: LensPriors
    bodies: PosePriors
    start: Estimate
    prior_roots: Array
    limit_chi2: Array
    rows: tuple[tuple[int, SeenTag], ...]

    def excess(self, chi2: Array) -> Array:
        """Return by how much (m,) each view exceeds what its chi2 may be; above 1 it is not believed."""
        return chi2 / self.limit_chi2

    def only(self, kept: npt.NDArray[np.bool_]) -> Problem:
        """Return the problem with some of its views, and of these those alone that hang on something known; what no
        view is left of is held where it began.
        """
        kept = self._tied(kept)
        views = self.views.only(kept)
        return replace(
            self,
            views=views,
            limit_chi2=self.limit_chi2[kept],
            rows=tuple(compress(self.rows, kept)),
            cameras=_held(self.cameras, views.camera),
            bodies=_held(self.bodies, views.body),
        )

    def placed(self, c: int) -> bool:
        """Tell whether anything says where a camera is: its carrier, or a view."""
        return bool(self.prior_roots[c, :6, :6].any() or (self.views.camera == c).any())

    def unseen(self) -> frozenset[int]:
        """Return the bodies that no view shows."""
        return frozenset(range(len(self.names))) - frozenset(self.views.body.tolist())

    def _tied(self, kept: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return the views of cameras that hang on a prior, an anchor, or a body that such a camera sees."""
        camera, body = self.views.camera, self.views.body
        tied = np.asarray(self.prior_roots[:, :6, :6].any(axis=(1, 2)), dtype=bool)
        tied[camera[kept & (body < 0)]] = True
        known, of_bodies = np.zeros(len(self.names), dtype=bool), kept & (body >= 0)
        for _ in range(len(tied)):  # each round ties the cameras that share a body with those tied before
            known[body[of_bodies & tied[camera]]] = True
            tied[camera[of_bodies][known[body[of_bodies]]]] = True
        return np.asarray(kept & tied[camera])


def _held(known: PosePriors, seen: npt.NDArray[np.int64]) -> PosePriors:
    information = known.information.copy()
    for k in np.setdiff1d(np.arange(len(known.T)), seen):
        information[k] += np.diag((np.diag(information[k]) <= 0.0).astype(float))
    return PosePriors(known.T, information)


def build(
    views: Sequence[View],
    starts: Mapping[str, tuple[float, Transform]],
    motions: Mapping[str, Motion],
    rig: Rig,
    lenses: LensPriors,
    poses: Sequence[CameraPose | None],
) -> Problem:
    """Write out the views; ``starts`` is when and where each body is to be placed, by id; ``lenses`` and ``poses`` are
    what is known of the views' cameras beforehand, None of a pose = nothing.
    """
    names = tuple(starts)
    T_cameras = np.stack([view.found.T_world_camera for view in views])
    T_bodies = np.stack([T for _, T in starts.values()]) if names else np.zeros((0, 4, 4))
    cameras, roots = camera_priors(views, poses)
    roots[:, 6:, 6:] = np.linalg.cholesky(lenses.information)
    rows = tuple(_rows(views, names, starts, motions))
    return Problem(
        camera_ids=tuple(view.camera_id for view in views),
        camera_stamps_s=tuple(view.stamp_s for view in views),
        names=names,
        stamps_s=tuple(stamp_s for stamp_s, _ in starts.values()),
        seen=tuple(_seen(name, views) for name in names),
        views=_written(rows),
        cameras=cameras,
        lenses=lenses,
        bodies=_body_priors([rig.targets[name] for name in names], T_bodies),
        start=Estimate(T_cameras, lenses.mean, T_bodies),
        prior_roots=roots,
        limit_chi2=np.array([_limit_chi2(row.tag) for row in rows]),
        rows=tuple((row.camera, row.tag) for row in rows),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One tag in one view, and how its body moved between the body's stamp and the view's (geometry.bundle.Views)."""

    camera: int
    body: int
    tag: SeenTag
    shift_m: Array
    spread: Array
    turn: Array
    slack_rad: Array


def _rows(
    views: Sequence[View],
    names: tuple[str, ...],
    starts: Mapping[str, tuple[float, Transform]],
    motions: Mapping[str, Motion],
) -> Iterator[_Row]:
    first_seen: dict[str, Transform] = {}
    for c, view in enumerate(views):
        for anchor in view.anchors:
            yield _Row(c, -1, anchor, np.zeros(3), np.zeros((6, 6)), np.eye(3), np.zeros(3))
        turns = {sighting.target_id: sighting.T_world_body for sighting in view.sightings}
        for seen in view.bodies:
            name = seen.body.id
            if name not in starts:
                continue
            dt_s, motion = view.stamp_s - starts[name][0], motions[name]
            shift_m, spread, expected_rad = motion.shift_m(dt_s), motion.spread(dt_s), motion.turn_rad(dt_s)
            turn_rad = expected_rad
            if name in turns:
                before = first_seen.setdefault(name, turns[name])
                turn_rad = _seen_turn_rad(before, turns[name], seen.body, expected_rad) if dt_s else turn_rad
            turn, slack_rad = rotation_exp(turn_rad), expected_rad - turn_rad
            for tag in seen.tags:
                yield _Row(c, names.index(name), tag, shift_m, spread, turn, slack_rad)


def _seen_turn_rad(T_before: Transform, T_now: Transform, body: Body, expected_rad: Array) -> Array:
    """Return by how much (3,) a body is seen to have turned between two views; what is expected, where it seems to have
    been turned over.
    """
    turn_rad = rotation_log(T_now[:3, :3] @ T_before[:3, :3].T)
    if body.on_floor:
        turn_rad[:2] = 0.0
    return turn_rad if float(np.linalg.norm(turn_rad)) <= FAR_RAD else expected_rad


def _written(rows: Sequence[_Row]) -> Views:
    tags = [row.tag for row in rows]
    return Views(
        camera=np.array([row.camera for row in rows], dtype=np.int64),
        body=np.array([row.body for row in rows], dtype=np.int64),
        corners_m=np.array([tag.corners_m for tag in tags]).reshape(-1, 4, 3),
        shift_m=np.array([row.shift_m for row in rows]).reshape(-1, 3),
        spread=np.array([row.spread for row in rows]).reshape(-1, 6, 6),
        turn=np.array([row.turn for row in rows]).reshape(-1, 3, 3),
        slack_rad=np.array([row.slack_rad for row in rows]).reshape(-1, 3),
        ideal=np.array([tag.points.ideal for tag in tags]).reshape(-1, 4, 2),
        whitener=np.array([tag.points.whitener for tag in tags]).reshape(-1, 4, 2, 2),
        lens_slopes=np.array([tag.lens_slopes for tag in tags]).reshape(-1, 4, 2, 4),
    )


def camera_priors(views: Sequence[View], poses: Sequence[CameraPose | None]) -> tuple[PosePriors, Array]:
    """Return what is known of the views' cameras, and its part of ``Problem.prior_roots``."""
    T = np.stack([(pose or view.found).T_world_camera for view, pose in zip(views, poses, strict=True)])
    information, roots = np.zeros((len(views), 6, 6)), np.zeros((len(views), CAMERA, CAMERA))
    for c, pose in enumerate(poses):
        if pose is not None:
            root = np.linalg.inv(np.linalg.cholesky(pose.covariance))
            information[c], roots[c, :6, :6] = root.T @ root, root.T
    return PosePriors(T, information), roots


def _body_priors(bodies: Sequence[Body], T_bodies: Array) -> PosePriors:
    """Return that bodies on the floor stand upright, at their height where that is known; where they start tells
    nothing.
    """
    upright = np.diag([0.0, 0.0, 0.0, UPRIGHT_SIGMA_RAD**-2, UPRIGHT_SIGMA_RAD**-2, 0.0])
    information = np.zeros((len(T_bodies), 6, 6))
    stood_up = T_bodies.copy()
    for b, body in enumerate(bodies):
        if not body.on_floor:
            continue
        information[b] = upright
        stood_up[b, :3, :3] = upright_rotation(T_bodies[b, :3, :3])
        if body.height_m is not None:
            information[b, 2, 2] = FLOOR_SIGMA_M**-2
            stood_up[b, 2, 3] = body.height_m
    return PosePriors(stood_up, information)


def _seen(name: str, views: Sequence[View]) -> tuple[Seen, ...]:
    return tuple(
        Seen(view.camera_id, view.stamp_s, sighting.quality_m)
        for view in views
        for sighting in view.sightings
        if sighting.target_id == name
    )


def _limit_chi2(tag: SeenTag) -> float:
    """Return above which chi2 a view is not believed: its root mean square residual is then past the limit."""
    return 4.0 * (residual_limit_px(tag.width_px) / float(tag.points.sigma_px[0])) ** 2
