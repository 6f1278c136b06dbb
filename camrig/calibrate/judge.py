"""What an extrinsic calibration is worth: what does not fit, since when, and what hangs on what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.calibrate.extrinsics import Extrinsics
from camrig.calibrate.sighted import ALWAYS
from camrig.geometry.arrays import Array

LOOSE_SIGMAS = 8.0
"""A mark that misses by so much on average is elsewhere."""

LOOSE_SHARE = 0.5
"""A mark that is elsewhere in so many pictures keeps no place."""

CHANGE = 0.8
"""From an instant on something was moved if the share of pictures that do not fit rises or falls by so much there."""

LEAST_PICTURES = 3
"""On either side of it."""


@dataclass(frozen=True, slots=True)
class Loose:
    """A mark that is elsewhere than it should be: in which share of its pictures, and from (``since``) or until which
    instant, None where that is no matter of time.
    """

    mark: str
    share: float
    instant: int | None
    since: bool


def loose_marks(found: Extrinsics) -> Iterator[Loose]:
    """Yield the marks that do not keep their place, on their body or in the room."""
    by_mark: dict[str, list[tuple[int, bool]]] = {}
    for each, off in zip(found.sighted, found.residual_px, strict=True):
        miss = float(np.median(np.linalg.norm(off, axis=1)))
        by_mark.setdefault(each.mark, []).append((each.picture.instant, miss > LOOSE_SIGMAS * found.noise_px))
    for mark, seen in sorted(by_mark.items()):
        share = float(np.mean([wrong for _, wrong in seen]))
        instant, since = _change(sorted(seen))
        if instant is not None or share > LOOSE_SHARE:
            yield Loose(mark, share, instant, since)


def _change(seen: Sequence[tuple[int, bool]]) -> tuple[int | None, bool]:
    """Return from which instant on a mark is elsewhere (True) or at its place (False)."""
    wrong = np.array([each for _, each in seen], dtype=float)
    best, at = CHANGE, None
    for k in range(LEAST_PICTURES, len(seen) - LEAST_PICTURES + 1):
        if seen[k][0] == ALWAYS or seen[k][0] == seen[k - 1][0]:
            continue
        rise = float(wrong[k:].mean() - wrong[:k].mean())
        if abs(rise) > abs(best):
            best, at = rise, k
    return (None, True) if at is None else (seen[at][0], best > 0.0)


def groups(names: Sequence[str], shared: Mapping[tuple[str, str], int]) -> list[list[str]]:
    """Return the cameras that hang together, largest group first."""
    parent = {name: name for name in names}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    for (a, b), count in shared.items():
        if count:
            parent[root(b)] = root(a)
    found = [[name for name in names if root(name) == each] for each in names if root(each) == each]
    return sorted(found, key=lambda group: -len(group))


def missing_links(
    names: Sequence[str], shared: Mapping[tuple[str, str], int], places_m: Mapping[str, Array]
) -> list[tuple[str, str]]:
    """Return, for each group of cameras but the largest, which camera of it stands nearest to which one outside, by
    (3,) places where those are known.
    """
    first, *others = groups(names, shared) or [[]]

    def apart_m(a: str, b: str) -> float:
        both = a in places_m and b in places_m
        return float(np.linalg.norm(places_m[a] - places_m[b])) if both else np.inf

    return [min(((a, b) for a in group for b in first), key=lambda pair: apart_m(*pair)) for group in others]
