"""How far a calibrated lens may be trusted, and which form of lens the pictures speak for.

Held out: pictures that had no part in the fit, their poses found through its lens. Uncertainty: by how many pixels a
known direction may be off, one sigma, after the turn of the camera that hides most of it, since whatever calibrates
the camera's pose would take that in (as mrcal's projection uncertainty does).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from camrig.calibrate.lens_fit import LensFit, Points, fit_lens, fit_poses
from camrig.calibrate.lens_forms import FX, FY, LensForm, pixel_slopes, sensor_slopes
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens
from camrig.geometry.lens.pinhole import one_to_one_radius

FOLDS = 5
_FOLD_STEPS = 15
"""Steps from one form to the next, held-out pictures left out."""

GRID = (16, 12)
"""Columns and rows of the map of uncertainty."""

UNKNOWN_PX = 1000.0
"""What the map says at most, and where the lens is not one-to-one."""

_PRICE = 0.002
"""By what share each number of a lens must lower the rms of pictures held out, to be worth having."""

_AS_KNOWN = 3.0
"""A lens whose map is worse than the best map by more than this factor follows its pictures and nothing else."""

_PLAIN, _FIRM = 8, 0.005
"""A lens of more numbers is for pictures that tell its focal length this well."""

_FISHEYE_GAIN = 0.97
"""A fisheye is taken where it leaves less than this share of what a plain Brown-Conrady lens does."""

_TRUSTED_PX = 1.0
"""How uncertain a direction may be that still counts as calibrated."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A form with its fit to all pictures, the mean square (n,) of each when held out, and its map (rows, columns), all
    in pixels.
    """

    fit: LensFit
    heldout_px2: Array
    map_px: Array

    @property
    def heldout_rms_px(self) -> float:
        """Return the rms distance of the points of pictures that had no part in the lens."""
        points = self.fit.points.there.sum(axis=1)
        return float(np.sqrt((points * self.heldout_px2).sum() / points.sum()))

    @property
    def priced_px(self) -> float:
        """Return the rms of pictures held out, with the price of the lens's numbers."""
        return float(self.heldout_rms_px * (1.0 + _PRICE * self.fit.form.basis.shape[1]))

    @property
    def is_plain(self) -> bool:
        """Tell whether it has no more numbers than most lenses need."""
        return bool(self.fit.form.basis.shape[1] <= _PLAIN)

    @property
    def is_firm(self) -> bool:
        """Tell whether its focal length is known well."""
        return math.sqrt(max(float(self.fit.covariance[FX, FX]), 0.0)) < _FIRM * float(self.fit.numbers[FX])

    @property
    def map_rms_px(self) -> float:
        """Return the map's root mean square."""
        return float(np.sqrt(np.mean(np.square(self.map_px))))


def candidates(points: Points, forms: Sequence[LensForm], step: Callable[[], None] = lambda: None) -> list[Candidate]:
    """Fit forms of one kind, each begun at the one before; those that do not settle are left out.

    What is held out climbs the ladder by itself, so that it owes nothing to the pictures it is judged by.
    """
    count = len(points.there)
    fold = np.arange(count) % min(FOLDS, count)
    fits: list[LensFit] = []
    rests: list[LensFit] = []
    found: list[Candidate] = []
    for form in forms:
        try:
            fit = fit_lens(points, form, fits[-1] if fits else None)
            starts = rests or [_those_of(fit, fold != each) for each in range(min(FOLDS, count))]
            rests = [fit_lens(start.points, form, start, _FOLD_STEPS) for start in starts]
            fits.append(fit)
            found.append(Candidate(fit, _heldout_px2(fit, fold, rests), uncertainty_px(fit)))
        except InputError:
            pass
        step()
    return found


def _those_of(fit: LensFit, pictures: npt.NDArray[np.bool_]) -> LensFit:
    return replace(
        fit,
        T_camera_board=fit.T_camera_board[pictures],
        residual_px=fit.residual_px[pictures],
        points=fit.points.of(pictures),
    )


def _heldout_px2(fit: LensFit, fold: npt.NDArray[np.int64], rests: Sequence[LensFit]) -> Array:
    """Return (n,) each picture's mean square distance in pixels through the lens of those of the other folds."""
    found = np.zeros(len(fold))
    for each, rest in enumerate(rests):
        held = fold == each
        poses = fit_poses(fit.points.of(held), fit.form, rest.numbers, fit.T_camera_board[held])
        found[held] = np.square(poses.rms_by_picture_px)
    return found


def best_of(found: Sequence[Candidate]) -> Candidate:
    """Return the candidate that the pictures speak for: of those that know the whole picture about as well as any, the
    best at pictures held out, where each number has its price. A fisheye has to be clearly better.

    Raises InputError where there is none.
    """
    kinds = [[each for each in found if each.fit.form.fisheye == fisheye] for fisheye in (False, True)]
    brown, fisheye = (_best_of_kind(kind) if kind else None for kind in kinds)
    if brown is None and fisheye is None:
        raise InputError("no lens fits these pictures: is it the right board, and are there several views of it?")
    if brown is None or fisheye is None:
        return brown or fisheye or found[0]
    gain = _FISHEYE_GAIN if brown.is_plain else 1.0
    return fisheye if fisheye.priced_px < gain * brown.priced_px else brown


def _best_of_kind(found: Sequence[Candidate]) -> Candidate:
    least = min(each.map_rms_px for each in found if each.is_plain)
    known = [each for each in found if each.map_rms_px <= _AS_KNOWN * least and (each.is_plain or each.is_firm)]
    return min(known, key=lambda each: each.priced_px)


