"""What a camera sees: the paper's cone, or the true distorted image rectangle. Vectorised, pure.

Each has a *clearance* (>= 0 is visible), smooth enough for a solver's constraints, and a yes-or-no built on it.
Points are (..., 3) metres in the camera's optical frame; ``margin_rad`` shrinks what counts as visible.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens

Flags = npt.NDArray[np.bool_]

ANGLE_SLACK_RAD = 1e-9
"""A target exactly on the edge of view counts as seen; optima sit there."""

_PIXEL_SLACK = 1e-6
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def half_angle(lens: Lens) -> float:
    """Return the paper's half angle of view: atan(w / (2 sqrt(fx fy)))."""
    fx, fy = lens.focal_px
    return math.atan(lens.size_px[0] / (2.0 * math.sqrt(fx * fy)))


def cone_clearance(lens: Lens, points_camera: Array, alpha_rad: float, margin_rad: float = 0.0) -> Array:
    """Return how far inside the cone each point is, in radians; (...,). ``r_max`` bounds the cone too."""
    beta = np.arctan2(np.hypot(points_camera[..., 0], points_camera[..., 1]), points_camera[..., 2])
    return np.asarray(min(alpha_rad, math.atan(lens.r_max)) - margin_rad - beta)


def in_cone(lens: Lens, points_camera: Array, alpha_rad: float, margin_rad: float = 0.0) -> Flags:
    """Tell which points the cone of half angle ``alpha_rad`` holds."""
    return np.asarray(cone_clearance(lens, points_camera, alpha_rad, margin_rad) >= -ANGLE_SLACK_RAD)


def image_clearance(lens: Lens, points_camera: Array, margin_rad: float = 0.0) -> Array:
    """Return (..., 5) pixels that each point is inside the left, right, upper and lower edge and inside ``r_max``.

    The image spans [0, width] x [0, height] pixels. The margin is an angle: by first order it takes
    ``margin_rad`` |d pixel / d angle| from every edge, with the lens's own scale at that place. -inf behind.
    """
    depth = points_camera[..., 2]
    ahead = depth > 0.0
    ideal = points_camera[..., :2] / np.where(ahead, depth, 1.0)[..., None]
    focal = np.asarray(lens.focal_px)
    # A polynomial lens is meaningless far outside; stop there, where r_max has long said no.
    radius = np.hypot(ideal[..., 0], ideal[..., 1])
    bounded = ideal * np.minimum(1.0, 2.0 * lens.r_max / np.maximum(radius, 1e-12))[..., None]
    pixel = lens.distort(bounded) * focal + np.asarray(lens.centre_px)
    inset = _inset_px(lens, bounded, margin_rad) if margin_rad > 0.0 else np.zeros(2)
    clearance = np.empty((*depth.shape, 5))
    clearance[..., 0:4:2] = pixel - inset
    clearance[..., 1:4:2] = np.asarray(lens.size_px) - pixel - inset
    clearance[..., 4] = (math.tan(math.atan(lens.r_max) - margin_rad) - radius) * focal[0]
    return np.where(ahead[..., None], clearance, -np.inf)


def in_image(lens: Lens, points_camera: Array, margin_rad: float = 0.0) -> Flags:
    """Tell which points fall on the true distorted image, within ``r_max``."""
    return np.asarray((image_clearance(lens, points_camera, margin_rad) >= -_PIXEL_SLACK).all(axis=-1))


def tag_corners(position_m: Array, normal: Array, facing_rad: float, size_m: float) -> Array:
    """Return the (4, 3) world corners of a square tag about ``position_m``, p0..p3 in AprilTag's order.

    At ``facing_rad`` 0 the tag's x is world x as far as the normal allows (world y where the normal is along x);
    ``facing_rad`` turns it about the normal by the right-hand rule.
    """
    up = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    reference = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x0 = reference - up * float(reference @ up)
    x0 /= np.linalg.norm(x0)
    y0 = np.cross(up, x0)
    x = math.cos(facing_rad) * x0 + math.sin(facing_rad) * y0
    return np.asarray(position_m + size_m * (_CORNERS[:, :1] * x + _CORNERS[:, 1:] * np.cross(up, x)))


def tag_side_px(lens: Lens, corners_camera: Array) -> Array:
    """Return the narrow side in pixels of tags with (..., 4, 3) optical-frame corners; NaN where not all project."""
    pixels = lens.project(corners_camera)
    sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=-2), axis=-1)
    return np.asarray(np.minimum(sides[..., 0] + sides[..., 2], sides[..., 1] + sides[..., 3]) / 2.0)


def _inset_px(lens: Lens, ideal: Array, margin_rad: float) -> Array:
    """Return the (..., 2) pixels across and down that ``margin_rad`` is worth at an ideal point, in any direction.

    On the sphere a step of one radian at (a, b) moves (a, b) by sqrt(1 + r^2) (I + (a b)^T (a b))^(1/2), so the
    squared length of a pixel coordinate's gradient g is (1 + r^2) (|g|^2 + (g . (a, b))^2).
    """
    gradient = lens.jacobian(ideal) * np.asarray(lens.focal_px)[:, None]
    r2 = (ideal * ideal).sum(axis=-1)[..., None]
    along = (gradient * ideal[..., None, :]).sum(axis=-1)
    squared = (1.0 + r2) * ((gradient * gradient).sum(axis=-1) + along * along)
    return np.asarray(margin_rad * np.sqrt(squared))
