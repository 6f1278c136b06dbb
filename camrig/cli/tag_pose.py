"""The pose of a single tag before a camera, as ``camrig detect`` reports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import TAG_CORNERS, PoseFit, observe_tags, refine, square_poses
from camrig.locate.fit import SAME_RAD, angle_between, clearly_better, inflation


@dataclass(frozen=True, slots=True, eq=False)
class TagPose:
    """The better pose, one sigma (3,) of its position along the camera's axes, and how many other poses explain the
    corners so well that one picture cannot rule them out.
    """

    T_camera_tag: Transform
    sigma_m: Array
    alternatives: int


def tag_pose(lens: Lens, corners_px: Array, size_m: float, refined: Sequence[bool] = (False,) * 4) -> TagPose | None:
    """Place a tag by its (4, 2) corners p0..p3, some of them ``refined`` through the lens; None past the lens's
    ``r_max`` or where they are no square's.
    """
    points = observe_tags(lens, corners_px[None], np.array([refined]))
    ideal = points.ideal[0]
    if not np.isfinite(ideal).all():
        return None
    starts = [pose.T_camera_tag for pose in square_poses(ideal, points.px_per_ideal[0], size_m)]
    if not starts:
        return None
    several = (len(starts), 1, 1)
    fit = refine(
        np.stack(starts),
        np.tile(size_m * TAG_CORNERS, several),
        np.tile(ideal, several),
        np.tile(points.whitener[0], (*several, 1)),
    )
    best = int(np.argmin(fit.chi2))
    covariance = fit.covariance[best] * inflation(float(fit.chi2[best]), 2)
    return TagPose(fit.T_camera_body[best], np.sqrt(np.diag(covariance)[:3]), _alternatives(fit, best))


def _alternatives(fit: PoseFit, best: int) -> int:
    T = fit.T_camera_body
    return sum(
        angle_between(T[other], T[best]) > SAME_RAD and not clearly_better(fit.chi2[best], fit.chi2[other])
        for other in range(len(T))
    )
