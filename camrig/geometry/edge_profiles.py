"""Where an edge crosses grey profiles drawn across it, to a hundredth of a pixel. Pure arrays.

Across an edge the grey value is ``middle + step (Phi((x - shift) / sigma) - 1/2)``: two levels, blurred by optics and
pixels. Linear in middle, step and step times shift, so each is what one fixed filter makes of a profile. The filter of
the shift is even and the blur's effect odd: a wrong sigma costs precision and moves nothing.

The levels of one profile are noisy where it is short, and a wrong level moves the edge. A tag is printed in one black
on one white, so its levels are taken from all its edges together: a plane each over the tag, for light that falls off
to one side. Where that is not so (a shadow, a reflection), the edge's profiles are each judged by their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from camrig.geometry.arrays import Array, GreyImage

Flags = npt.NDArray[np.bool_]

SIGMAS_PX = np.array([0.6, 0.8, 1.05, 1.4, 1.9, 2.6])
"""Blurs that are told apart: from sharp optics with their pixels to what is too much for a profile of 3 px each way."""
SHARP_PX = 0.8
LEAST_STEP, MOST_STEP = 0.5, 1.5
"""Times the tag's median step between black and white; a profile with less or more shows something else."""
UNEVEN = 0.013
UNEVEN_REACH_PX = 2.0
"""Steps by which levels may scatter about the tag's planes in even light: what sensor noise makes at a reach of 2 px
and more; below that it grows with the square of what the profile lacks (0.05 at 1 px). Photographs ask for no more:
their levels are never quite even, and own levels fit better there where profiles are long enough.
"""
OWN_LEVELS_PX = 1.2
"""A profile must reach this far to tell levels of its own; a shorter one in uneven light tells nothing."""

