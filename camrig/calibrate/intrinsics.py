"""A lens from pictures of a board: bad pictures set aside by name, a form chosen by evidence, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from camrig.calibrate.boards import Board
from camrig.calibrate.lens_evidence import Candidate, best_of, calibrated_radius, candidates, sideways_mm
from camrig.calibrate.lens_fit import LensFit, Points, fit_lens, points_of
from camrig.calibrate.lens_forms import (
    BROWN,
    COEFFICIENTS,
    CX,
    CY,
    FISHEYE,
    FISHEYE_LADDER,
    FX,
    FY,
    LADDER,
    LensForm,
    distortion_of,
)
from camrig.calibrate.shots import FEWEST_POINTS, Gauges, Shot, gauges, repeats, spread_out
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens, FisheyeLens

FEWEST_SHOTS = 4
MOST_SHOTS = 60
"""More pictures than this, the most different ones, make no better lens, and work grows with them."""

DISTANCE_M = 3.0

_BLURRED = 2.0
_BLURRED_PX = 5.0
"""A picture is blurred whose edges are wider than this, and so much wider than those of most."""

_OUTLIER = 3.0
_OUTLIER_PX = 0.3
_ROUNDS = 4
_FLAT_RAD = math.radians(8.0)
_USELESS = 0.05
"""Sigma of the focal length over it: a lens known worse is not worth writing."""

_FEW_SHOTS = 10
_LOOSE, _VERY_LOOSE = 0.005, 0.02
_OVERFIT, _VERY_OVERFIT = 1.15, 1.5
_NOISY_PX, _VERY_NOISY_PX = 0.7, 1.5
_LEAST_COVERAGE = 0.6
_LEAST_TILT_RAD = math.radians(20.0)
_LEAST_SIDES = 3


class Kind(StrEnum):
    """Which lenses are tried."""

    AUTO = "auto"
    BROWN = "brown"
    FISHEYE = "fisheye"


@dataclass(frozen=True, slots=True)
class Concern:
    """A sentence about what is wrong with a calibration; ``severe``: it should not be used."""

    text: str
    severe: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """A calibrated lens. ``rejected`` says why by picture; ``used`` are in the order of ``fit``'s poses; ``tried`` are
    all forms; ``sideways_mm`` (rows, columns) is one sigma at ``DISTANCE_M`` over the picture.
    """

    lens: BrownLens | FisheyeLens
    chosen: Candidate
    tried: tuple[Candidate, ...]
    used: tuple[str, ...]
    rejected: dict[str, str]
    gauges: Gauges
    sideways_mm: Array
    concerns: tuple[Concern, ...]

    @property
    def fit(self) -> LensFit:
        """Return the fit to the pictures that were used."""
        return self.chosen.fit

    @property
    def unbounded(self) -> BrownLens | FisheyeLens:
        """Return the lens as far as it is one-to-one."""
        return self.fit.form.lens(self.fit.numbers, self.lens.size_px)

    @property
    def distortion(self) -> tuple[float, ...]:
        """Return the coefficients in OpenCV's order, as many as OpenCV would write."""
        return distortion_of(self.fit.form, self.lens)

    @property
    def sigma(self) -> dict[str, float]:
        """Return one sigma of each number that was found."""
        deviation = np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0))
        found = {name: float(deviation[index]) for name, index in (("fx", FX), ("fy", FY), ("cx", CX), ("cy", CY))}
        names = FISHEYE if self.fit.form.fisheye else BROWN
        return found | {name: float(deviation[COEFFICIENTS + names.index(name)]) for name in self.fit.form.free}


