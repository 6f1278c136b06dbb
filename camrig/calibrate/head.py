"""A pan-tilt head calibrated from what its resting camera saw of fixed tags, of unknown place or anchors.

What the motion did not show keeps the file's value and is named; tags that did not keep their place are found, named
and left out; a bend of an axis's counting is taken up only on evidence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.head_fit import UNKNOWNS, HeadFit, fit, is_length, off_model_rad, without
from camrig.calibrate.head_model import HeadModel, HeadShot, HeadViews, views_of
from camrig.calibrate.head_start import begin, placed_anew
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens

LEAST_SHOTS = 8
_UNSHOWN_M, _UNSHOWN_RAD, _UNSHOWN_FACTOR = 0.02, math.radians(0.5), 0.02
"""An unknown whose sigma is above this was not shown by the motion."""
_MOVED_SIGMAS, _MOVED_SHARE = 8.0, 0.25
"""A tag of which so large a share of views is so far off does not keep its place."""
_BEND_TURN_RAD = math.radians(90.0)
"""A bend of one period a turn is not looked for on less."""
_BEND_SIGMAS = 4.0
_HELD_OUT = 4
"""Each so-manieth shot is left out to see how well the others foretell it."""


@dataclass(frozen=True, slots=True, eq=False)
class HeadCalibration:
    """The fit, and what to think of it.

    ``unshown`` are the unknowns that keep the file's value, ``loose`` the tags that did not keep their place.
    ``held_out_rad`` (n, 2) is by how much shots were off a head that was fitted without them.
    """

    fit: HeadFit
    anchored: bool
    unshown: tuple[str, ...]
    loose: tuple[str, ...]
    held_out_rad: Array
    shots: tuple[HeadShot, ...]

    @property
    def pointing_rad(self) -> float:
        """One sigma, of both axes together, of where the optics rest against where the model says."""
        off = self.held_out_rad[np.isfinite(self.held_out_rad).all(axis=1)]
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else math.nan


def calibrate_head(
    shots: Sequence[HeadShot],
    lens: Lens,
    sizes_m: Mapping[str, float],
    start: HeadModel,
    anchors: Mapping[str, Transform] | None = None,
) -> HeadCalibration:
    """Fit a head from its shots; ``start`` has roughly right signs and scales (``head_start.with_turns``).

    Without anchors in view the base stays where the file has it, and pan's zero too. Raises InputError with fewer than
    eight shots of tags.
    """
    known = {name: T for name, T in (anchors or {}).items() if any(name in shot.corners_px for shot in shots)}
    known = {name: T for name, T in known.items() if name in sizes_m}
    views = views_of(shots, lens, sizes_m)
    shown = len(np.unique(views.shot))
    if shown < LEAST_SHOTS:
        raise InputError(
            f"only {shown} of {len(shots)} stops showed a tag, and {LEAST_SHOTS} are needed: hang tags where the head "
            "can look, or give it wider limits"
        )
    model, tags = begin(start, views, known)
    free = [name for name in UNKNOWNS if _is_asked(name, bool(known))]
    found, free, unshown = _with_what_is_shown(views, model, tags, free, tuple(known))
    if doubtful := _loose(found):  # perhaps only begun from the wrong one of its square's two poses
        anew = {name: placed_anew(found.model, views, views.tags.index(name)) for name in doubtful if name not in known}
        turned = {name: T for name, T in anew.items() if T is not None}
        found = fit(views, found.model, {**found.T_world_tag, **turned}, free, tuple(known))
    if loose := _loose(found):
        views = without(found, loose)
        left = {name: T for name, T in found.T_world_tag.items() if name not in loose}
        found = fit(views, found.model, left, free, tuple(known))
    found, free = _with_bends(found, free, tuple(known))
    return HeadCalibration(
        found, bool(known), tuple(unshown), loose, _held_out(found, free, tuple(known)), tuple(shots)
    )


def _is_asked(name: str, anchored: bool) -> bool:
    part, what = name.split()
    if what in ("sine", "cosine"):
        return False
    return anchored or (part != "base" and name != "pan offset")


def _with_what_is_shown(
    views: HeadViews,
    model: HeadModel,
    tags: Mapping[str, Transform],
    free: list[str],
    anchors: Sequence[str],
) -> tuple[HeadFit, list[str], list[str]]:
    """Fit; hold at the file's value what turned out not to be shown, and fit again."""
    unshown: list[str] = []
    while True:
        found = fit(views, model, tags, free, anchors)
        vague = [name for name in free if found.sigma[name] > _bound(name)]
        if not vague:
            return found, free, unshown
        unshown += vague
        free = [name for name in free if name not in vague]


