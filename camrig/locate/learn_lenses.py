"""Lenses refined in service: what frame after frame says of them adds up, and is known before the next frame.

A frame's evidence is that of its corners alone (geometry.bundle.camera_evidence); what is known of the cameras' poses
enters once (locate.standing): in every frame anew, it would bend lenses to what is wrong with mounts. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.bundle import Adjusted, Estimate, Views, camera_evidence, projected
from camrig.geometry.bundle_kernel import CAMERA
from camrig.geometry.lens.errors import error_slopes
from camrig.geometry.pose import PosePriors, difference
from camrig.locate.fit import inflation
from camrig.locate.joint_problem import Problem, camera_priors
from camrig.locate.lenses import LEAST_SHARE, Lenses, Refined, as_calibrated
from camrig.locate.standing import Standing, aged, begun, carried_on, told
from camrig.locate.views import View
from camrig.messages import Event, Level
from camrig.rig import CameraSpec, Rig

MOVED_PX = 10.0
"""A tag that has moved by less since it last counted shows its corners' old errors again."""

REPEATED = 0.05
"""The part of its information for which such a tag counts, so that what stands still holds the cameras in place."""

BOUND_SIGMAS = 3.0
"""No number moves further from the calibration; one that would tells that the calibration is wrong."""

TOLD_SIGMAS = 0.5
"""An operator is told again when a number has moved by more."""


def learn(
    lenses: Lenses, problem: Problem, found: Adjusted, views: Sequence[View], rig: Rig
) -> tuple[Lenses, tuple[Event, ...]]:
    """Return what is known of the lenses after one more joint estimate, and what an operator should know of it.

    ``views`` are the problem's: what carries their cameras counts, whatever was believed of their poses there.
    Nothing is learnt where no camera asks for it, or where no tag has moved since it last counted.
    """
    wanted = [camera for camera in rig.cameras.values() if camera.refine_lens]
    if not wanted or not len(problem.views.camera):
        return lenses, ()
    places = [((problem.camera_ids[c], tag.key), np.asarray(tag.detection.centre_px)) for c, tag in problem.rows]
    moved = np.array([_has_moved(lenses.counted.get(key), at_px) for key, at_px in places])
    if not moved.any():
        return lenses, ()
    counted = {**lenses.counted, **{key: at_px for (key, at_px), new in zip(places, moved, strict=True) if new}}
    stamp_s = max(lenses.stamp_s, *problem.camera_stamps_s)
    carriers, _ = camera_priors(views, [view.carried for view in views])
    standing = aged(lenses.standing or begun(rig, stamp_s), rig, stamp_s)
    standing = carried_on(standing, rig, problem.camera_ids, carriers)
    weight = np.where(moved, 1.0, REPEATED)
    standing = told(standing, rig, problem.camera_ids, *_evidence(problem, found, carriers, rig, weight))
    refined = {
        camera.id: _refined(standing, k, camera) for k, camera in enumerate(rig.cameras.values()) if camera.refine_lens
    }
    grown = replace(lenses, stamp_s=stamp_s, standing=standing, refined=refined, counted=counted)
    news = {camera.id: grown.refined[camera.id] for camera in wanted if _is_news(camera, grown)}
    events = tuple(_event(rig.cameras[name], each, stamp_s) for name, each in news.items())
    return replace(grown, told={**lenses.told, **news}), events


def _has_moved(before_px: Array | None, at_px: Array) -> bool:
    return before_px is None or float(np.linalg.norm(at_px - before_px)) >= MOVED_PX


def _evidence(problem: Problem, found: Adjusted, carriers: PosePriors, rig: Rig, weight: Array) -> tuple[Array, Array]:
    """Return what one estimate's corners say of its cameras, for ``standing.told``; less where they fit badly."""
    at = found.estimate
    information, gradient = camera_evidence(_as_fitted(problem, at, rig).weighed(weight), problem.bodies, at)
    pairs = zip(at.cameras, carriers.T, at.lenses, strict=True)
    errors = np.concatenate([np.concatenate([difference(T, T_carried), lens]) for T, T_carried, lens in pairs])
    unknowns = CAMERA * len(problem.camera_ids) + 6 * len(problem.names)
    badness = inflation(float(found.chi2.sum()), max(8 * len(found.chi2) - unknowns, 4))
    return information / badness, (information @ errors - gradient) / badness


def _as_fitted(problem: Problem, at: Estimate, rig: Rig) -> Views:
    """Return the views with the slopes of their lenses at the points where the estimate has the corners."""
    ideal = projected(problem.views, at)
    slopes = np.empty_like(problem.views.lens_slopes)
    for c, name in enumerate(problem.camera_ids):
        own = problem.views.camera == c
        slopes[own] = error_slopes(rig.cameras[name].lens, ideal[own])
    sigma_px = np.array([tag.points.sigma_px for _, tag in problem.rows])
    return replace(problem.views, lens_slopes=slopes / sigma_px[..., None, None])


def _refined(standing: Standing, k: int, camera: CameraSpec) -> Refined:
    """Return what calibration and evidence say of a camera's lens together."""
    sigma = np.asarray(camera.lens_sigma)
    mean, covariance = standing.lens(k)
    held = np.clip(mean, -BOUND_SIGMAS * sigma, BOUND_SIGMAS * sigma)
    return Refined(held, covariance + np.diag(np.square(LEAST_SHARE * sigma)), bool((held != mean).any()))


def _is_news(camera: CameraSpec, lenses: Lenses) -> bool:
    now, before = lenses.refined[camera.id], lenses.told.get(camera.id) or as_calibrated(camera)
    far = np.abs(now.mean - before.mean) > TOLD_SIGMAS * np.asarray(camera.lens_sigma)
    return bool(far.any()) or now.bounded > before.bounded


def _event(camera: CameraSpec, refined: Refined, stamp_s: float) -> Event:
    f, cx, cy, k1 = refined.mean
    text = (
        f"lens refined by f {100.0 * f:+.3f} %, centre {cx:+.2f} {cy:+.2f} px, k1 {k1:+.5f}: "
        f"corners were {_rms_px(camera, refined.mean):.2f} px off"
    )
    if not refined.bounded:
        return Event(stamp_s, Level.INFO, camera.id, text)
    text += f"; more than {BOUND_SIGMAS:g} sigma from its calibration, and held there: calibrate it anew"
    return Event(stamp_s, Level.WARNING, camera.id, text)


def _rms_px(camera: CameraSpec, mean: Array) -> float:
    """Return by how much a lens's errors move corners, over the picture."""
    width, height = camera.lens.size_px
    pixels = np.stack(np.meshgrid(np.linspace(0, width, 9), np.linspace(0, height, 7)), axis=-1).reshape(-1, 2)
    shifts = error_slopes(camera.lens, camera.lens.unproject(pixels)) @ mean
    return float(np.sqrt(np.nanmean(np.square(shifts).sum(axis=1))))
