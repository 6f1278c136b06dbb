"""Cameras and bodies estimated together from all corners of all tags: a small, dense bundle adjustment.

The unknowns are the error of each camera's pose (6, geometry.pose) and of its lens (4, geometry.lens.errors), each with
a prior, and the pose of each body (6). Corners are weighed as in geometry.pnp. Bodies are eliminated (Schur
complement): a handful of cameras remain. Source: Triggs et al., "Bundle Adjustment - A Modern Synthesis" (2000),
sections 3 and 6.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array
from camrig.geometry.bundle_kernel import CAMERA, Indices, accumulate
from camrig.geometry.pnp_kernel import MIN_DEPTH_M, add_priors, move_stack
from camrig.geometry.pose import PosePriors

_STEPS = 12
_DONE = 1e-3
_DONE_SHARE = 1e-5
"""A step that lowers the cost by less than a thirtieth of a sigma, or by less than so much of it, is the last one."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """m tags, each seen by one camera: which, and what carries the tag (-1: the room).

    ``corners_m`` (m, 4, 3) are in the body's frame, an anchor's in the world; ``shift_m`` (m, 3) is how much further
    the body was than at its own stamp and ``spread`` (m, 6, 6) how uncertain its pose is for that; ``turn`` (m, 3, 3)
    by which rotation it is seen to have turned meanwhile, about which corners are linearised, and ``slack_rad`` (m, 3)
    by how much more it was expected to (geometry.pose: world axes); ``ideal`` (m, 4, 2)
    and ``whitener`` (m, 4, 2, 2) as in geometry.pnp; ``lens_slopes`` (m, 4, 2, 4) is the derivative of the whitened
    residual by the lens's errors.
    """

    camera: Indices
    body: Indices
    corners_m: Array
    shift_m: Array
    spread: Array
    turn: Array
    slack_rad: Array
    ideal: Array
    whitener: Array
    lens_slopes: Array

    def weighed(self, weight: Array) -> Views:
        """Return them with (m,) times the information."""
        root = np.sqrt(weight)[:, None, None, None]
        return replace(self, whitener=root * self.whitener, lens_slopes=root * self.lens_slopes)

    def only(self, kept: npt.NDArray[np.bool_]) -> Views:
        """Return some of the views."""
        return Views(*(getattr(self, part.name)[kept] for part in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class LensPriors:
    """What is known of c lenses' errors (geometry.lens.errors) beforehand: (c, 4) mean and (c, 4, 4) information."""

    mean: Array
    information: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What is being solved for: (c, 4, 4) ``T_world_camera``, (c, 4) errors of lenses, (b, 4, 4) ``T_world_body``."""

    cameras: Array
    lenses: Array
    bodies: Array


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The most probable estimate; ``chi2`` (m,) of each view at it.

    ``camera_covariance`` is (c, 10, c, 10); ``body_covariance`` (b, 6, 6) is the whole, ``body_alone``
    (b, 6, 6) what it would be were the cameras known; ``sensitivity`` (b, 6, c, 10) is the covariance of bodies with
    cameras, by which the cameras' priors enter.
    """

    estimate: Estimate
    chi2: Array
    camera_covariance: Array
    body_covariance: Array
    body_alone: Array
    sensitivity: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """The normal equations: Hcc (c, 10, 10), Hbc (b, 6, 10 c), Hbb (b, 6, 6), their gradients and the cost."""

    Hcc: Array
    Hbc: Array
    Hbb: Array
    gc: Array
    gb: Array
    chi2: Array
    cost: float


def adjust(views: Views, cameras: PosePriors, lenses: LensPriors, bodies: PosePriors, start: Estimate) -> Adjusted:
    """Minimise the robust sum of squares of all corners and priors by Levenberg-Marquardt, begun at ``start``.

    Every camera needs a prior or anchors in view, every body a view.
    """
    at, damping = start, 0.0
    normal = _normal(views, cameras, lenses, bodies, at)
    for _ in range(_STEPS):
        camera_step, body_step = _step(normal, damping)
        moved = Estimate(
            move_stack(at.cameras, np.ascontiguousarray(camera_step[:, :6])),
            at.lenses + camera_step[:, 6:],
            move_stack(at.bodies, body_step),
        )
        there = _normal(views, cameras, lenses, bodies, moved)
        gain = -float((camera_step * normal.gc).sum() + (body_step * normal.gb).sum())
        if there.cost <= normal.cost:
            at, normal, damping = moved, there, 0.1 * damping if damping > 1e-6 else 0.0
        else:
            damping = max(10.0 * damping, 1e-4)
        if gain < _DONE + _DONE_SHARE * normal.cost:
            break
    return _with_covariance(at, normal)


def projected(views: Views, at: Estimate) -> Array:
    """Return the (m, 4, 2) ideal points at which an estimate has the corners, through lenses without error."""
    T = np.concatenate([at.bodies, np.eye(4)[None]])[views.body]  # the last is the room's, body -1
    R = views.turn @ T[:, :3, :3]
    points = views.corners_m @ R.swapaxes(1, 2) + (T[:, :3, 3] + views.shift_m)[:, None]
    T = at.cameras[views.camera]
    points = (points - T[:, None, :3, 3]) @ T[:, :3, :3]
    return np.asarray(points[..., :2] / np.maximum(points[..., 2:], MIN_DEPTH_M))


