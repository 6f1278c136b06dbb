"""Bodies in one picture: each solved from all its tags together, its two possible poses told apart by what is known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import PoseFit, refine, square_poses, whitened_residuals
from camrig.geometry.pose import PosePriors, apply, difference, invert, transform
from camrig.geometry.rotation import skew, upright_rotation
from camrig.locate.fit import NOISE_CHI2, SAME_RAD, angle_between, clearly_better, inflation, residual_limit_px
from camrig.locate.tags import SeenTag
from camrig.messages import CameraPose, Sighting
from camrig.rig import Body
from camrig.sensing import pixel_quality

UPRIGHT_SIGMA_RAD = 0.01
"""One sigma of how upright a body on the floor stands: its suspension, the floor, and how well its tag was mounted."""

MAX_LEAN_RAD = 0.15
"""A floor body that leans further has fallen, or its tag is not where the rig says: it is not placed."""

_HOPELESS = 100.0
"""A second pose with so many times the chi2 of the first is not worth refining."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenBody:
    """A target in the picture, with all its tags, and where it was last believed to be (None = not known)."""

    body: Body
    tags: tuple[SeenTag, ...]
    T_world_body: Transform | None

    @property
    def width_px(self) -> float:
        """The width of its largest tag."""
        return max(tag.width_px for tag in self.tags)


def seen_bodies(
    tags: Sequence[SeenTag], targets: Mapping[str, Body], priors: Mapping[str, Transform]
) -> tuple[SeenBody, ...]:
    """Gather the tags of each target."""
    gathered: dict[str, list[SeenTag]] = {}
    for tag in tags:
        if tag.owner.target_id is not None:
            gathered.setdefault(tag.owner.target_id, []).append(tag)
    return tuple(SeenBody(targets[name], tuple(own), priors.get(name)) for name, own in gathered.items())


def solve(bodies: Sequence[SeenBody], camera: CameraPose, lens: Lens) -> tuple[tuple[Sighting, ...], tuple[str, ...]]:
    """Return a sighting of every body whose corners fit, and the ids of those whose corners do not.

    All bodies are refined in one stack, with the second of two poses where it may be the right one; a floor body's fit
    knows that it stands upright.
    """
    started = [(body, _starts(body, camera)) for body in bodies]
    misfits = [body.body.id for body, starts in started if not starts]
    started = [(body, starts) for body, starts in started if starts]
    if not started:
        return (), tuple(misfits)
    fit, row, chosen = _fit(started, camera), 0, list[_Chosen]()
    for body, starts in started:
        found = _choose(body, fit.of(slice(row, row + len(starts))), camera)
        row += len(starts)
        if found is None:
            misfits.append(body.body.id)
        else:
            chosen.append(found)
    return tuple(_sightings(chosen, camera, lens)) if chosen else (), tuple(misfits)


def _starts(seen: SeenBody, camera: CameraPose) -> list[Transform]:
    """Return the best ``T_camera_body`` of both solutions of every tag, and the next best where it may be the one.

    Where a floor body is believed to be will do, if its corners are near there: it cannot be turned over.
    """
    if seen.T_world_body is not None and seen.body.on_floor:
        expected = invert(camera.T_world_camera) @ seen.T_world_body
        if _near(seen, expected):
            return [expected]
    found = [
        square.T_camera_tag @ invert(tag.owner.T_owner_tag)
        for tag in seen.tags
        for square in square_poses(tag.points.ideal, tag.points.px_per_ideal, tag.owner.size_m)
    ]
    if not found:
        return []
    corners, ideal, whitener = (np.repeat(part[None], len(found), axis=0) for part in _points(seen.tags))
    residual, _ = whitened_residuals(np.stack(found), corners, ideal, whitener)
    chi2 = (residual * residual).sum(axis=(1, 2))
    if seen.body.on_floor:
        chi2 += [_lean(T, camera) ** 2 / _lean_variance(camera) for T in found]
    best, *others = (int(k) for k in np.argsort(chi2))
    hopeless = _HOPELESS * max(float(chi2[best]), NOISE_CHI2)
    rivals = (k for k in others if chi2[k] < hopeless and angle_between(found[k], found[best]) > SAME_RAD)
    return [found[best], *(found[k] for k in islice(rivals, 1))]


def _near(seen: SeenBody, T_camera_body: Transform) -> bool:
    """Tell whether all corners lie within half a tag of where this pose has them: a fit from there finds them."""
    for tag in seen.tags:
        corners = apply(T_camera_body, tag.corners_m)
        if corners[:, 2].min() <= 0.0:
            return False
        off = (tag.points.px_per_ideal @ (corners[:, :2] / corners[:, 2:] - tag.points.ideal)[..., None])[..., 0]
        if float(np.abs(off).max()) > 0.5 * tag.width_px:
            return False
    return True


def _points(tags: Sequence[SeenTag]) -> tuple[Array, Array, Array]:
    """Return the corners (n, 3), ideal points (n, 2) and whitener (n, 2, 2) of all tags of one body."""
    return (
        np.concatenate([tag.corners_m for tag in tags]),
        np.concatenate([tag.points.ideal for tag in tags]),
        np.concatenate([tag.points.whitener for tag in tags]),
    )


