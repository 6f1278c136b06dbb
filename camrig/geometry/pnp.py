"""Poses from the corners of square tags: both solutions of one tag, and least squares over many corners at once.

Corners are observed in pixels and used as *ideal* coordinates with their pixel scale (``ImagePoints``): the residual
``whitener @ (projected - observed)`` is the pixel residual through the true lens over its sigma, linear in the lens
about the observed corner. A residual is below a pixel, over which a lens is straight to 1e-6 px.

Source of the closed form: Collins and Bartoli, "Infinitesimal plane-based pose estimation" (2014), in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.corner_noise import detected_sigma_px, refined_sigma_px, tag_width_px
from camrig.geometry.lens import Lens
from camrig.geometry.pnp_kernel import MIN_DEPTH_M, refine_stack
from camrig.geometry.pose import PosePriors, transform

TAG_CORNERS = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
"""p0..p3 of a tag of size 1 in the tag frame: bottom-left, bottom-right, top-right, top-left (AprilTag's order)."""

_IPPE_ORDER = [3, 2, 1, 0]
"""IPPE_SQUARE wants top-left, top-right, bottom-right, bottom-left."""

_NUDGE = np.array([[1e-9, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
"""Of a square seen exactly head-on in the exact middle OpenCV returns the mirror image, twice; a micropixel helps."""


@dataclass(frozen=True, slots=True, eq=False)
class ImagePoints:
    """Observed points: ``ideal`` (..., n, 2), ``px_per_ideal`` (..., n, 2, 2) the lens's scale there, and
    ``sigma_px`` (..., n). NaN where a pixel has no ideal point within the lens's ``r_max``.
    """

    ideal: Array
    px_per_ideal: Array
    sigma_px: Array

    @property
    def whitener(self) -> Array:
        """Return (..., n, 2, 2): times an ideal difference it gives pixels over sigma."""
        return np.asarray(self.px_per_ideal / self.sigma_px[..., None, None])

    def of(self, k: int) -> ImagePoints:
        """Return the k-th set of points of a stack."""
        return ImagePoints(self.ideal[k], self.px_per_ideal[k], self.sigma_px[k])


@dataclass(frozen=True, slots=True, eq=False)
class SquarePose:
    """One of the two poses that a square's four corners allow, and its root-mean-square residual in pixels."""

    T_camera_tag: Transform
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """Refined (m, 4, 4) poses, their (m, 6, 6) covariance (geometry.pose), the sum of squared whitened residuals
    with the prior's (m,), and the root mean square of the pixel residuals alone, in sigmas (m,).
    """

    T_camera_body: Array
    covariance: Array
    chi2: Array
    rms_sigma: Array

    def of(self, rows: slice) -> PoseFit:
        """Return some of the poses."""
        return PoseFit(self.T_camera_body[rows], self.covariance[rows], self.chi2[rows], self.rms_sigma[rows])


def observe_tags(lens: Lens, corners_px: Array, refined: npt.NDArray[np.bool_] | None = None) -> ImagePoints:
    """Undistort (k, 4, 2) tag corners and weigh them by the corner noise laws; ``refined`` (k, 4) tells which of them
    were refined through the lens, None that none was.
    """
    ideal = lens.unproject(corners_px)
    centre = ideal.mean(axis=1)
    width = tag_width_px(corners_px)[:, None]
    detected = detected_sigma_px(width, np.hypot(centre[:, :1], centre[:, 1:]))
    known = np.zeros(corners_px.shape[:2], dtype=bool) if refined is None else refined
    scale = lens.jacobian(ideal) * np.asarray(lens.focal_px)[:, None]
    return ImagePoints(ideal, scale, np.where(known, refined_sigma_px(width), detected))


def square_poses(ideal: Array, px_per_ideal: Array, size_m: float) -> tuple[SquarePose, ...]:
    """Return the poses that (4, 2) ideal corners p0..p3 of a tag allow: two, the better first; none where degenerate.

    Raises nothing: corners without a solution in front of the camera give an empty tuple.
    """
    model = size_m * TAG_CORNERS
    try:
        found, rotations, translations, _ = cv2.solvePnPGeneric(
            model[_IPPE_ORDER], (ideal + _NUDGE)[_IPPE_ORDER], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
    except cv2.error:
        return ()
    poses = []
    for k in range(int(found)):
        T = transform(np.asarray(cv2.Rodrigues(rotations[k])[0], float), np.asarray(translations[k], float)[:, 0])
        points = model @ T[:3, :3].T + T[:3, 3]
        if np.isfinite(T).all() and (points[:, 2] > 0.0).all():
            residual = (px_per_ideal @ (points[:, :2] / points[:, 2:] - ideal)[..., None])[..., 0]
            poses.append(SquarePose(T, float(np.sqrt((residual * residual).sum() / 4.0))))
    return tuple(sorted(poses, key=lambda pose: pose.rms_px))


def refine(
    T_camera_body: Array, points_body: Array, ideal: Array, whitener: Array, prior: PosePriors | None = None
) -> PoseFit:
    """Least squares (Levenberg-Marquardt) for a stack of m independent poses, started at (m, 4, 4).

    ``points_body`` (m, n, 3) metres project onto ``ideal`` (m, n, 2); a zero ``whitener`` (m, n, 2, 2) leaves a point
    out, so poses with fewer points are padded. Points must start in front of the camera.
    """
    m = len(T_camera_body)
    T, H, chi2 = T_camera_body.copy(), np.zeros((m, 6, 6)), np.zeros(m)
    known = PosePriors(T_camera_body, np.zeros((m, 6, 6))) if prior is None else prior
    points, at, by = (np.ascontiguousarray(part, float) for part in (points_body, ideal, whitener))
    refine_stack(T, points, at, by, known.T, known.information, H, chi2)
    residual, _ = whitened_residuals(T, points_body, ideal, whitener)
    used = np.maximum((whitener != 0.0).any(axis=(2, 3)).sum(axis=1), 1)
    return PoseFit(
        T, np.asarray(np.linalg.inv(H), float), chi2, np.sqrt((residual * residual).sum(axis=(1, 2)) / (2.0 * used))
    )


def whitened_residuals(T: Array, points_body: Array, ideal: Array, whitener: Array) -> tuple[Array, Array]:
    """Return whitened residuals (m, n, 2) of (m, 4, 4) poses and their derivative (m, n, 2, 6) by the pose error of
    geometry.pose; the other arguments are those of ``refine``.
    """
    turned = points_body @ T[:, :3, :3].swapaxes(1, 2)
    camera = turned + T[:, None, :3, 3]
    # Behind the camera the clamp makes the residual huge: such a step is never taken.
    depth = np.maximum(camera[..., 2], MIN_DEPTH_M)
    a, b = camera[..., 0] / depth, camera[..., 1] / depth
    x, y, z = turned[..., 0], turned[..., 1], turned[..., 2]
    J = np.zeros((*a.shape, 2, 6))
    # d (X/Z, Y/Z) with d X = dt + r x turned
    J[..., 0, 0] = J[..., 1, 1] = 1.0
    J[..., 0, 2], J[..., 1, 2] = -a, -b
    J[..., 0, 3], J[..., 0, 4], J[..., 0, 5] = -a * y, z + a * x, -y
    J[..., 1, 3], J[..., 1, 4], J[..., 1, 5] = -z - b * y, b * x, x
    J /= depth[..., None, None]
    difference = np.stack([a, b], axis=-1) - ideal
    residual = (whitener @ difference[..., None])[..., 0]
    return residual, whitener @ J
