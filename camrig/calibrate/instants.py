"""Which pictures of several cameras were taken at one instant, by their stamps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from camrig.errors import InputError
from camrig.geometry.arrays import Array


def instants_of(stamps_s: Mapping[str, Array]) -> dict[str, npt.NDArray[np.int64]]:
    """Return the instant of each picture, numbered, by each camera's (n,) ascending stamps.

    Pictures of different cameras less than half a picture's time apart, and no two of one camera, are of one instant.

    Raises InputError for stamps that do not ascend.
    """
    for name, own in stamps_s.items():
        if (np.diff(own) <= 0.0).any():
            raise InputError(f"the stamps of {name} do not ascend")
    steps = [float(np.median(np.diff(own))) for own in stamps_s.values() if len(own) > 1]
    within_s = 0.5 * min(steps, default=0.0)
    instants = {name: np.zeros(len(own), dtype=np.int64) for name, own in stamps_s.items()}
    instant, first_s, there = -1, -np.inf, set[str]()
    for stamp_s, name, k in sorted((float(t), name, k) for name, own in stamps_s.items() for k, t in enumerate(own)):
        if stamp_s - first_s > within_s or name in there:
            instant, first_s, there = instant + 1, stamp_s, set()
        there.add(name)
        instants[name][k] = instant
    return instants
