"""Anchors in view correct a camera's pose, or give it where nothing else does: one MAP estimate from all corners.

The unknown of the fit is ``T_camera_world``, so anchors are one big body and ``geometry.pnp.refine`` does the work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import PoseFit, refine, square_poses, whitened_residuals
from camrig.geometry.pose import PosePriors, inverse_covariance_pose, invert
from camrig.locate.fit import SAME_RAD, angle_between, clearly_better, inflation, residual_limit_px
from camrig.locate.tags import SeenTag
from camrig.messages import CameraPose
from camrig.rig import TagKey

GATE_CHI2 = 42.7
"""chi2 of 8 numbers that chance exceeds once in a million: an anchor beyond it is not where the rig says."""

GATE_CORNER_PX = 0.5
"""Corner noise that the gate allows: it is after gross errors, not after a corner's bend."""


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """The camera's pose after its anchors; those that contradict it; whether they left two poses to choose from."""

    pose: CameraPose | None
    misplaced: tuple[TagKey, ...] = ()
    undecided: bool = False


def correct(prior: CameraPose, anchors: Sequence[SeenTag]) -> Corrected:
    """Return the most probable pose given the carrier's pose and all anchors that do not grossly contradict it."""
    T_camera_world, covariance = inverse_covariance_pose(prior.T_world_camera, prior.covariance)
    fitting = [anchor for anchor in anchors if _gate_chi2(anchor, T_camera_world, covariance) <= GATE_CHI2]
    information = np.linalg.inv(covariance)[None]
    belief = PosePriors(T_camera_world[None], np.asarray(information, float))
    while fitting:
        fit = _fit(T_camera_world[None], fitting, belief)
        worst = _worst(fit.T_camera_body[0], fitting)
        if worst is None:
            return Corrected(
                _as_pose(prior.camera_id, prior.stamp_s, fit, 0, 8 * len(fitting)), _missing(anchors, fitting)
            )
        fitting.remove(worst)
    return Corrected(prior, _missing(anchors, fitting))


Belief = Callable[[Sequence[Transform]], PosePriors]
"""What is known of a camera's tilt alone: the prior of each ``T_camera_world`` from which a fit starts."""


def from_anchors_alone(
    camera_id: str, stamp_s: float, anchors: Sequence[SeenTag], belief: Belief | None = None
) -> Corrected:
    """Return the pose of a camera of whose place nothing is known beforehand; None where two poses fit equally well."""
    fitting = list(anchors)
    while fitting and (starts := _starts(fitting)):
        fit = _fit(np.stack(starts), fitting, belief(starts) if belief is not None else None)
        best = int(np.argmin(fit.chi2))
        worst = _worst(fit.T_camera_body[best], fitting)
        if worst is None:
            freedoms = 8 * len(fitting) - 6
            undecided = _rival(fit, best)
            pose = None if undecided else _as_pose(camera_id, stamp_s, fit, best, freedoms)
            return Corrected(pose, _missing(anchors, fitting), undecided)
        fitting.remove(worst)
    return Corrected(None, _missing(anchors, fitting))


def _starts(anchors: Sequence[SeenTag]) -> list[Transform]:
    """Return ``T_camera_world`` from both solutions of every anchor, those that see all anchors in front."""
    starts = [
        square.T_camera_tag @ invert(anchor.owner.T_owner_tag)
        for anchor in anchors
        for square in square_poses(anchor.points.ideal, anchor.points.px_per_ideal, anchor.owner.size_m)
    ]
    corners = np.concatenate([anchor.corners_m for anchor in anchors])
    return [T for T in starts if (corners @ T[2, :3] + T[2, 3] > 0.0).all()]


def _fit(starts: Array, anchors: Sequence[SeenTag], prior: PosePriors | None) -> PoseFit:
    m = len(starts)
    corners, ideal, whitener = (
        np.repeat(np.concatenate(parts)[None], m, axis=0)
        for parts in zip(*((a.corners_m, a.points.ideal, a.points.whitener) for a in anchors), strict=True)
    )
    return refine(starts, corners, ideal, whitener, prior)


def _rival(fit: PoseFit, best: int) -> bool:
    """Tell whether another pose explains the picture about as well as the best."""
    return any(
        angle_between(fit.T_camera_body[k], fit.T_camera_body[best]) > SAME_RAD
        and not clearly_better(float(fit.chi2[best]), float(fit.chi2[k]))
        for k in range(len(fit.chi2))
    )


def _worst(T_camera_world: Transform, anchors: Sequence[SeenTag]) -> SeenTag | None:
    """Return the anchor whose corners lie furthest off, if further than corners may."""
    excess = [_rms_px(T_camera_world, anchor) / residual_limit_px(anchor.width_px) for anchor in anchors]
    k = int(np.argmax(excess))
    return anchors[k] if excess[k] > 1.0 else None


def _rms_px(T_camera_world: Transform, anchor: SeenTag) -> float:
    residual, _ = _residuals(T_camera_world, anchor)
    return float(np.sqrt((residual * residual).sum() / 4.0)) * float(anchor.points.sigma_px[0])


def _gate_chi2(anchor: SeenTag, T_camera_world: Transform, covariance: Array) -> float:
    """Return the squared Mahalanobis distance of an anchor's corners from where the prior puts them."""
    residual, J = _residuals(T_camera_world, anchor)
    noise = max(1.0, GATE_CORNER_PX / float(anchor.points.sigma_px[0])) ** 2
    S = noise * np.eye(8) + J @ covariance @ J.T
    return float(residual @ np.linalg.solve(S, residual))


def _residuals(T_camera_world: Transform, anchor: SeenTag) -> tuple[Array, Array]:
    """Return the (8,) whitened residuals of one anchor and their (8, 6) derivative."""
    residual, J = whitened_residuals(
        T_camera_world[None], anchor.corners_m[None], anchor.points.ideal[None], anchor.points.whitener[None]
    )
    return residual.reshape(8), J.reshape(8, 6)


def _as_pose(camera_id: str, stamp_s: float, fit: PoseFit, k: int, freedoms: int) -> CameraPose:
    covariance = fit.covariance[k] * inflation(float(fit.chi2[k]), freedoms)
    return CameraPose(camera_id, stamp_s, *inverse_covariance_pose(fit.T_camera_body[k], covariance))


def _missing(anchors: Sequence[SeenTag], fitting: Sequence[SeenTag]) -> tuple[TagKey, ...]:
    used = {anchor.key for anchor in fitting}
    return tuple(anchor.key for anchor in anchors if anchor.key not in used)