def calibrate_lens(
    shots: Sequence[Shot],
    board: Board,
    size_px: tuple[int, int],
    kind: Kind = Kind.AUTO,
    step: Callable[[], None] = lambda: None,
) -> Intrinsics:
    """Find a camera's lens. ``step`` is called after each of ``steps(kind)`` parts of the work.

    Raises InputError, in a sentence that says what pictures to take, where they do not determine it.
    """
    rejected = dict(_unfit(shots, size_px))
    kept = [shot for shot in shots if shot.name not in rejected]
    if len(kept) < FEWEST_SHOTS:
        raise InputError(_too_few(len(kept), rejected))
    kept = spread_out(kept, MOST_SHOTS)
    kept, outliers = _without_outliers(kept, board, size_px, kind)
    rejected |= outliers
    if len(kept) < FEWEST_SHOTS:
        raise InputError(_too_few(len(kept), rejected))
    points = _points(kept, board, size_px)
    _refuse_one_way(_judged(points, kind).T_camera_board[:, :3, 2])
    tried = [each for ladder in _ladders(kind) for each in candidates(points, ladder, step)]
    chosen = best_of(tried)
    _refuse_undetermined(chosen.fit)
    normals = chosen.fit.T_camera_board[:, :3, 2]
    leans = -np.sign(normals[:, 2:]) * normals[:, :2]
    measured = gauges([shot.view for shot in kept], board, size_px, leans)
    lens = _with_radius(chosen.fit)
    mm = sideways_mm(chosen.fit, DISTANCE_M)
    found = Intrinsics(
        lens, chosen, tuple(tried), tuple(shot.name for shot in kept), rejected, measured, mm, concerns=()
    )
    return Intrinsics(lens, chosen, tuple(tried), found.used, rejected, measured, mm, concerns=tuple(_concerns(found)))


def steps(kind: Kind) -> int:
    """Return how often ``calibrate_lens`` calls its ``step``."""
    return sum(len(ladder) for ladder in _ladders(kind))


def _ladders(kind: Kind) -> list[tuple[LensForm, ...]]:
    brown, fisheye = kind is not Kind.FISHEYE, kind is not Kind.BROWN
    return [LADDER] * brown + [FISHEYE_LADDER] * fisheye


def _unfit(shots: Sequence[Shot], size_px: tuple[int, int]) -> Iterator[tuple[str, str]]:
    """Yield the pictures that are no use, and why, before anything is fitted."""
    enough = [shot for shot in shots if len(shot.view.ids) >= FEWEST_POINTS]
    usual = float(np.nanmedian([shot.edge_px for shot in enough])) if enough else 0.0
    sharp = []
    for shot in shots:
        if len(shot.view.ids) < FEWEST_POINTS:
            yield shot.name, f"shows {len(shot.view.ids)} points of the board; {FEWEST_POINTS} are needed"
        elif shot.edge_px > max(_BLURRED * usual, _BLURRED_PX):
            yield shot.name, f"is blurred: edges are {shot.edge_px:.1f} px wide, of most pictures {usual:.1f} px"
        else:
            sharp.append(shot)
    for name, other in repeats(sharp, size_px[0]).items():
        yield name, f"repeats {other}: the board is where it was"


def _without_outliers(
    kept: list[Shot], board: Board, size_px: tuple[int, int], kind: Kind
) -> tuple[list[Shot], dict[str, str]]:
    """Set pictures aside whose points miss by far more than those of most; a lens of middling freedom judges."""
    rejected: dict[str, str] = {}
    for _ in range(_ROUNDS):
        rms = _judged(_points(kept, board, size_px), kind).rms_by_picture_px
        usual = float(np.median(rms))
        bad = rms > max(_OUTLIER * usual, _OUTLIER_PX)
        if not bad.any() or len(kept) - int(bad.sum()) < FEWEST_SHOTS:
            break
        for shot, each in zip(kept, rms, strict=True):
            if each > max(_OUTLIER * usual, _OUTLIER_PX):
                rejected[shot.name] = f"its points miss by {each:.2f} px, those of most pictures by {usual:.2f} px"
        kept = [shot for shot, out in zip(kept, bad, strict=True) if not out]
    return kept, rejected