def uncertainty_px(fit: LensFit) -> Array:
    """Return (rows, columns) one sigma of where directions appear, over the picture; ``UNKNOWN_PX`` at most."""
    pixels = picture_grid(fit.points.size_px)
    ideal = fit.form.lens(fit.numbers, fit.points.size_px).unproject(pixels)
    known = np.isfinite(ideal).all(axis=-1)
    sigma_px = np.full(pixels.shape[:-1], UNKNOWN_PX)
    sigma_px[known] = _sigma(_unhidden(fit, ideal[known])[0], fit.covariance)
    return np.asarray(np.minimum(sigma_px, UNKNOWN_PX))


def sideways_mm(fit: LensFit, distance_m: float) -> Array:
    """Return (rows, columns) by how many millimetres, one sigma, a point so far ahead is misplaced sideways; NaN where
    the lens is not one-to-one.
    """
    ideal = fit.form.lens(fit.numbers, fit.points.size_px).unproject(picture_grid(fit.points.size_px))
    known = np.isfinite(ideal).all(axis=-1)
    slopes, _ = _unhidden(fit, ideal[known])
    across = np.asarray(np.linalg.solve(_pixel_by_ideal(fit, ideal[known]), slopes))
    found = np.full(known.shape, np.nan)
    found[known] = 1000.0 * distance_m * _sigma(across, fit.covariance)
    return found


def calibrated_radius(fit: LensFit) -> float:
    """Return ``r_max``: how far off the axis the lens is known, to a pixel or because points were seen there; within
    the picture, and where it is one-to-one.
    """
    size_px = fit.points.size_px
    lens = fit.form.lens(fit.numbers, size_px)
    camera_m = np.einsum("nij,nmj->nmi", fit.T_camera_board[:, :3, :3], fit.points.board_m)
    camera_m += fit.T_camera_board[:, None, :3, 3]
    seen = np.hypot(*(camera_m[fit.points.there][:, :2] / camera_m[fit.points.there][:, 2:]).T).max()
    grid = lens.unproject(picture_grid(size_px)).reshape(-1, 2)
    corner = float(np.nanmax(np.hypot(grid[:, 0], grid[:, 1])))
    radii = np.linspace(0.0, min(1.02 * corner, lens.r_max), 60)[1:]
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    rings = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    _, turn = _unhidden(fit, grid[np.isfinite(grid).all(axis=-1)])
    slopes = pixel_slopes(fit.form, fit.numbers, rings) - _turned(fit, rings) @ turn
    loose = np.flatnonzero(_sigma(slopes, fit.covariance).max(axis=1) > _TRUSTED_PX)
    trusted = radii[loose[0] - 1] if loose.size and loose[0] else (0.0 if loose.size else radii[-1])
    radius = min(max(float(seen), float(trusted)), lens.r_max)
    return one_to_one_radius(lens, radius)


def difference_px(lens: Lens, other: Lens) -> dict[str, float] | None:
    """Return by how many pixels two lenses disagree on directions over the picture, after the turn that hides most of
    it: ``median`` and ``worst``; None where they are of different sizes or share no part of it.
    """
    if lens.size_px != other.size_px:
        return None
    ideal = [each.unproject(picture_grid(lens.size_px)).reshape(-1, 2) for each in (lens, other)]
    both = np.isfinite(ideal[0]).all(axis=-1) & np.isfinite(ideal[1]).all(axis=-1)
    if both.sum() < 4:
        return None
    a, b = (np.concatenate([each[both], np.ones((both.sum(), 1))], axis=-1) for each in ideal)
    a, b = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (a, b))
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    angle = np.arccos(np.clip((a @ R.T * b).sum(axis=-1), -1.0, 1.0))
    apart = angle * lens.focal_px[0]
    return {"median": float(np.median(apart)), "worst": float(apart.max())}


def picture_grid(size_px: tuple[int, int]) -> Array:
    """Return (rows, columns, 2) pixels spread over a picture, its edges included."""
    x, y = (np.linspace(0.0, side - 1.0, count) for side, count in zip(size_px, GRID, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1)


def _unhidden(fit: LensFit, ideal: Array) -> tuple[Array, Array]:
    """Return (n, 2, size) slopes of the pixels of (n, 2) directions by the lens's numbers less what a turn of the
    camera hides, and that turn, (3, size).
    """
    slopes, turned = pixel_slopes(fit.form, fit.numbers, ideal), _turned(fit, ideal)
    turn = np.asarray(np.linalg.lstsq(turned.reshape(-1, 3), slopes.reshape(-1, fit.form.size), rcond=None)[0])
    return slopes - turned @ turn, turn


def _turned(fit: LensFit, ideal: Array) -> Array:
    """Return (..., 2, 3): how pixels move with a small turn of the directions about x, y, z."""
    a, b = ideal[..., 0], ideal[..., 1]
    d_ideal = np.empty((*ideal.shape, 3))
    d_ideal[..., 0, 0], d_ideal[..., 0, 1], d_ideal[..., 0, 2] = -a * b, 1.0 + a * a, -b
    d_ideal[..., 1, 0], d_ideal[..., 1, 1], d_ideal[..., 1, 2] = -1.0 - b * b, a * b, a
    return np.asarray(_pixel_by_ideal(fit, ideal) @ d_ideal)


def _pixel_by_ideal(fit: LensFit, ideal: Array) -> Array:
    return np.asarray(fit.numbers[[FX, FY], None] * sensor_slopes(fit.form, fit.numbers, ideal))


def _sigma(slopes: Array, covariance: Array) -> Array:
    """Return (...,) the root of the summed variances of both axes."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("...ij,jk,...ik->...", slopes, covariance, slopes), 0.0)))
