"""Which numbers of a lens are found, from the fewest to all: the ladder that evidence climbs.

All numbers of a lens stand in one vector ``[fx, fy, cx, cy, coefficients]``, of OpenCV's 12 Brown-Conrady coefficients
(k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4) or its 4 of a fisheye. A form says which of them move.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.lens.brown import brown_sensor, brown_slopes
from camrig.geometry.lens.fisheye import fisheye_sensor, fisheye_slopes

FX, FY, CX, CY, COEFFICIENTS = range(5)
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
FISHEYE = ("k1", "k2", "k3", "k4")
_LENGTHS = (0, 4, 5, 8, 12)
"""How many coefficients OpenCV writes."""


@dataclass(frozen=True)
class LensForm:
    """``free``: the coefficients that are found; ``square``: one focal length for both axes."""

    fisheye: bool
    free: tuple[str, ...]
    square: bool = False

    @property
    def name(self) -> str:
        """Return it as people read it: ``k1 k2 p1 p2``."""
        parts = ["fisheye"] * self.fisheye + ["square pixels"] * self.square
        return " ".join([*parts, *self.free]) or "pinhole"

    @property
    def size(self) -> int:
        """Return how many numbers a lens of either kind has."""
        return COEFFICIENTS + len(FISHEYE if self.fisheye else BROWN)

    @cached_property
    def basis(self) -> Array:
        """Return (size, n): what the n numbers that are found do to all of them."""
        names = FISHEYE if self.fisheye else BROWN
        columns = [[FX, FY]] if self.square else [[FX], [FY]]
        columns += [[CX], [CY], *([COEFFICIENTS + names.index(name)] for name in self.free)]
        basis = np.zeros((self.size, len(columns)))
        for column, rows in enumerate(columns):
            basis[rows, column] = 1.0
        return basis

    def lens(self, numbers: Array, size_px: tuple[int, int]) -> BrownLens | FisheyeLens:
        """Return the lens of a (size,) vector, with as many coefficients as OpenCV would write."""
        focal, centre = (float(numbers[FX]), float(numbers[FY])), (float(numbers[CX]), float(numbers[CY]))
        coefficients = tuple(numbers[COEFFICIENTS:].tolist())
        if self.fisheye:
            return FisheyeLens(size_px, focal, centre, coefficients)
        return BrownLens(size_px, focal, centre, coefficients[: _written(self)])


PINHOLE = LensForm(fisheye=False, free=())
LADDER = (
    LensForm(fisheye=False, free=("k1",), square=True),
    LensForm(fisheye=False, free=("k1",)),
    LensForm(fisheye=False, free=("k1", "k2")),
    LensForm(fisheye=False, free=("k1", "k2", "p1", "p2")),
    LensForm(fisheye=False, free=("k1", "k2", "p1", "p2", "k3")),
    LensForm(fisheye=False, free=BROWN[:8]),
    LensForm(fisheye=False, free=BROWN),
)
FISHEYE_LADDER = (
    LensForm(fisheye=True, free=("k1",), square=True),
    LensForm(fisheye=True, free=("k1", "k2")),
    LensForm(fisheye=True, free=FISHEYE),
)


def distortion_of(form: LensForm, lens: BrownLens | FisheyeLens) -> tuple[float, ...]:
    """Return a lens's coefficients in OpenCV's order, as many as OpenCV would write."""
    return lens.distortion if form.fisheye else lens.distortion[: _written(form)]


def _written(form: LensForm) -> int:
    last = max((BROWN.index(name) + 1 for name in form.free), default=0)
    return next(length for length in _LENGTHS if length >= last)


def sensor_of(form: LensForm, numbers: Array, ideal: Array) -> Array:
    """Return (..., 2) sensor coordinates of (..., 2) ideal ones, also past where the lens may be trusted."""
    formula = fisheye_sensor if form.fisheye else brown_sensor
    return np.stack(formula(numbers[COEFFICIENTS:], ideal[..., 0], ideal[..., 1]), axis=-1)


def sensor_slopes(form: LensForm, numbers: Array, ideal: Array) -> Array:
    """Return (..., 2, 2) ``d sensor / d ideal``."""
    formula = fisheye_slopes if form.fisheye else brown_slopes
    slopes = np.empty((*ideal.shape, 2))
    found = formula(numbers[COEFFICIENTS:], ideal[..., 0], ideal[..., 1])
    slopes[..., 0, 0], slopes[..., 0, 1], slopes[..., 1, 0], slopes[..., 1, 1] = found
    return slopes


def pixel_slopes(form: LensForm, numbers: Array, ideal: Array) -> Array:
    """Return (..., 2, size): how the pixel of (..., 2) ideal points moves with each number of the lens."""
    slopes = np.zeros((*ideal.shape[:-1], 2, form.size))
    sensor = sensor_of(form, numbers, ideal)
    slopes[..., 0, FX], slopes[..., 1, FY] = sensor[..., 0], sensor[..., 1]
    slopes[..., 0, CX] = slopes[..., 1, CY] = 1.0
    bend = _fisheye_bend(ideal) if form.fisheye else _brown_bend(numbers[COEFFICIENTS:], ideal)
    slopes[..., COEFFICIENTS:] = numbers[[FX, FY], None] * bend
    return slopes


def _fisheye_bend(ideal: Array) -> Array:
    """Return (..., 2, 4): how the sensor point moves with k1..k4."""
    r = np.hypot(ideal[..., 0], ideal[..., 1])
    angle = np.arctan(r)
    powers = angle[..., None] ** np.array([3.0, 5.0, 7.0, 9.0])
    return np.asarray((ideal / np.maximum(r, 1e-12)[..., None])[..., None] * powers[..., None, :])


def _brown_bend(k: Array, ideal: Array) -> Array:
    """Return (..., 2, 12): how the sensor point moves with each coefficient; OpenCV's formula, differentiated."""
    a, b = ideal[..., 0], ideal[..., 1]
    r2 = a * a + b * b
    powers = np.stack([r2, r2**2, r2**3], axis=-1)
    above = 1.0 + powers @ np.array([k[0], k[1], k[4]])
    below = 1.0 + powers @ k[5:8]
    radial = powers / below[..., None]
    quotient = -radial * (above / below)[..., None]
    bend = np.zeros((*ideal.shape, 12))
    bend[..., [0, 1, 4]] = ideal[..., None] * radial[..., None, :]
    bend[..., 5:8] = ideal[..., None] * quotient[..., None, :]
    bend[..., 0, 2] = bend[..., 1, 3] = 2.0 * a * b
    bend[..., 0, 3], bend[..., 1, 2] = r2 + 2.0 * a * a, r2 + 2.0 * b * b
    bend[..., 0, 8] = bend[..., 1, 10] = r2
    bend[..., 0, 9] = bend[..., 1, 11] = r2 * r2
    return bend
