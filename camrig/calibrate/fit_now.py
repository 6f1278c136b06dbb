"""How well a calibration fits now: whether anchors are where they should be in pictures, and whether cameras agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.calibrate.agreement import Agreement, Station, agreement
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import Shot, Sighted, sighted, stops
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import refine
from camrig.geometry.pose import apply, difference, inverse_covariance_pose, invert

LEAST_SIGMA_PX = 0.2
"""Corners are no better than that, however well a few of them happen to fit."""


@dataclass(frozen=True, slots=True, eq=False)
class Off:
    """A camera (at one stop of its head) against the anchors in its picture: (n,) misses of their corners in pixels and
    in mm there, by how many mm and degrees the anchors would have it elsewhere, and one sigma of both.
    """

    anchors: tuple[str, ...]
    miss_px: Array
    miss_mm: Array
    off_mm: float
    off_deg: float
    sigma_mm: float
    sigma_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class FitNow:
    """By camera and stop what its anchors say, and how cameras agree about what several see."""

    by_anchors: Mapping[Station, Off]
    agreement: Agreement
    seen: Mapping[str, int]
    """How many marks of known size each camera saw, in all pictures."""


def fit_now(shots: Sequence[Shot], setup: Setup, T_world_camera: Mapping[Station, Transform]) -> FitNow:
    """Compare pictures with where cameras are said to be, by camera and stop (``stations``)."""
    seen = sighted(shots, setup.lenses, setup.sizes_m, setup.still)
    counts = {name: sum(each.picture.camera == name for each in seen) for name in setup.lenses}
    by_station: dict[Station, list[Sighted]] = {}
    for each in seen:
        if each.mark in setup.anchors:
            by_station.setdefault((each.picture.camera, each.picture.stop), []).append(each)
    by_anchors = {
        station: _off(of_station, setup.anchors, T_world_camera[station])
        for station, of_station in by_station.items()
        if station in T_world_camera
    }
    return FitNow(by_anchors, agreement(seen, setup.lenses, T_world_camera), counts)


def stations(shots: Sequence[Shot], setup: Setup, T_world_base: Mapping[str, Transform]) -> dict[Station, Transform]:
    """Return where cameras were, by where they or their heads' bases are; none where a head did not say its angles."""
    found: dict[Station, Transform] = {}
    for name, T in T_world_base.items():
        if name not in setup.heads:
            found[name, 0] = T
        for k, aim_rad in enumerate(stops(shots, name) if name in setup.heads else ()):
            found[name, k] = T @ setup.heads[name].T_base_camera(aim_rad)
    return found


def _off(seen: Sequence[Sighted], anchors: Mapping[str, Transform], T_world_camera: Transform) -> Off:
    points = np.concatenate([apply(anchors[each.mark], each.points_m) for each in seen])
    ideal = np.concatenate([each.ideal for each in seen])
    scale = np.concatenate([each.px_per_ideal for each in seen])
    in_camera = apply(invert(T_world_camera), points)
    depth = np.maximum(in_camera[:, 2], 1e-3)
    off = in_camera[:, :2] / depth[:, None] - ideal
    miss_px = np.linalg.norm((scale @ off[..., None])[..., 0], axis=1)
    miss_mm = 1e3 * np.linalg.norm(off, axis=1) * depth
    fit = refine(invert(T_world_camera)[None], points[None], ideal[None], scale[None])
    # Each corner's noise is what the fit leaves, of which six numbers were taken.
    left = max(2 * len(points) - 6, 1)
    sigma_px = max(float(np.sqrt(fit.chi2[0] / left)), LEAST_SIGMA_PX)
    T, covariance = inverse_covariance_pose(fit.T_camera_body[0], sigma_px**2 * fit.covariance[0])
    change = difference(T, T_world_camera)
    sigma = np.sqrt([np.linalg.eigvalsh(part)[-1] for part in (covariance[:3, :3], covariance[3:, 3:])])
    return Off(
        anchors=tuple(each.mark for each in seen),
        miss_px=miss_px,
        miss_mm=miss_mm,
        off_mm=1e3 * float(np.linalg.norm(change[:3])),
        off_deg=float(np.degrees(np.linalg.norm(change[3:]))),
        sigma_mm=1e3 * float(sigma[0]),
        sigma_deg=float(np.degrees(sigma[1])),
    )
