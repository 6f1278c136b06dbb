"""Known lengths: tags printed a little too large, or of unknown size, put right by a tape measure.

A tag's size is the scale of everything seen through it. Printers scale all tags alike, so one factor on the sizes of
all tags is asked: that with which marks are as far apart as they were measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.extrinsics import Extrinsics, Uncertain, extrinsics
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import Shot
from camrig.errors import InputError

_ROUNDS = 4
_DONE = 1e-5


@dataclass(frozen=True, slots=True)
class Length:
    """The distance of the centres (of boards: the origins) of two marks as it was measured."""

    a: str
    b: str
    metres: float


@dataclass(frozen=True, slots=True)
class Misfit:
    """A known length, what it came to, and one sigma of that from the pictures alone, in metres."""

    length: Length
    found_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """The answer; with what it was found, by what sizes of tags were multiplied (None: lengths were only compared), and
    what lengths came to.
    """

    found: Extrinsics
    setup: Setup
    factor: float | None
    misfits: tuple[Misfit, ...]


def with_lengths(shots: Sequence[Shot], setup: Setup, lengths: Sequence[Length], boards: bool) -> Scaled:
    """Place everything so that ``lengths`` are right; two anchors in view, or ``boards`` of known squares, say the
    scale better: then lengths are only compared.

    Raises InputError for a length between marks that nothing ties.
    """
    found, factor = extrinsics(shots, setup), 1.0
    if not lengths:
        return Scaled(found, setup, None, ())
    misfits = tuple(_misfit(found, length) for length in lengths)
    if boards or sum(mark in setup.anchors for mark in found.room) > 1:
        return Scaled(found, setup, None, misfits)
    for _ in range(_ROUNDS):
        wrong = float(np.exp(np.mean([np.log(each.length.metres / each.found_m) for each in misfits])))
        if abs(wrong - 1.0) < _DONE:
            break
        factor *= wrong
        # Heads and kept cameras have sizes of their own, which pull: so it takes rounds.
        setup = replace(setup, sizes_m={tag: wrong * size_m for tag, size_m in setup.sizes_m.items()})
        found = extrinsics(shots, setup)
        misfits = tuple(_misfit(found, length) for length in lengths)
    return Scaled(found, setup, factor, misfits)


def _misfit(found: Extrinsics, length: Length) -> Misfit:
    a, b = (_mark(found, name, length) for name in (length.a, length.b))
    if found.body_of[length.a] != found.body_of[length.b]:
        raise InputError(f"length {length.a}-{length.b}: one stands in the room, the other is carried")
    away = b.T[:3, 3] - a.T[:3, 3]
    distance = float(np.linalg.norm(away))
    if distance < 1e-9:
        raise InputError(f"length {length.a}-{length.b}: both are at one place")
    along = away / distance
    variance = along @ (a.covariance[:3, :3] + b.covariance[:3, :3]) @ along
    return Misfit(length, distance, float(np.sqrt(variance)))


def _mark(found: Extrinsics, name: str, length: Length) -> Uncertain:
    mark = found.room.get(name) or found.body_marks.get(name)
    if mark is None:
        known = ", ".join([*found.room, *found.body_marks])
        raise InputError(f"length {length.a}-{length.b}: {name} is not placed; {known or 'nothing'} is")
    return mark