def _fit(started: Sequence[tuple[SeenBody, list[Transform]]], camera: CameraPose) -> PoseFit:
    """Refine all candidates of all bodies in one stack, in their order; bodies with fewer tags are padded."""
    n = 4 * max(len(body.tags) for body, _ in started)
    T = np.stack([start for _, starts in started for start in starts])
    m = len(T)
    corners, ideal, whitener = np.zeros((m, n, 3)), np.zeros((m, n, 2)), np.zeros((m, n, 2, 2))
    T_prior, information = T.copy(), np.zeros((m, 6, 6))
    upright, row = _upright_information(camera), 0
    for body, starts in started:
        rows, used = slice(row, row + len(starts)), 4 * len(body.tags)
        corners[rows, :used], ideal[rows, :used], whitener[rows, :used] = _points(body.tags)
        corners[rows, used:], ideal[rows, used:] = corners[rows, :1], ideal[rows, :1]
        if body.body.on_floor:
            T_prior[rows] = [_stood_up(start, camera.T_world_camera) for start in starts]
            information[rows, 3:, 3:] = upright
        row += len(starts)
    return refine(T, corners, ideal, whitener, PosePriors(T_prior, information))


def _lean_variance(camera: CameraPose) -> float:
    """Return the variance of a floor body's lean as this camera sees it, in rad2."""
    return UPRIGHT_SIGMA_RAD**2 + float(np.trace(camera.covariance[3:, 3:])) / 3.0


def _lean(T_camera_body: Transform, camera: CameraPose) -> float:
    """Return the angle in radians between a body's z and the vertical."""
    x, y, z = camera.T_world_camera[:3, :3] @ T_camera_body[:3, 2]
    return math.atan2(math.hypot(x, y), z)


def _upright_information(camera: CameraPose) -> Array:
    """Return (3, 3) information on a floor body's rotation, in camera axes: none about the vertical."""
    R = camera.T_world_camera[:3, :3]
    return np.asarray(R.T @ np.diag([1.0, 1.0, 0.0]) @ R / _lean_variance(camera))


def _stood_up(T_camera_body: Transform, T_world_camera: Transform) -> Transform:
    """Turn a body by the least rotation that points its z up."""
    R = T_world_camera[:3, :3]
    return transform(R.T @ upright_rotation(R @ T_camera_body[:3, :3]), T_camera_body[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class _Chosen:
    """Where a body is, with the (6, 6) covariance that its corners leave."""

    seen: SeenBody
    T_camera_body: Transform
    covariance: Array


def _choose(seen: SeenBody, fit: PoseFit, camera: CameraPose) -> _Chosen | None:
    """Return where a body is; None where even the better candidate does not fit.

    Two candidates that the picture (and standing upright) cannot tell apart: the one nearer to the last known
    orientation, else the better one with a covariance that covers both.
    """
    T, best = fit.T_camera_body, int(np.argmin(fit.chi2))
    if not _fits(seen, fit, best, camera):
        return None
    rival = _rival(fit, best)
    if rival is not None and seen.T_world_body is not None:
        T_expected = invert(camera.T_world_camera) @ seen.T_world_body
        best = min((best, rival), key=lambda k: angle_between(T[k], T_expected))
    freedoms = 8 * len(seen.tags) - 6 + (2 if seen.body.on_floor else 0)
    covariance = fit.covariance[best] * inflation(float(fit.chi2[best]), freedoms)
    if rival is not None and seen.T_world_body is None:
        apart = difference(T[rival], T[best])
        covariance = covariance + np.outer(apart, apart)
    return _Chosen(seen, T[best], covariance)


def _fits(seen: SeenBody, fit: PoseFit, k: int, camera: CameraPose) -> bool:
    """Tell whether a candidate's corners lie where they should, and a floor body stands."""
    sigma_px = sum(float(tag.points.sigma_px[0]) for tag in seen.tags) / len(seen.tags)
    stands = not seen.body.on_floor or _lean(fit.T_camera_body[k], camera) <= MAX_LEAN_RAD
    return stands and float(fit.rms_sigma[k]) * sigma_px <= residual_limit_px(seen.width_px)


def _rival(fit: PoseFit, best: int) -> int | None:
    """Return the other candidate where it differs and is about as good."""
    for k in range(len(fit.chi2)):
        differs = k != best and angle_between(fit.T_camera_body[k], fit.T_camera_body[best]) > SAME_RAD
        if differs and not clearly_better(float(fit.chi2[best]), float(fit.chi2[k])):
            return k
    return None


def _sightings(chosen: Sequence[_Chosen], camera: CameraPose, lens: Lens) -> Iterator[Sighting]:
    """Carry all bodies' poses into the world, the corners' and the camera's uncertainty apart (geometry.pose.compose
    of many at once).
    """
    T_camera_body = np.stack([each.T_camera_body for each in chosen])
    T_world_body = camera.T_world_camera @ T_camera_body
    turn, lever = np.zeros((6, 6)), np.tile(np.eye(6), (len(chosen), 1, 1))
    turn[:3, :3] = turn[3:, 3:] = camera.T_world_camera[:3, :3]
    lever[:, :3, 3:] = [-skew(arm_m) for arm_m in T_world_body[:, :3, 3] - camera.T_world_camera[:3, 3]]
    from_corners = turn @ np.stack([each.covariance for each in chosen]) @ turn.T
    from_camera = lever @ camera.covariance @ lever.swapaxes(1, 2)
    centres = [apply(each.T_camera_body, tag.owner.T_owner_tag[:3, 3]) for each in chosen for tag in each.seen.tags]
    qualities_m, first = pixel_quality(lens, np.stack(centres)), 0
    for k, each in enumerate(chosen):
        tags = len(each.seen.tags)
        yield Sighting(
            target_id=each.seen.body.id,
            camera_id=camera.camera_id,
            stamp_s=camera.stamp_s,
            T_world_body=T_world_body[k],
            covariance=from_corners[k],
            camera_covariance=from_camera[k],
            quality_m=float(qualities_m[first : first + tags].min()),
            tags=tags,
        )
        first += tags