def camera_evidence(views: Views, bodies: PosePriors, at: Estimate) -> tuple[Array, Array]:
    """Return what the views say of the c cameras by themselves, whatever the bodies' poses are: the information
    (10 c, 10 c) on their errors, and the gradient (10 c,) of half the sum of squares, at an estimate.

    ``views.lens_slopes`` must be those at the ``projected`` points. At the corners as seen they go along with the noise
    of these, and where poses take up nearly all that a lens does, what is left is that.
    """
    c = len(at.cameras)
    nothing = PosePriors(at.cameras, np.zeros((c, 6, 6)))
    vague = PosePriors(bodies.T, bodies.information + _VAGUE)
    normal = _normal(views, nothing, LensPriors(at.lenses, np.zeros((c, 4, 4))), vague, at)
    _, Y, S = _eliminated(normal, 0.0)
    return 0.5 * (S + S.T), normal.gc.ravel() - np.einsum("bij,bi->j", Y, normal.gb)


_VAGUE: Array = np.diag([1e-4] * 3 + [1e-2] * 3)
"""Information on a pose, by m2 and rad2, that is as good as none."""


def _normal(views: Views, cameras: PosePriors, lenses: LensPriors, bodies: PosePriors, at: Estimate) -> _Normal:
    """Linearise all corners and priors about an estimate."""
    c, b = len(at.cameras), len(at.bodies)
    Hcc, Hbc, Hbb = np.zeros((c, CAMERA, CAMERA)), np.zeros((b, 6, CAMERA * c)), np.zeros((b, 6, 6))
    gc, gb, chi2 = np.zeros((c, CAMERA)), np.zeros((b, 6)), np.zeros(len(views.camera))
    cost = accumulate(
        at.cameras, at.lenses, at.bodies, views.camera, views.body, views.corners_m, views.shift_m, views.spread,
        views.turn, views.slack_rad,
        views.ideal, views.whitener, views.lens_slopes, Hcc, Hbc, Hbb, gc, gb, chi2,
    )  # fmt: skip
    cost += add_priors(at.cameras, cameras.T, cameras.information, Hcc, gc)
    cost += add_priors(at.bodies, bodies.T, bodies.information, Hbb, gb)
    off = at.lenses - lenses.mean
    weighted = (lenses.information @ off[..., None])[..., 0]
    Hcc[:, 6:, 6:] += lenses.information
    gc[:, 6:] += weighted
    return _Normal(Hcc, Hbc, Hbb, gc, gb, chi2, cost + float((off * weighted).sum()))


def _step(normal: _Normal, damping: float) -> tuple[Array, Array]:
    """Return the (c, 10) and (b, 6) step of the damped normal equations."""
    body_inverse, Y, S = _eliminated(normal, damping)
    camera_step = -np.linalg.solve(S, normal.gc.ravel() - np.einsum("bij,bi->j", Y, normal.gb))
    body_step = -(body_inverse @ normal.gb[..., None])[..., 0] - Y @ camera_step
    return camera_step.reshape(normal.gc.shape), body_step


def _eliminated(normal: _Normal, damping: float) -> tuple[Array, Array, Array]:
    """Return Hbb^-1 (b, 6, 6), Y = Hbb^-1 Hbc (b, 6, 10 c) and the Schur complement of the cameras."""
    c = len(normal.Hcc)
    Hbb, blocks = normal.Hbb.copy(), np.zeros((c, CAMERA, c, CAMERA))
    blocks[np.arange(c), :, np.arange(c), :] = normal.Hcc
    S = blocks.reshape(CAMERA * c, CAMERA * c)
    if damping:
        Hbb[:, np.arange(6), np.arange(6)] *= 1.0 + damping
        S[np.diag_indices_from(S)] *= 1.0 + damping
    body_inverse = np.asarray(np.linalg.inv(Hbb), float)
    Y = body_inverse @ normal.Hbc
    flat = normal.Hbc.reshape(-1, CAMERA * c)
    return body_inverse, Y, S - flat.T @ Y.reshape(-1, CAMERA * c)


def _with_covariance(at: Estimate, normal: _Normal) -> Adjusted:
    c = len(at.cameras)
    body_inverse, Y, S = _eliminated(normal, 0.0)
    P = np.asarray(np.linalg.inv(S), float)
    P = 0.5 * (P + P.T)
    across = -(Y @ P)
    whole = body_inverse - across @ Y.swapaxes(1, 2)
    return Adjusted(
        estimate=at,
        chi2=normal.chi2,
        camera_covariance=P.reshape(c, CAMERA, c, CAMERA),
        body_covariance=whole,
        body_alone=body_inverse,
        sensitivity=across.reshape(len(across), 6, c, CAMERA),
    )