def _bound(name: str) -> float:
    if name.endswith("factor"):
        return _UNSHOWN_FACTOR
    return _UNSHOWN_M if is_length(name) else _UNSHOWN_RAD


def _loose(found: HeadFit) -> tuple[str, ...]:
    """Return the tags that are elsewhere in a good part of the shots that show them, if others remain."""
    missed = np.sqrt(np.square(found.missed_px).mean(axis=1)) > _MOVED_SIGMAS * found.noise_px
    share = {name: float(missed[found.views.tag == k].mean()) for k, name in enumerate(found.views.tags)}
    loose = tuple(name for name, part in share.items() if part > _MOVED_SHARE)
    return loose if len(loose) < len(share) else ()


def _with_bends(found: HeadFit, free: list[str], anchors: Sequence[str]) -> tuple[HeadFit, list[str]]:
    """Let an axis that turned far enough bend its counting; keep that where it is clear of its own sigma."""
    for k, axis in enumerate(("pan", "tilt")):
        line_rad = found.model.axes[k].line_rad(found.views.reported_rad[:, k])
        if float(np.ptp(line_rad[np.unique(found.views.shot)])) < _BEND_TURN_RAD:
            continue
        bends = [f"{axis} sine", f"{axis} cosine"]
        bent = fit(found.views, found.model, found.T_world_tag, [*free, *bends], anchors)
        size = np.array([bent.model.axes[k].sine_rad, bent.model.axes[k].cosine_rad])
        rows = [len(free), len(free) + 1]
        chi2 = float(size @ np.linalg.solve(bent.covariance[np.ix_(rows, rows)], size))
        asked = [name for name in (*bends, f"{axis} offset") if name in bent.sigma]
        if chi2 > _BEND_SIGMAS**2 and all(bent.sigma[name] < _bound(name) for name in asked):
            found, free = bent, [*free, *bends]
    return found, free


def _held_out(found: HeadFit, free: Sequence[str], anchors: Sequence[str]) -> Array:
    """Return (n, 2): by how much shots are off the head that the others give; NaN of those not asked."""
    views = found.views
    shown = np.unique(views.shot)
    off = np.full((len(views.reported_rad), 2), np.nan)
    tested = shown[_HELD_OUT // 2 :: _HELD_OUT]
    kept = ~np.isin(views.shot, tested)
    if not len(tested) or set(views.tag[kept]) != set(views.tag):
        return off
    refit = fit(views.only(kept), found.model, found.T_world_tag, free, anchors)
    off[tested] = off_model_rad(refit.model, refit.T_world_tag, views.only(~kept))[tested]
    return off


def with_known_flanks(shots: Sequence[HeadShot]) -> tuple[HeadShot, ...]:
    """Return the shots of which it is known from which side both axes came."""
    return tuple(shot for shot in shots if np.all(shot.travel != 0.0))


def on_a_pivot(model: HeadModel, reported_rad: Array) -> HeadModel:
    """Return a head whose zeros are kept at (2,) reports where nothing shows them."""
    axes = [replace(axis, pivot_rad=float(at)) for axis, at in zip(model.axes, reported_rad, strict=True)]
    return replace(model, axes=(axes[0], axes[1]))