def _judged(points: Points, kind: Kind) -> LensFit:
    """Return whichever lens of a few coefficients fits best."""
    forms = [ladder[-4 if ladder is LADDER else -2] for ladder in _ladders(kind)]
    fits = []
    for form in forms:
        try:
            fits.append(fit_lens(points, form))
        except InputError:
            continue
    if not fits:
        raise InputError("no lens fits these pictures: is it the right board, and are there several views of it?")
    return min(fits, key=lambda fit: fit.noise_px)


def _points(kept: Sequence[Shot], board: Board, size_px: tuple[int, int]) -> Points:
    return points_of(size_px, [(board.points_m[shot.view.ids], shot.view.corners_px) for shot in kept])


def _too_few(count: int, rejected: dict[str, str]) -> str:
    why = "".join(f"\n{name} {reason}" for name, reason in rejected.items())
    return f"{count} different pictures of the board are too few: take {_FEW_SHOTS} or more, tilted to all sides{why}"


def _refuse_one_way(normals: Array) -> None:
    turned_rad = math.acos(min(max(float((normals @ normals.T).min()), -1.0), 1.0))
    if turned_rad < _FLAT_RAD:
        raise InputError(
            f"the board faces the same way in all pictures (within {math.degrees(turned_rad):.0f} deg), "
            "which tells nothing of the focal length: tilt it by 20 to 45 deg to all sides"
        )


def _refuse_undetermined(fit: LensFit) -> None:
    share = math.sqrt(max(fit.covariance[FX, FX], 0.0)) / fit.numbers[FX]
    if share > _USELESS:
        raise InputError(
            f"the focal length is known to {100.0 * share:.0f} % only: take more pictures, the board nearer, tilted by "
            "20 to 45 deg to all sides, and in every corner"
        )


def _with_radius(fit: LensFit) -> BrownLens | FisheyeLens:
    lens = fit.form.lens(fit.numbers, fit.points.size_px)
    radius = math.floor(1e4 * calibrated_radius(fit)) / 1e4
    kind = FisheyeLens if isinstance(lens, FisheyeLens) else BrownLens
    return kind(lens.size_px, lens.focal_px, lens.centre_px, lens.distortion, radius)


def _concerns(found: Intrinsics) -> Iterator[Concern]:
    fit = found.fit
    share = found.sigma["fx"] / fit.numbers[FX]
    if len(found.used) < _FEW_SHOTS:
        yield Concern(f"{len(found.used)} pictures are few: take {_FEW_SHOTS} or more")
    if share > _LOOSE:
        text = f"not enough data: the focal length is known to {100.0 * share:.1f} % ({found.sigma['fx']:.1f} px)"
        yield Concern(f"{text}; more pictures, or a board with more corners", severe=share > _VERY_LOOSE)
    ratio = found.chosen.heldout_rms_px / fit.rms_px
    if ratio > _OVERFIT:
        text = f"pictures held out miss by {ratio:.2f} times as much as those used"
        yield Concern(f"{text}: more pictures, more different ones", severe=ratio > _VERY_OVERFIT)
    if fit.rms_px > _NOISY_PX:
        text = f"points miss by {fit.rms_px:.2f} px: the board bends, its word is wrong, or focus moved"
        yield Concern(text, severe=fit.rms_px > _VERY_NOISY_PX)
    if found.gauges.coverage < _LEAST_COVERAGE:
        yield Concern(
            f"the board was seen in {100.0 * found.gauges.coverage:.0f} % of the picture: hold it in every corner"
        )
    if found.gauges.tilt_rad < _LEAST_TILT_RAD or found.gauges.sides < _LEAST_SIDES:
        tilt = f"{math.degrees(found.gauges.tilt_rad):.0f} deg at most, to {found.gauges.sides} of 4 sides"
        yield Concern(f"the board was tilted little ({tilt}): tilt it by 20 to 45 deg to all sides")
