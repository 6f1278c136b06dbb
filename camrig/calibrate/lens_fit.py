"""One lens and the board's pose in every picture, from the board's points: robust least squares, with covariances.

Levenberg-Marquardt; each picture's pose is eliminated from the normal equations (Schur complement), so the work grows
with the pictures. A point far off counts in proportion to its root (Huber). Source: Triggs et al., "Bundle Adjustment
- A Modern Synthesis" (2000), sections 4 and 6; Zhang, "A flexible new technique for camera calibration" (2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from camrig.calibrate.lens_forms import CX, CY, FX, FY, LensForm, pixel_slopes, sensor_of, sensor_slopes
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.pose import perturb, transform

HUBER_SIGMAS = 3.0
_MEDIAN_OF_NORMAL = 0.6745
_STEPS = 40
_POSE_STEPS = 8
_TRIAL_STEPS = 12
_DONE_SHARE = 1e-7
_NEAREST = 1e-3
"""Depth over the board's size: what is nearer, or behind, is no picture of it."""

_FISHEYE_FIELD_RAD = 1.45
"""Where a guessed fisheye puts a point further off its axis, the point waits for a better guess."""

_FOCAL_SHARES = (0.45, 0.7, 1.0, 1.6, 2.6)
"""Focal lengths that are tried, over the picture's larger side."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """What n pictures show of a board, padded to the most points m: (n, m, 3) metres, (n, m, 2) pixels, (n, m) mask."""

    size_px: tuple[int, int]
    board_m: Array
    seen_px: Array
    there: npt.NDArray[np.bool_]

    def of(self, pictures: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> Points:
        """Return those of some pictures."""
        return Points(self.size_px, self.board_m[pictures], self.seen_px[pictures], self.there[pictures])


def points_of(size_px: tuple[int, int], views: Sequence[tuple[Array, Array]]) -> Points:
    """Stack pictures' ((k, 3) board points in metres, (k, 2) pixels)."""
    most = max(len(pixels) for _, pixels in views)
    board_m, seen_px = np.zeros((len(views), most, 3)), np.zeros((len(views), most, 2))
    there = np.zeros((len(views), most), bool)
    for index, (points, pixels) in enumerate(views):
        board_m[index, : len(points)], seen_px[index, : len(pixels)] = points, pixels
        there[index, : len(pixels)] = True
    return Points(size_px, board_m, seen_px, there)


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """The lens's numbers, (n, 4, 4) ``T_camera_board``, (n, m, 2) residuals in pixels (0 where no point is), one sigma
    of their noise along an axis, and the covariance of the numbers (size, size), poses unknown too.
    """

    form: LensForm
    numbers: Array
    T_camera_board: Array
    residual_px: Array
    noise_px: float
    covariance: Array
    points: Points

    @property
    def rms_px(self) -> float:
        """The root mean square distance of points from where they were seen."""
        return float(np.sqrt(np.square(self.residual_px).sum() / self.points.there.sum()))

    @property
    def rms_by_picture_px(self) -> Array:
        """The same of each picture, (n,)."""
        return np.asarray(np.sqrt(np.square(self.residual_px).sum(axis=(1, 2)) / self.points.there.sum(axis=1)))


def fit_lens(points: Points, form: LensForm, start: LensFit | None = None, steps: int = _STEPS) -> LensFit:
    """Find a lens of a form and all poses, from a fit of another form of the same kind and pictures, or from nothing,
    in at most so many steps.

    Raises InputError where the pictures do not determine them.
    """
    if start is None:
        return _from_nothing(points, form)
    numbers = np.where(form.basis.any(axis=1), start.numbers, 0.0)
    if form.square:
        numbers[[FX, FY]] = numbers[[FX, FY]].mean()
    return _refined(points, form, numbers, start.T_camera_board, steps=steps)


def fit_poses(points: Points, form: LensForm, numbers: Array, start: Array) -> LensFit:
    """Find the poses alone, from (n, 4, 4) ``start``, through a lens that is known."""
    return _refined(points, form, numbers, start, lens_free=False, steps=_POSE_STEPS)


def _from_nothing(points: Points, form: LensForm) -> LensFit:
    """Try several focal lengths, and keep the one that ends best."""
    width, height = points.size_px
    simplest = LensForm(form.fisheye, ("k1",), square=True)
    trials = []
    for share in _FOCAL_SHARES:
        numbers = np.zeros(form.size)
        numbers[[FX, FY]] = share * max(width, height)
        numbers[[CX, CY]] = 0.5 * (width - 1.0), 0.5 * (height - 1.0)
        try:
            T = _poses_of(points, simplest, numbers)
            trials.append(_refined(points, simplest, numbers, T, steps=_TRIAL_STEPS))
        except (InputError, cv2.error):
            continue
    if not trials:
        raise InputError("no lens fits these pictures: is it the right board, and are there several views of it?")
    best = min(trials, key=lambda fit: fit.rms_px)
    return fit_lens(points, form, best)


