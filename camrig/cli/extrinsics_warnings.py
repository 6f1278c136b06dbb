"""What is amiss with an extrinsic calibration, and what to do: one sentence each."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from camrig.calibrate.extrinsics import Extrinsics
from camrig.calibrate.judge import Loose, loose_marks
from camrig.calibrate.scale import Misfit, Scaled
from camrig.calibrate.setup import Setup

NOISY_PX = 1.0
"""Corners that miss by more than this, one sigma, are not those of a stiff board and right lenses."""

FEW_SHARED = 5
"""Two cameras that share fewer instants and tags, and are tied no other way, are tied loosely."""

UNSURE_MM, UNSURE_DEG = 20.0, 0.5
"""A camera known no better than this says little about where targets are."""

WRONG_LENGTH = 0.01
"""A known length that comes out wrong by a larger share is a mistake."""

USUAL_SIGMAS = 5.0
"""A head off by more than so many times what is usual for it is not calibrated."""


def warnings_of(scaled: Scaled, *, in_world: bool) -> Iterator[str]:
    """Yield all that is amiss."""
    found, setup = scaled.found, scaled.setup
    if found.noise_px > NOISY_PX:
        yield f"corners miss by {found.noise_px:.1f} px: the board bends, a camera moved, or a lens or size is wrong"
    yield from map(_loose, loose_marks(found))
    yield from _ties(found, setup)
    if in_world:
        yield from _unsure(found, setup)
    else:
        yield "nothing says where the world is: let a camera see an anchor, or give --origin TAG or --keep CAMERA"
    yield from _heads(found, setup)
    yield from filter(None, map(_length, scaled.misfits))


def _loose(loose: Loose) -> str:
    when = ""
    if loose.instant is not None:
        when = f" from instant {loose.instant} on" if loose.since else f" before instant {loose.instant}"
    share = f"{100.0 * loose.share:.0f} % of its corners are elsewhere"
    return f"{loose.mark} does not keep its place{when}: {share}; leave it out, or is its size another?"


def _ties(found: Extrinsics, setup: Setup) -> Iterator[str]:
    strong = [set(pair) for pair, count in found.shared.items() if count >= FEW_SHARED]
    by_anchors = {each.picture.camera for each in found.sighted if each.mark in setup.anchors}
    for (a, b), count in found.shared.items():
        by_third = any({a, c} in strong and {b, c} in strong for c in setup.lenses)
        if 0 < count < FEW_SHARED and not by_third and not {a, b} <= by_anchors:
            yield f"{a} and {b} share only {count} instants and tags: carry the board where both see it"


def _unsure(found: Extrinsics, setup: Setup) -> Iterator[str]:
    for name, pose in found.placed_cameras.items():
        sigma_mm = float(np.max(pose.sigma_mm))
        if name not in setup.kept and (sigma_mm > UNSURE_MM or pose.sigma_deg > UNSURE_DEG):
            known = f"{name} is known to {sigma_mm:.0f} mm and {pose.sigma_deg:.2f} deg only"
            yield f"{known}: more tags, nearer and further apart"


def _heads(found: Extrinsics, setup: Setup) -> Iterator[str]:
    for name, off_deg in found.aims_off_deg.items():
        sigma_deg, worst_deg = math.degrees(setup.heads[name].angle_sigma_rad), float(np.abs(off_deg).max(initial=0.0))
        if worst_deg > USUAL_SIGMAS * sigma_deg:
            usual = f"{sigma_deg:.2f} deg (bias_deg) would be usual"
            cure = "camrig calibrate head, or --mounts if its camera sits otherwise"
            yield f"{name}'s head is {worst_deg:.2f} deg off what it says, {usual}: {cure}"


def _length(misfit: Misfit) -> str | None:
    length = misfit.length
    if abs(misfit.found_m / length.metres - 1.0) <= WRONG_LENGTH:
        return None
    cure = "measure again, or an anchor or a size is wrong"
    return f"{length.a} to {length.b} is {misfit.found_m:.3f} m, not {length.metres:.3f} m: {cure}"
