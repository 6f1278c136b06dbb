"""Which of several identical movers goes to which place, so that all together travel least. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from camrig.geometry.arrays import Array


def least_travel(positions_m: Array, places_m: Array) -> npt.NDArray[np.intp]:
    """Return (n,) the place of each mover for (n, 3) positions and places: least total distance (Hungarian)."""
    distance = np.linalg.norm(positions_m[:, None, :] - places_m[None, :, :], axis=-1)
    return np.asarray(linear_sum_assignment(distance)[1])
