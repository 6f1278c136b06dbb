"""The corners of a square tag in the world. Pure."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array

_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_X, _Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def tag_corners(position_m: Array, normal: Array, facing_rad: Array | float, size_m: Array | float) -> Array:
    """Return the (..., 4, 3) world corners of square tags about (..., 3) places, p0..p3 in AprilTag's order.

    At ``facing_rad`` 0 the tag's x is world x as far as the normal allows (world y where the normal is along x);
    ``facing_rad`` turns it about the normal by the right-hand rule.
    """
    up = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    reference = np.where(np.abs(up[..., :1]) < 0.9, _X, _Y)
    x0 = reference - up * (reference * up).sum(axis=-1, keepdims=True)
    x0 /= np.linalg.norm(x0, axis=-1, keepdims=True)
    facing = np.asarray(facing_rad)[..., None]
    x = np.cos(facing) * x0 + np.sin(facing) * np.cross(up, x0)
    y = np.cross(up, x)
    square = _CORNERS[:, :1] * x[..., None, :] + _CORNERS[:, 1:] * y[..., None, :]
    return np.asarray(position_m[..., None, :] + np.asarray(size_m)[..., None, None] * square)