_SQRT_2PI = math.sqrt(2.0 * math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """What the profiles (k, 4, n) of k tags' four edges show: ``shift_px`` outwards to where the edge is, and whether
    each shows the edge at all; ``sigma_px`` (k, 4) is the blur of each edge.
    """

    shift_px: Array
    seen: Flags
    sigma_px: Array


def cross(
    image: GreyImage, at_px: Array, outward: Array, reach_px: Array, samples: int, sigma_px: Array | None = None
) -> Crossings:
    """Find edges near (k, 4, n, 2) pixels, looking ``reach_px`` (k, 4) along unit vectors ``outward`` and against.

    ``sigma_px`` (k, 4) is the blur of each edge where it is known.
    """
    offsets = reach_px[..., None] * np.linspace(-1.0, 1.0, samples)
    profiles, inside = _sampled(image, at_px, outward, offsets)
    if sigma_px is None:
        sigma_px = _blurs(profiles.mean(axis=2), offsets)
    model = _Model.of(offsets, sigma_px)
    middle, step, bent = model.parts(profiles)
    usual = middle_of(step.reshape(len(step), -1))[:, None, None]
    contrast = step / np.where(np.abs(usual) > 1.0, usual, np.inf)
    seen = inside & (contrast > LEAST_STEP) & (contrast < MOST_STEP)
    plane_middle, plane_step = _planes(at_px, (middle, step), seen)
    uneven = (np.square(middle - plane_middle) * seen).sum(axis=2)
    limit = UNEVEN * np.maximum(1.0, np.square(UNEVEN_REACH_PX / reach_px)) * np.abs(usual[..., 0])
    even = uneven <= np.square(limit) * seen.sum(axis=2)
    bent = np.where(even[..., None], model.bent(profiles, plane_middle), bent)
    step = np.where(even[..., None], plane_step, step)
    shift_px = -bent / np.where(np.abs(step) > 1.0, step, np.inf)
    seen &= (np.abs(shift_px) <= reach_px[..., None]) & (even | (reach_px >= OWN_LEVELS_PX))[..., None]
    return Crossings(shift_px, seen, sigma_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """What profiles are made of: 1, ``rise`` (..., samples), the step about its middle, and ``slope``, the step's
    derivative. On samples at both sides alike, 1 and slope are even and rise is odd, so that it goes by itself.
    """

    rise: Array
    slope: Array

    @classmethod
    def of(cls, offsets: Array, sigma_px: Array) -> _Model:
        z = offsets / sigma_px[..., None]
        return cls(ndtr(z) - 0.5, np.exp(-0.5 * z * z) / (_SQRT_2PI * sigma_px[..., None]))

    def parts(self, profiles: Array) -> tuple[Array, Array, Array]:
        """Return the middle level, the step, and minus the step times the shift, each (..., n), of (..., n, samples)
        profiles: least squares.
        """
        total, on_slope = profiles.sum(axis=-1), _on(profiles, self.slope)
        n, area, energy = self.rise.shape[-1], self.slope.sum(axis=-1)[..., None], _energy(self.slope)
        det = n * energy - area * area
        middle, bent = (energy * total - area * on_slope) / det, (n * on_slope - area * total) / det
        return middle, _on(profiles, self.rise) / _energy(self.rise), bent

    def bent(self, profiles: Array, middle: Array) -> Array:
        """Return minus the step times the shift where the middle level is known."""
        area = self.slope.sum(axis=-1)[..., None]
        return np.asarray((_on(profiles, self.slope) - middle * area) / _energy(self.slope))


def _on(profiles: Array, part: Array) -> Array:
    return np.asarray((profiles @ part[..., None])[..., 0])


def _energy(part: Array) -> Array:
    return np.asarray(np.square(part).sum(axis=-1)[..., None])


def middle_of(values: Array) -> Array:
    """Return the median along the last axis; of an even number, the larger middle one."""
    half = values.shape[-1] // 2
    return np.asarray(np.partition(values, half, axis=-1)[..., half])


def _sampled(image: GreyImage, at_px: Array, outward: Array, offsets: Array) -> tuple[Array, Flags]:
    """Return grey values (k, 4, n, samples), bilinear, and which profiles lie in the picture as a whole.

    Not by cv2.remap, which rounds places to 1/32 px and values to whole grey levels.
    """
    height, width = image.shape
    x = at_px[..., 0, None] + offsets[:, :, None] * outward[..., 0, None]
    y = at_px[..., 1, None] + offsets[:, :, None] * outward[..., 1, None]
    inside = _within(x, width) & _within(y, height)
    if not inside.all():
        x, y = np.clip(x, 0.0, width - 1.001), np.clip(y, 0.0, height - 1.001)
    column, row = x.astype(np.int64), y.astype(np.int64)
    right, down = x - column, y - row
    grey, place = image.reshape(-1), row * width + column
    upper, lower = (grey.take(place + below).astype(np.float64) for below in (0, width))
    upper += right * (grey.take(place + 1) - upper)
    lower += right * (grey.take(place + width + 1) - lower)
    return upper + down * (lower - upper), inside


def _within(x: Array, size: int) -> Flags:
    """Tell which profiles (..., samples) have both ends within 0 to ``size`` - 1, neighbours for bilinear included."""
    first, last = x[..., 0], x[..., -1]
    return np.asarray((np.minimum(first, last) >= 0.0) & (np.maximum(first, last) < size - 1.0))


def _blurs(mean_profile: Array, offsets: Array) -> Array:
    """Return the (k, 4) sigma that explains each edge's mean profile (k, 4, samples) best."""
    tried = np.broadcast_to(SIGMAS_PX, (*offsets.shape[:2], len(SIGMAS_PX)))
    model = _Model.of(offsets[:, :, None], tried)
    profile = mean_profile[:, :, None, None]
    middle, step, bent = (part[..., 0, None] for part in model.parts(profile))
    rest = profile[..., 0, :] - middle - step * model.rise - bent * model.slope
    return np.asarray(SIGMAS_PX[np.argmin(np.square(rest).sum(axis=-1), axis=-1)])


def _planes(at_px: Array, levels: tuple[Array, Array], seen: Flags) -> tuple[Array, Array]:
    """Fit a plane over each tag to each of its profiles' levels (k, 4, n); return the planes there."""
    k = len(at_px)
    places = at_px.reshape(k, -1, 2)
    apart = places - places.mean(axis=1, keepdims=True)
    plane = np.concatenate([np.ones((*places.shape[:2], 1)), apart / np.abs(apart).max()], axis=-1)
    weighted = (plane * (seen.reshape(k, -1, 1) + 1e-9)).swapaxes(1, 2)
    stacked = np.stack([level.reshape(k, -1) for level in levels], axis=-1)
    fitted = plane @ np.linalg.solve(weighted @ plane, weighted @ stacked)
    return fitted[..., 0].reshape(seen.shape), fitted[..., 1].reshape(seen.shape)
