"""What the camera's fit on anchors and the bodies' fits agree on: when two poses differ, when a fit is bad."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from camrig.geometry.arrays import Transform
from camrig.geometry.rotation import rotation_log

SAME_RAD = 0.05
"""Two solutions turned by less against each other are one."""

CLEARLY_WORSE = 4.0
"""Of two solutions the one with this many times the chi2 of the other (twice its residual) is wrong; with less, or
both within the noise, the picture cannot tell (0.8 to 2.5 % of single-tag sightings, sensing-model)."""

NOISE_CHI2 = 2.0
"""What chi2 a right fit of one tag has by noise alone: 8 numbers less 6 unknowns."""

MAX_RESIDUAL_PX = 1.5
MAX_RESIDUAL_WIDTHS = 0.03
"""Corners further off than both are not those of the tag, size and place that the rig lists."""


def angle_between(T_a: Transform, T_b: Transform) -> float:
    """Return the angle in radians between two orientations."""
    return float(np.linalg.norm(rotation_log(T_a[:3, :3] @ T_b[:3, :3].T)))


def clearly_better(chi2: float, other: float) -> bool:
    """Tell whether a solution with ``chi2`` is right and the one with ``other`` wrong."""
    return other > CLEARLY_WORSE * max(chi2, NOISE_CHI2)


def inflation(chi2: float, freedoms: int) -> float:
    """Return by what the covariance of a fit must grow: 1 unless its residuals exceed what noise does once in 1000,
    then chi2 per degree of freedom (Birge's ratio).
    """
    return chi2 / freedoms if chi2 > _chi2_limit(freedoms) else 1.0


def residual_limit_px(width_px: float) -> float:
    """Return the root-mean-square residual in pixels above which a tag ``width_px`` wide is not believed."""
    return max(MAX_RESIDUAL_PX, MAX_RESIDUAL_WIDTHS * width_px)


@lru_cache(maxsize=256)
def _chi2_limit(freedoms: int) -> float:
    return float(chdtri(freedoms, 0.001))
