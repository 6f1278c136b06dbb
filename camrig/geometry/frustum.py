"""What a camera's picture covers: the rim of its field of view, rays onto the floor, its footprint there.

Whether a point is in the picture is ``camrig.sensing.in_image``'s to say.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens

_BISECTIONS = 40


def rim_directions(lens: Lens, per_edge: int = 16) -> Array:
    """Return (4 * per_edge, 3) unit vectors in the optical frame along the picture's border, clockwise from its top
    left as seen; where the border lies past ``r_max``, along ``r_max`` instead.
    """
    width, height = lens.size_px
    along = np.arange(per_edge) / per_edge
    zero, one = np.zeros(per_edge), np.ones(per_edge)
    unit = np.concatenate(
        [np.stack(edge, axis=-1) for edge in ((along, zero), (one, along), (1.0 - along, one), (zero, 1.0 - along))]
    )
    border = unit * [width, height] - 0.5
    ideal = _pulled_in(lens, border)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def ray_floor(origin_m: Array, directions: Array, floor_z_m: float = 0.0) -> Array:
    """Return (..., 3) points where rays from (..., 3) ``origin_m`` along (..., 3) world directions meet the plane
    z = ``floor_z_m``; NaN where a ray runs level with it or away from it.
    """
    drop = floor_z_m - origin_m[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = drop / directions[..., 2]
    reach = np.where(np.isfinite(reach) & (reach >= 0.0), reach, np.nan)
    return np.asarray(origin_m + directions * reach[..., None])


def footprint(
    lens: Lens, T_world_camera: Transform, floor_z_m: float = 0.0, max_range_m: float = 20.0, per_edge: int = 16
) -> Array:
    """Return the (n, 2) polygon of the floor that the picture covers; (0, 2) where it shows no floor.

    Past the horizon, and beyond ``max_range_m`` over the floor from the camera, the polygon ends at that range in the
    ray's compass direction.
    """
    return rays_footprint(rim_directions(lens, per_edge), T_world_camera, floor_z_m, max_range_m)


def cone_directions(alpha_rad: float, count: int = 64) -> Array:
    """Return (count, 3) unit vectors in the optical frame along the rim of a cone of half angle ``alpha_rad``."""
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    across = np.sin(alpha_rad)
    return np.stack([across * np.cos(turn), across * np.sin(turn), np.full(count, np.cos(alpha_rad))], axis=-1)


def rays_footprint(directions: Array, T_world_camera: Transform, floor_z_m: float, max_range_m: float) -> Array:
    """Return the (n, 2) polygon of the floor within a rim of directions in the optical frame, as ``footprint`` does."""
    rays = directions @ T_world_camera[:3, :3].T
    eye = T_world_camera[:3, 3]
    offset = ray_floor(eye, rays, floor_z_m)[:, :2] - eye[:2]
    hit = np.linalg.norm(offset, axis=1) <= max_range_m
    if not hit.any():
        return np.empty((0, 2))
    level = np.linalg.norm(rays[:, :2], axis=1, keepdims=True)
    far = rays[:, :2] * (max_range_m / np.maximum(level, 1e-12))
    return np.asarray(eye[:2] + np.where(hit[:, None], offset, far))


def _pulled_in(lens: Lens, pixels: Array) -> Array:
    """Return (n, 2) ideal points of border pixels, those without one pulled towards the centre until they have."""
    centre = np.asarray(lens.centre_px)
    ideal = lens.unproject(pixels)
    lost = np.isnan(ideal).any(axis=1)
    if not lost.any():
        return ideal
    low, high = np.zeros(int(lost.sum())), np.ones(int(lost.sum()))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        known = np.isfinite(lens.unproject(centre + (pixels[lost] - centre) * middle[:, None])).all(axis=1)
        low, high = np.where(known, middle, low), np.where(known, high, middle)
    ideal[lost] = lens.unproject(centre + (pixels[lost] - centre) * low[:, None])
    return ideal
