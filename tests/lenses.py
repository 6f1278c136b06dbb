"""Lenses of every kind that tests compute by, and points all over what they claim."""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens

LAB = BrownLens((1280, 800), (827.6785, 827.8561), (640.0, 400.0), (-0.335814, 0.101432, 0.0, 0.0, 0.0))
TANGENTIAL = BrownLens((1280, 800), (830.0, 826.0), (652.0, 391.0), (-0.2, 0.05, 0.002, -0.001, 0.004))
RATIONAL = BrownLens((1920, 1080), (1100.0, 1101.0), (950.0, 545.0), (0.9, 0.2, 1e-4, -2e-4, 0.01, 1.25, 0.4, 0.03))
PRISM = BrownLens(
    (1280, 720),
    (700.0, 705.0),
    (630.0, 365.0),
    (-0.1, 0.02, 1e-3, 5e-4, 0.001, 0.01, 0.002, 1e-4, 2e-3, -1e-3, 1.5e-3, 5e-4),
)
BARREL = BrownLens((640, 480), (400.0, 400.0), (319.5, 239.5), (-0.4, 0.0, 0.0, 0.0))
STRAIGHT = BrownLens((640, 480), (600.0, 600.0), (319.5, 239.5))
FISHEYE = FisheyeLens((1280, 960), (380.0, 382.0), (639.0, 481.0), (-0.01, 0.02, -0.01, 0.002))

BROWN = {
    "lab": LAB,
    "tangential": TANGENTIAL,
    "rational": RATIONAL,
    "prism": PRISM,
    "barrel": BARREL,
    "pinhole": STRAIGHT,
}
ALL: dict[str, Lens] = {**BROWN, "fisheye": FISHEYE}


def ideal_points(lens: Lens, n: int = 300, seed: int = 0) -> Array:
    """Points all over the disc that the lens claims, out to 0.999 of its rim."""
    rng = np.random.default_rng(seed)
    radius, angle = 0.999 * lens.r_max * np.sqrt(rng.uniform(size=n)), rng.uniform(0.0, 2.0 * np.pi, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def opencv_camera(lens: Lens) -> Array:
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def in_space(ideal: Array) -> Array:
    depth = np.linspace(0.3, 5.0, len(ideal))[:, None]
    return np.concatenate([ideal * depth, depth], axis=1)
