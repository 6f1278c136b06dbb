"""The sparse normal equations of a bundle adjustment: which blocks there are, and what the views add to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

from camrig.calibrate.chains import Chains, Indices, points_in_camera, slopes_in_camera
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.bundle_kernel import HUBER_CHI2
from camrig.geometry.lens import Lens
from camrig.geometry.pnp_kernel import MIN_DEPTH_M
from camrig.geometry.pose import difference

_AT_ONCE = 4096
"""Views linearised at a time: bounds the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class TagViews:
    """m tags in pictures: by which ``lens`` (m,) each was seen and how it hangs together, its (m, 4, 3) corners in the
    tag's frame, its (m, 4, 2) pixels (OpenCV's), and their (m, 4) sigma; a corner of infinite sigma does not count.
    A board with more corners is several of these.
    """

    lens: Indices
    chains: Chains
    corners_m: Array
    pixels: Array
    sigma_px: Array

    def only(self, kept: npt.NDArray[np.bool_] | slice) -> TagViews:
        """Return some of the views."""
        parts = (self.corners_m[kept], self.pixels[kept], self.sigma_px[kept])
        return TagViews(self.lens[kept], self.chains.only(kept), *parts)


@dataclass(frozen=True, slots=True, eq=False)
class Priors:
    """What is known of ``poses`` (k,) beforehand: (k, 4, 4) where they are, (k, 6, 6) information (geometry.pose)."""

    poses: Indices
    T: Array
    information: Array

    def misses(self, T: Array) -> Array:
        """Return the (k, 6) differences of (n, 4, 4) poses from what was known."""
        pairs = zip(T[self.poses], self.T, strict=True)
        return np.array([difference(now, before) for now, before in pairs]).reshape(-1, 6)

    def cost(self, T: Array) -> float:
        """Return the sum of squares of the misses over their sigma."""
        e = self.misses(T)
        return float(np.einsum("ki,kij,kj->", e, self.information, e))


