"""Tags drawn through a lens as exactly as wanted: every pixel an average of samples whose rays OpenCV computes.

The emulated camera draws whole rooms in real time and approximates; corners are judged against these pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, transform
from camrig.geometry.rotation import rotation_exp
from camrig.messages import Region
from camrig.rig import TagKey
from camrig_emulators.lens_rays import LensRays, lens_rays
from camrig_emulators.tag_pictures import black_cells, tag_cells

SAMPLES = 8
"""Samples along a pixel's side."""
MARGIN_PX = 12
FLOOR_GREY = 110.0


KEY = TagKey("tag36h11", 7)


@dataclass(frozen=True, slots=True)
class Optics:
    """Sigma of the point spread and of the noise."""

    psf_px: float = 0.7
    noise_grey: float = 4.0


SHARP = Optics()


@dataclass(frozen=True, slots=True, eq=False)
class DrawnTag:
    """A picture of one tag, where in it the tag is, and the tag's true corners p0..p3, (4, 2) pixels."""

    image: GreyImage
    region: Region
    corners_px: Array
    T_camera_tag: Transform


@lru_cache(maxsize=8)
def rays_of(lens: BrownLens | FisheyeLens) -> LensRays:
    return lens_rays(lens)


def draw_tag(
    lens: BrownLens | FisheyeLens,
    T_camera_tag: Transform,
    rng: np.random.Generator,
    *,
    key: TagKey = KEY,
    size_m: float = 0.16,
    optics: Optics = SHARP,
    cells: GreyImage | None = None,
    moved: Callable[[float], Transform] | None = None,
) -> DrawnTag | None:
    """Draw a tag; None where it is not wholly in the picture.

    ``cells`` is what is printed instead of the family's picture, its outermost ring the quiet zone. ``moved`` gives the
    tag's pose at -0.5 to 0.5 of the exposure.
    """
    rays = rays_of(lens)
    corners = rays.project(apply(T_camera_tag, size_m * TAG_CORNERS))
    rim = rays.project(apply(T_camera_tag, 1.3 * size_m * TAG_CORNERS))
    if not (np.isfinite(rim).all() and (rim > MARGIN_PX).all() and (rim < np.array(lens.size_px) - MARGIN_PX).all()):
        return None
    low, high = np.floor(rim.min(axis=0)).astype(int) - MARGIN_PX, np.ceil(rim.max(axis=0)).astype(int) + MARGIN_PX
    region = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    printed = tag_cells(key) if cells is None else cells
    across = black_cells(key.family) if cells is None else len(cells) - 2
    poses = [T_camera_tag] if moved is None else [moved((k + 0.5) / 16.0 - 0.5) for k in range(16)]
    grey = np.mean([_averaged(rays, region, T, printed, size_m / across) for T in poses], axis=0)
    if optics.psf_px > 0.0:
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), optics.psf_px, borderType=cv2.BORDER_REPLICATE))
    grey = grey + rng.normal(0.0, optics.noise_grey, grey.shape)
    image = np.full((lens.size_px[1], lens.size_px[0]), round(FLOOR_GREY), np.uint8)
    image[region[1] : region[3], region[0] : region[2]] = np.clip(np.rint(grey), 0, 255)
    return DrawnTag(image, region, corners, T_camera_tag)


def _averaged(rays: LensRays, region: Region, T_camera_tag: Transform, printed: GreyImage, cell_m: float) -> Array:
    """Return the mean grey of each pixel of a region."""
    x0, y0, x1, y1 = region
    around = rays.crop(x0 - 1, y0 - 1, x1 + 1, y1 + 1).astype(np.float64)
    fine = cv2.resize(around, None, fx=SAMPLES, fy=SAMPLES, interpolation=cv2.INTER_CUBIC)
    ideal = fine[SAMPLES:-SAMPLES, SAMPLES:-SAMPLES]
    plane = np.linalg.inv(T_camera_tag[:3, [0, 1, 3]])
    x, y, w = (plane[k, 0] * ideal[..., 0] + plane[k, 1] * ideal[..., 1] + plane[k, 2] for k in range(3))
    half = len(printed) / 2.0
    column, row = np.floor(x / w / cell_m + half).astype(int), np.floor(half - y / w / cell_m).astype(int)
    on_plate = (column >= 0) & (column < len(printed)) & (row >= 0) & (row < len(printed))
    inside = np.clip(row, 0, len(printed) - 1), np.clip(column, 0, len(printed) - 1)
    grey = np.where(on_plate, printed[inside], FLOOR_GREY)
    return np.asarray(grey.reshape(y1 - y0, SAMPLES, x1 - x0, SAMPLES).mean(axis=(1, 3)))


def random_pose(
    lens: BrownLens | FisheyeLens,
    rng: np.random.Generator,
    width_px: float,
    radius: float,
    size_m: float = 0.16,
    tilt_rad: float = 0.7,
) -> Transform:
    """Return a tag turned at random, about ``width_px`` wide and seen ``radius`` = tan(angle) off the axis."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    ray = np.array([radius * np.cos(angle), radius * np.sin(angle), 1.0])
    spin, lean_to = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 2.0 * np.pi)
    lean = rng.uniform(0.0, tilt_rad) * np.array([np.cos(lean_to), np.sin(lean_to), 0.0])
    facing = _facing(ray) @ rotation_exp(lean) @ rotation_exp(np.array([0.0, 0.0, spin]))
    near = transform(facing, ray)
    corners = lens.project(apply(near, 1e-3 * TAG_CORNERS))
    x, y = corners[:, 0], corners[:, 1]
    per_m = 1e3 * np.sqrt(abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2.0)
    return transform(facing, ray * per_m * size_m / width_px)


def _facing(ray: Array) -> Array:
    """Return R_camera_tag of a tag that faces the camera along a ray."""
    z = -ray / np.linalg.norm(ray)
    x = np.cross(np.array([0.0, -1.0, 0.0]), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
