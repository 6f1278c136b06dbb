"""Where bodies are by the pictures of one instant: the paper's means of single cameras' poses, and camrig's estimates.

All get the same detections, with pixel centres and lens put right: what differs is the estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from camrig import fuse, locate
from camrig.experiments.photographs import STAMP_S, Photograph, histories
from camrig.experiments.rooms import Room
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import observe_tags, square_poses
from camrig.locate.tags import owners
from camrig.messages import Aim, Fix, TagDetections
from camrig.rig import Rig
from camrig.sensing import fused, pixel_quality

Estimator = Literal["mean", "quality", "mean refined", "quality refined", "covariance", "joint", "joint exact"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)
PAPERS: tuple[Estimator, ...] = ("mean", "quality", "mean refined", "quality refined")
"""Equal weights, and weights 1/Q; with the detector's corners, and with camrig's refined ones."""

_EXACT_POSE = np.diag([1e-6**2] * 3 + [1e-6**2] * 3)
_EXACT_LENS = (1e-7, 1e-4, 1e-4, 1e-7)
"""One sigma of what is told to be exact: nothing that shows, and nothing singular."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """A body's place (3,) in the world, and its (3, 3) covariance where the estimator has one."""

    position_m: Array
    covariance_m2: Array | None = None


Estimates = Mapping[str, Estimated]
"""By body's id; who is not in it was not found."""


def estimates(room: Room, aims: Mapping[str, Aim], photographs: Mapping[str, Photograph]) -> dict[Estimator, Estimates]:
    """Return where every estimator has the bodies, by what the photographs (by camera) of one instant show.

    ``joint`` is camrig as it runs, which takes no mount and no lens for exact; ``joint exact`` is told that cameras and
    lenses are exactly what they are believed to be, as the paper's means take for granted.
    """
    detected = single_poses(room, aims, {name: each.detected for name, each in photographs.items()})
    refined = single_poses(room, aims, {name: each.refined for name, each in photographs.items()})
    views = _views(room, aims, photographs)
    motions = fuse.motions(fuse.Tracks(), room.rig, STAMP_S)
    return {
        "mean": _weighted(detected, _equally),
        "quality": _weighted(detected, _by_quality),
        "mean refined": _weighted(refined, _equally),
        "quality refined": _weighted(refined, _by_quality),
        "covariance": _by_covariance(locate.apart(views).fixes),
        "joint": _of_fixes(locate.joint(views, (), motions, room.rig)),
        "joint exact": _of_fixes(
            locate.joint([_taken_for_exact(view) for view in views], (), motions, _with_exact_lenses(room.rig))
        ),
    }


def fused_quality_m(room: Room, aims: Mapping[str, Aim], photographs: Mapping[str, Photograph]) -> dict[str, float]:
    """Return the paper's fused Q of every body that was detected, 1 / sum 1/Q over the cameras that detected it."""
    poses = single_poses(room, aims, {name: each.detected for name, each in photographs.items()})
    return {name: float(fused(1.0 / np.array([each.quality_m for each in seen]))) for name, seen in poses.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Single:
    """A body by one picture alone: its place (3,) in the world, and the paper's Q there."""

    position_m: Array
    quality_m: float


def single_poses(
    room: Room, aims: Mapping[str, Aim], detections: Mapping[str, TagDetections]
) -> dict[str, list[Single]]:
    """Return each body's poses by every camera: of the two that a square allows, the one that fits better."""
    known, found = owners(room.rig), dict[str, list[Single]]()
    for camera_id, seen in detections.items():
        lens, T_world_camera = room.rig.cameras[camera_id].lens, room.believed_pose(camera_id, aims[camera_id])
        for tag in seen.tags:
            owner = known.get(tag.key)
            if owner is None or owner.target_id is None:
                continue
            points = observe_tags(lens, tag.corners_px[None]).of(0)
            poses = square_poses(points.ideal, points.px_per_ideal, owner.size_m)
            if poses:
                T_camera_body: Transform = poses[0].T_camera_tag
                quality_m = float(pixel_quality(lens, T_camera_body[:3, 3]))
                position_m = (T_world_camera @ T_camera_body)[:3, 3]
                found.setdefault(owner.target_id, []).append(Single(position_m, quality_m))
    return found


def _equally(seen: Sequence[Single]) -> Array:
    return np.ones(len(seen))


def _by_quality(seen: Sequence[Single]) -> Array:
    return 1.0 / np.array([each.quality_m for each in seen])


def _weighted(poses: Mapping[str, list[Single]], weigh: Callable[[Sequence[Single]], Array]) -> Estimates:
    return {
        name: Estimated(np.average([each.position_m for each in seen], axis=0, weights=weigh(seen)))
        for name, seen in poses.items()
    }


def _views(room: Room, aims: Mapping[str, Aim], photographs: Mapping[str, Photograph]) -> list[locate.View]:
    said = histories(room, aims)
    located = [locate.locate(each.refined, said, room.rig, {}) for each in photographs.values()]
    return [each.view for each in located if each.view is not None]


def _by_covariance(fixes: Sequence[Fix]) -> Estimates:
    """Weigh what single cameras say by the inverse of its whole covariance."""
    gathered: dict[str, list[Fix]] = {}
    for fix in fixes:
        gathered.setdefault(fix.target_id, []).append(fix)
    found = {}
    for name, seen in gathered.items():
        weights = np.linalg.inv(np.array([fix.whole[:3, :3] for fix in seen]))
        covariance = np.linalg.inv(weights.sum(axis=0))
        places = np.array([fix.T_world_body[:3, 3] for fix in seen])
        found[name] = Estimated(covariance @ (weights @ places[..., None]).sum(axis=0)[:, 0], covariance)
    return found


def _of_fixes(found: locate.Together) -> Estimates:
    return {fix.target_id: Estimated(fix.T_world_body[:3, 3], fix.whole[:3, :3]) for fix in found.fixes}


def _taken_for_exact(view: locate.View) -> locate.View:
    if view.carried is None:
        return view
    exact = replace(view.carried, covariance=_EXACT_POSE)
    return replace(view, carried=exact, found=exact)


def _with_exact_lenses(rig: Rig) -> Rig:
    return replace(rig, cameras={name: replace(each, lens_sigma=_EXACT_LENS) for name, each in rig.cameras.items()})