NOTHING_KNOWN = Priors(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where the 6 x 6 blocks of the normal equations are: of which pairs of the u unknown poses.

    ``poses`` (u,) are the unknown ones, ``slot`` (n,) tells which of these a pose is (-1: it is held). ``rows`` and
    ``columns`` are the blocks in compressed rows, ``diagonal`` (u,) those of a pose with itself. Of each chunk of views
    one matrix adds up the blocks, another the gradients.
    """

    poses: Indices
    slot: Indices
    rows: Indices
    columns: Indices
    diagonal: Indices
    add_blocks: tuple[sparse.csr_array, ...]
    add_gradients: tuple[sparse.csr_array, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """J^T J (6 u, 6 u), J^T r (6 u,) and the cost."""

    H: sparse.csc_array
    g: Array
    cost: float


def pattern(chains: Chains, held: npt.NDArray[np.bool_]) -> Pattern:
    """Find the blocks. Raises InputError where a pose that is not ``held`` (n,) is in no chain."""
    poses = np.flatnonzero(~held)
    u = len(poses)
    slot = np.full(len(held) + 1, -1)  # the last stands for no pose, -1
    slot[poses] = np.arange(u)
    columns = slot[chains.columns]
    if lonely := u - len(np.unique(columns[columns >= 0])):
        raise InputError(f"{lonely} of {u} poses are in no view: leave them out")
    pair = np.where(_both(columns), columns[:, :, None] * u + columns[:, None, :], -1)
    blocks = np.unique(pair[pair >= 0])
    rows = np.searchsorted(blocks, u * np.arange(u + 1))
    chunks = [slice(at, at + _AT_ONCE) for at in range(0, len(columns), _AT_ONCE)]
    return Pattern(
        poses,
        slot[:-1],
        rows,
        blocks % u,
        np.searchsorted(blocks, np.arange(u) * (u + 1)),
        tuple(_adding(np.searchsorted(blocks, pair[chunk]), pair[chunk] >= 0, len(blocks)) for chunk in chunks),
        tuple(_adding(columns[chunk], columns[chunk] >= 0, u) for chunk in chunks),
    )


def _both(columns: Indices) -> npt.NDArray[np.bool_]:
    return np.asarray((columns[:, :, None] >= 0) & (columns[:, None, :] >= 0))


def _adding(to: Indices, used: npt.NDArray[np.bool_], size: int) -> sparse.csr_array:
    """Return the (size, to.size) matrix that adds up what goes to the same place."""
    where = np.flatnonzero(used.ravel())
    return sparse.csr_array((np.ones(len(where)), (to.ravel()[where], where)), shape=(size, to.size))


def linearised(
    views: TagViews, lenses: Sequence[Lens], T: Array, into: Pattern, robust: bool, priors: Priors = NOTHING_KNOWN
) -> Normal:
    """Add up the normal equations of all views and priors at (n, 4, 4) poses."""
    u = len(into.poses)
    blocks, g, cost = np.zeros((len(into.columns), 36)), np.zeros((u, 6)), 0.0
    for k, (add_blocks, add_gradients) in enumerate(zip(into.add_blocks, into.add_gradients, strict=True)):
        chunk = views.only(slice(k * _AT_ONCE, (k + 1) * _AT_ONCE))
        residual, J = _whitened(chunk, lenses, T)
        weight, costs = counted(np.square(residual).sum(axis=1), robust)
        cost += float(costs.sum())
        m, c = len(residual), J.shape[2] // 6
        weighted = J * weight[:, None, None]
        H = weighted.swapaxes(1, 2) @ J
        blocks += add_blocks @ H.reshape(m, c, 6, c, 6).swapaxes(2, 3).reshape(-1, 36)
        g += add_gradients @ (residual[:, None] @ weighted).reshape(-1, 6)
    free = into.slot[priors.poses] >= 0
    slots, information = into.slot[priors.poses[free]], priors.information[free]
    np.add.at(blocks, into.diagonal[slots], information.reshape(-1, 36))
    np.add.at(g, slots, (information @ priors.misses(T)[free][..., None])[..., 0])
    cost += priors.cost(T)
    # Symmetric: its rows are its columns.
    of_blocks = sparse.bsr_array((blocks.reshape(-1, 6, 6), into.columns, into.rows), shape=(6 * u, 6 * u))
    return Normal(sparse.csc_array(of_blocks), g.ravel(), cost)


def counted(chi2: Array, robust: bool) -> tuple[Array, Array]:
    """Return the weight and the cost of views with these sums of squares; robust, by Huber."""
    if not robust:
        return np.ones_like(chi2), chi2
    weight = np.sqrt(HUBER_CHI2 / np.maximum(chi2, HUBER_CHI2))
    return weight, np.where(chi2 > HUBER_CHI2, 2.0 * np.sqrt(HUBER_CHI2 * chi2) - HUBER_CHI2, chi2)


def residuals_px(views: TagViews, lenses: Sequence[Lens], T: Array) -> Array:
    """Return the (m, 4, 2) pixels from where corners were seen to where (n, 4, 4) poses put them."""
    return _pixels(views, lenses, _ideal(points_in_camera(T, views.chains, views.corners_m))) - views.pixels


def _whitened(views: TagViews, lenses: Sequence[Lens], T: Array) -> tuple[Array, Array]:
    """Return the (m, 8) residuals over sigma and their (m, 8, 6 (k + l)) derivative by the poses of the chains."""
    points, slopes = slopes_in_camera(T, views.chains, views.corners_m)
    ideal = _ideal(points)
    depth = np.maximum(points[..., 2], MIN_DEPTH_M)
    m = len(points)
    by_point = np.zeros((m, 4, 2, 3))
    by_point[..., 0, 0] = by_point[..., 1, 1] = 1.0
    by_point[..., 2] = -ideal
    by_point /= (depth * views.sigma_px)[..., None, None]
    J = _lens_slopes(views, lenses, ideal) @ by_point @ slopes.reshape(m, 4, 3, -1)
    residual = (_pixels(views, lenses, ideal) - views.pixels) / views.sigma_px[..., None]
    return residual.reshape(m, 8), J.reshape(m, 8, -1)


def _ideal(points: Array) -> Array:
    # Behind the camera the clamp makes the residual huge: such a step is never taken.
    return np.asarray(points[..., :2] / np.maximum(points[..., 2:], MIN_DEPTH_M))


def _pixels(views: TagViews, lenses: Sequence[Lens], ideal: Array) -> Array:
    """Project ideal points, those past a lens's ``r_max`` straight on outwards: they must not fold back."""
    pixels = np.empty_like(ideal)
    for k, lens in enumerate(lenses):
        own = views.lens == k
        inside, scale = _inside(lens, ideal[own])
        pixels[own] = lens.distort(inside) / scale * np.asarray(lens.focal_px) + np.asarray(lens.centre_px)
    return pixels


def _lens_slopes(views: TagViews, lenses: Sequence[Lens], ideal: Array) -> Array:
    slopes = np.empty((*ideal.shape, 2))
    for k, lens in enumerate(lenses):
        own = views.lens == k
        slopes[own] = np.asarray(lens.focal_px)[:, None] * lens.jacobian(_inside(lens, ideal[own])[0])
    return slopes


def _inside(lens: Lens, ideal: Array) -> tuple[Array, Array]:
    scale = np.minimum(1.0, lens.r_max / np.maximum(np.linalg.norm(ideal, axis=-1, keepdims=True), 1e-12))
    return ideal * scale, scale
