"""Sparse bundle adjustment: all poses of a calibration from the corners of all tags in all pictures.

Levenberg-Marquardt on the normal equations, factorised sparsely (SuperLU): the work grows with the views. Corners go
through the lens exactly; a tag whose corners lie far off counts in proportion to its root (Huber). Source: Triggs et
al., "Bundle Adjustment - A Modern Synthesis" (2000), sections 3, 4 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from camrig.calibrate.chains import Indices
from camrig.calibrate.normal import NOTHING_KNOWN, Pattern, Priors, TagViews, counted, linearised, pattern, residuals_px
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens
from camrig.geometry.pnp_kernel import move_stack

_STEPS = 50
_DONE_SHARE = 1e-6
"""A step that lowers the cost by less than this share of it is the last one."""

_MEDIAN_OF_NORMAL = 0.6745
"""The median of the absolute value of a unit normal number."""


_LEAST_LEFT = 0.1
"""A view that the unknowns follow wherever it is tells nothing of noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The (n, 4, 4) most probable poses, and the pixels (m, 4, 2) by which they miss the corners, also over sigma;
    which of the corners count (m, 4).
    """

    T: Array
    residual_px: Array
    normalised: Array
    counts: npt.NDArray[np.bool_]
    _left: Array
    _factor: SuperLU
    _slot: Indices

    @property
    def rms_px(self) -> float:
        """The root mean square distance of corners from where they were seen."""
        return float(np.sqrt(2.0 * np.mean(np.square(self.residual_px[self.counts]))))

    @property
    def median_px(self) -> float:
        """The median distance."""
        return float(np.median(np.linalg.norm(self.residual_px[self.counts], axis=-1)))

    def noise_factor(self) -> float:
        """Return by what the corners' sigma must be multiplied to be that of the middle half of these residuals."""
        unshrunk = self.normalised / np.sqrt(self._left)[:, None, None]
        return float(np.median(np.abs(unshrunk[self.counts])) / _MEDIAN_OF_NORMAL)

    def covariance_of(self, pose: int) -> Array:
        """Return the (6, 6) covariance (geometry.pose) of one pose, all others unknown too; zero for one held."""
        slot = int(self._slot[pose])
        if slot < 0:
            return np.zeros((6, 6))
        rows = slice(6 * slot, 6 * slot + 6)
        unit = np.zeros((self._factor.shape[0], 6))
        unit[rows] = np.eye(6)
        found = self._factor.solve(unit)[rows]
        return np.asarray(0.5 * (found + found.T))


def adjust(
    views: TagViews,
    lenses: Sequence[Lens],
    start: Array,
    held: npt.NDArray[np.bool_],
    robust: bool = True,
    priors: Priors = NOTHING_KNOWN,
) -> Adjusted:
    """Minimise the sum of squares of all corners, and of how far ``priors`` are missed, over the poses that are not
    ``held`` (n,), from (n, 4, 4) ``start``.

    Raises InputError where a pose that is not held is in no view, or where nothing holds the whole in place.
    """
    into = pattern(views.chains, held)
    T, damping = start.copy(), 1e-4
    normal = linearised(views, lenses, T, into, robust, priors)
    for _ in range(_STEPS):
        step = -_factorised(normal.H, damping).solve(normal.g)
        moved = T.copy()
        moved[into.poses] = move_stack(T[into.poses], np.ascontiguousarray(step.reshape(-1, 6)))
        chi2 = np.square(_normalised(views, residuals_px(views, lenses, moved))).sum(axis=(1, 2))
        gain = normal.cost - float(counted(chi2, robust)[1].sum()) - priors.cost(moved)
        if gain >= 0.0:
            T, damping = moved, 0.1 * damping if damping > 1e-10 else 0.0
            normal = linearised(views, lenses, T, into, robust, priors)
        else:
            damping = max(10.0 * damping, 1e-6)
        if abs(gain) <= _DONE_SHARE * normal.cost:
            break
    residual_px = residuals_px(views, lenses, T)
    factor = _factorised(normal.H, 0.0)
    counts = np.isfinite(views.sigma_px)
    return Adjusted(T, residual_px, _normalised(views, residual_px), counts, _left(views, into), factor, into.slot)


def _left(views: TagViews, into: Pattern) -> Array:
    """Return what share (m,) of each view's numbers the unknowns leave: each pose takes six, evenly from its own."""
    slots = np.append(into.slot, -1)[views.chains.columns]
    numbers = 2.0 * np.isfinite(views.sigma_px).sum(axis=1)
    every = np.broadcast_to(numbers[:, None], slots.shape)[slots >= 0]
    of_pose = np.bincount(slots[slots >= 0], weights=every, minlength=1)
    taken = np.where(slots >= 0, 6.0 / of_pose[slots], 0.0).sum(axis=1)
    return np.asarray(np.maximum(1.0 - taken, _LEAST_LEFT))


def _normalised(views: TagViews, residual_px: Array) -> Array:
    return np.asarray(residual_px / views.sigma_px[..., None])


def _factorised(H: sparse.csc_array, damping: float) -> SuperLU:
    """Factorise the damped normal matrix. Raises InputError where it is singular."""
    damped = H + sparse.diags_array(damping * H.diagonal(), format="csc") if damping else H
    try:
        return splu(damped, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:  # SuperLU's word for it: "Factor is exactly singular"
        raise InputError("nothing holds these poses in place: hold one of them, or name an anchor") from error