def _poses_of(points: Points, form: LensForm, numbers: Array) -> Array:
    """Return (n, 4, 4) poses that planes of points have, seen through a lens without bend, or the simplest fisheye."""
    sensor = (points.seen_px - numbers[[CX, CY]]) / numbers[[FX, FY]]
    poses = []
    for ideal, board_m, there in zip(_unbent(form, numbers, sensor), points.board_m, points.there, strict=True):
        mine = there & np.isfinite(ideal).all(axis=-1)
        if mine.sum() < 4:
            raise InputError("too few points within the guessed lens")
        flat, where = np.ascontiguousarray(board_m[mine]), np.ascontiguousarray(ideal[mine])
        found, turn, place = cv2.solvePnP(flat, where, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE)
        if not found:
            raise InputError("a picture has no pose")
        poses.append(transform(np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64).ravel()))
    return np.stack(poses)


def _unbent(form: LensForm, numbers: Array, sensor: Array) -> Array:
    """Return ideal coordinates of (..., 2) sensor ones: by fixed-point iteration, begun without any bend."""
    if form.fisheye:
        radius = np.hypot(sensor[..., 0], sensor[..., 1])
        angle = radius.copy()
        for _ in range(20):
            bend = 1.0 + sum(k * angle ** (2 * power + 2) for power, k in enumerate(numbers[4:8]))
            angle = np.clip(radius / np.maximum(bend, 0.2), 0.0, 2.0)
        scale = np.where(angle < _FISHEYE_FIELD_RAD, np.tan(np.minimum(angle, 1.5)) / np.maximum(radius, 1e-12), np.nan)
        return np.asarray(sensor * scale[..., None])
    ideal = sensor.copy()
    for _ in range(20):
        ideal = np.clip(ideal - (sensor_of(form, numbers, ideal) - sensor), -4.0, 4.0)
    return np.asarray(ideal)


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The normal equations: (p, p) of the lens, (n, p, 6) between, (n, 6, 6) of the poses; gradients; the cost."""

    A: Array
    B: Array
    C: Array
    a: Array
    c: Array
    cost: float
    residual_px: Array


def _refined(
    points: Points, form: LensForm, numbers: Array, T: Array, *, lens_free: bool = True, steps: int = _STEPS
) -> LensFit:
    basis = form.basis if lens_free else np.zeros((form.size, 0))
    scale_px, damping = _scale(points, _residual(points, form, numbers, T)), 1e-4
    linear = _linearised(points, form, basis, numbers, T, scale_px)
    for step in range(steps):
        d_lens, d_poses = _step(linear, damping)
        moved_numbers, moved = (
            numbers + basis @ d_lens,
            np.stack([perturb(*each) for each in zip(T, d_poses, strict=True)]),
        )
        cost = _cost(points, _residual(points, form, moved_numbers, moved), scale_px)
        gain = linear.cost - cost
        if gain >= 0.0:
            numbers, T, damping = moved_numbers, moved, max(0.1 * damping, 1e-12)
            if step % 4 == 3:  # the scale follows what is left, seldom, so that costs compare between
                scale_px = _scale(points, _residual(points, form, numbers, T))
            linear = _linearised(points, form, basis, numbers, T, scale_px)
        else:
            damping *= 10.0
        if (0.0 <= gain <= _DONE_SHARE * linear.cost and step % 4 != 3) or damping > 1e12:
            break
    residual = _residual(points, form, numbers, T)
    if not np.isfinite(residual).all():
        raise InputError("the lens did not settle")
    noise_px = _noise(points, residual, basis.shape[1])
    return LensFit(form, numbers, T, residual, noise_px, _covariance(linear, basis, noise_px, scale_px), points)


def _residual(points: Points, form: LensForm, numbers: Array, T: Array) -> Array:
    camera_m = _in_camera(points, T)
    with np.errstate(divide="ignore", invalid="ignore"):
        ideal = camera_m[..., :2] / camera_m[..., 2:]
        pixel = sensor_of(form, numbers, ideal) * numbers[[FX, FY]] + numbers[[CX, CY]]
    behind = camera_m[..., 2] <= _NEAREST * np.abs(points.board_m).max()
    residual = np.where(behind[..., None], np.inf, pixel - points.seen_px)
    return np.asarray(np.where(points.there[..., None], residual, 0.0))


def _in_camera(points: Points, T: Array) -> Array:
    return np.asarray(points.board_m @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])


def _scale(points: Points, residual: Array) -> float:
    """Return one sigma of the middle half of the residuals along an axis."""
    return max(float(np.median(np.abs(residual[points.there]))) / _MEDIAN_OF_NORMAL, 1e-3)


def _weights(residual: Array, scale_px: float) -> Array:
    length = np.linalg.norm(residual, axis=-1)
    return np.asarray(np.minimum(1.0, HUBER_SIGMAS * scale_px / np.maximum(length, 1e-12)))


def _cost(points: Points, residual: Array, scale_px: float) -> float:
    if not np.isfinite(residual).all():
        return np.inf
    length, bend = np.linalg.norm(residual, axis=-1), HUBER_SIGMAS * scale_px
    return float(np.where(length <= bend, length**2, 2.0 * bend * length - bend**2)[points.there].sum())


def _linearised(points: Points, form: LensForm, basis: Array, numbers: Array, T: Array, scale_px: float) -> _Linear:
    residual = _residual(points, form, numbers, T)
    camera_m = _in_camera(points, T)
    depth = camera_m[..., 2]
    ideal = camera_m[..., :2] / depth[..., None]
    J_ideal = np.zeros((*depth.shape, 2, 3))
    J_ideal[..., 0, 0] = J_ideal[..., 1, 1] = 1.0 / depth
    J_ideal[..., 2] = -ideal / depth[..., None]
    J_point = (numbers[[FX, FY], None] * sensor_slopes(form, numbers, ideal)) @ J_ideal
    turned = camera_m - T[:, None, :3, 3]
    J_pose = np.concatenate([J_point, np.cross(turned[..., None, :], J_point)], axis=-1)
    J_lens = pixel_slopes(form, numbers, ideal) @ basis
    root = np.where(points.there, np.sqrt(_weights(residual, scale_px)), 0.0)[..., None]
    rows = 2 * points.there.shape[1]
    r = (residual * root).reshape(len(T), rows)
    P = (J_pose * root[..., None]).reshape(len(T), rows, 6)
    L = (J_lens * root[..., None]).reshape(len(T), rows, basis.shape[1])
    LT, PT = np.swapaxes(L, 1, 2), np.swapaxes(P, 1, 2)
    return _Linear(
        A=(LT @ L).sum(axis=0),
        B=LT @ P,
        C=PT @ P,
        a=(LT @ r[..., None]).sum(axis=0)[:, 0],
        c=(PT @ r[..., None])[..., 0],
        cost=_cost(points, residual, scale_px),
        residual_px=residual,
    )


def _step(linear: _Linear, damping: float) -> tuple[Array, Array]:
    """Return the damped step of the lens and the poses."""
    S, solved_B, C = _reduced(linear, damping)
    solved_c = np.linalg.solve(C, linear.c[..., None])[..., 0]
    d_lens = np.zeros(len(linear.a))
    if len(linear.a):
        right = linear.a - (linear.B @ solved_c[..., None]).sum(axis=0)[:, 0]
        d_lens = -np.linalg.lstsq(S, right, rcond=1e-14)[0]
    return d_lens, -solved_c - solved_B @ d_lens


def _reduced(linear: _Linear, damping: float) -> tuple[Array, Array, Array]:
    """Return the lens's normal matrix with the poses eliminated, ``C^-1 B^T`` (n, 6, p), and the poses' damped C."""
    C = linear.C * (1.0 + damping * np.eye(6)) + 1e-12 * np.eye(6)
    solved_B: Array = np.asarray(np.linalg.solve(C, np.swapaxes(linear.B, 1, 2)), np.float64)
    A = linear.A * (1.0 + damping * np.eye(len(linear.A)))
    return np.asarray(A - (linear.B @ solved_B).sum(axis=0)), solved_B, C


def _covariance(linear: _Linear, basis: Array, noise_px: float, scale_px: float) -> Array:
    """Return the covariance of all numbers of the lens; infinite variance becomes a very large one."""
    if not basis.shape[1]:
        return np.zeros((len(basis), len(basis)))
    S, _, _ = _reduced(linear, 0.0)
    unit = np.sqrt(np.maximum(np.diag(linear.A), 1e-30))
    inverse = np.linalg.pinv(S / np.outer(unit, unit), rcond=1e-13, hermitian=True) / np.outer(unit, unit)
    return np.asarray(noise_px**2 * basis @ inverse @ basis.T)


def _noise(points: Points, residual: Array, lens_numbers: int) -> float:
    """Return one sigma along an axis of the points' noise: of all residuals, Huber's weights, freedom counted."""
    weights = _weights(residual, _scale(points, residual))
    total = float((weights * np.square(residual).sum(axis=-1)).sum())
    freedom = 2 * int(points.there.sum()) - 6 * len(residual) - lens_numbers
    return float(np.sqrt(total / max(freedom, 1)))
