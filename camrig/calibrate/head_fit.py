"""All that a head's resting camera tells, in one least squares: axes, camera, counting, play, and where the tags are.

Each shot's angles may be off a little by themselves (repeatability); how much, and how noisy corners are, is found with
the rest (expectation maximisation of two variances). Levenberg-Marquardt, robust by Huber's cost per tag. Source:
Triggs et al., "Bundle Adjustment - A Modern Synthesis" (2000), sections 3 and 6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.head_model import PAN, TILT, HeadModel, HeadViews, missed_px, moved
from camrig.calibrate.normal import counted
from camrig.geometry.arrays import Array
from camrig.geometry.pose import perturb

_STEPS, _ROUNDS = 40, 3
_DONE_SHARE = 1e-6
_FIRST_PX, _LEAST_PX = 1.0, 0.01
_FIRST_RAD, _LEAST_RAD = math.radians(0.5), math.radians(0.002)
_LEAST_LEFT = 0.3
_MEDIAN_CHI2_OF_8 = 7.344
"""The median of the sum of squares of a tag's eight unit normal numbers."""

AXIS_PARTS = ("factor", "offset", "play", "sine", "cosine")
_PARTS: dict[str, dict[str, int]] = {
    "base": {"x": 0, "y": 1, "z": 2, "roll": 3, "pitch": 4},
    "arm": {"x": 0, "roll": 3},
    "mount": {"x": 0, "y": 1, "z": 2, "roll": 3, "yaw": 5},
}
"""Of each pose the unknowns, and which number of its error (geometry.pose) each is; the base's in its own frame."""

_VAGUE_M, _VAGUE_RAD = 0.5, 1.0
"""One sigma of what nothing is known of: keeps what the motion did not show from running away."""

UNKNOWNS = (
    *(f"pan {part}" for part in AXIS_PARTS),
    *(f"tilt {part}" for part in AXIS_PARTS),
    *(f"{pose} {part}" for pose, parts in _PARTS.items() for part in parts),
)
"""Radians and metres; factors have no unit."""


def is_length(name: str) -> bool:
    """Tell whether an unknown is a length."""
    return name.rsplit(maxsplit=1)[-1] in ("x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class HeadFit:
    """The most probable head; ``sigma`` by unknown, of those that were free.

    ``off_rad`` (n, 2) is by how much each shot's angles are off the model, NaN where it showed nothing; ``missed_px``
    (m, 8) what is left of each tag in a picture. ``noise_px`` and ``repeat_rad`` (2,) are one sigma of a corner and of
    each axis's coming to rest.
    """

    model: HeadModel
    T_world_tag: Mapping[str, Array]
    sigma: Mapping[str, float]
    covariance: Array
    """Of the free unknowns in the order of ``sigma``."""
    off_rad: Array
    missed_px: Array
    views: HeadViews
    noise_px: float
    repeat_rad: Array

    @property
    def rms_px(self) -> float:
        """The root mean square distance of corners from where they were seen."""
        return float(np.sqrt(2.0 * np.mean(np.square(self.missed_px))))

    def tag_rms_px(self) -> dict[str, float]:
        """Return that of each tag."""
        each = np.sqrt(2.0 * np.square(self.missed_px).mean(axis=1))
        return {name: float(np.sqrt(np.mean(each[self.views.tag == k] ** 2))) for k, name in enumerate(self.views.tags)}


@dataclass(slots=True)
class _Point:
    """Where the search stands."""

    model: HeadModel
    T_world_tag: Array
    off_rad: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """The normal equations: of the common unknowns (a, a), of the shots' own angles (n, 2, 2), between (n, 2, a)."""

    common: Array
    own: Array
    between: Array
    g_common: Array
    g_own: Array
    cost: float
    residual_px: Array

    def damped(self, damping: float) -> _Normal:
        """Return them with their diagonals raised."""
        own = self.own + damping * self.own * np.eye(2)
        return replace(self, common=self.common + np.diag(damping * np.diag(self.common)), own=own)

    def step(self) -> tuple[Array, Array]:
        """Return the step of the common unknowns (a,) and of the shots' angles (n, 2), these eliminated first."""
        inner = np.linalg.solve(self.own, np.concatenate([self.between, self.g_own[..., None]], axis=2))
        through, own = inner[..., :-1], inner[..., -1]
        g = self.g_common - np.einsum("nka,nk->a", self.between, own)
        common = -np.linalg.solve(self._reduced(through), g)
        return common, -own - through @ common

    def covariances(self) -> tuple[Array, Array]:
        """Return the covariance (a, a) of the common unknowns, and the variances (n, 2) of the shots' angles."""
        through = np.asarray(np.linalg.solve(self.own, self.between), float)
        common: Array = np.asarray(np.linalg.inv(self._reduced(through)), float)
        own = np.linalg.inv(self.own)[:, [0, 1], [0, 1]]
        return common, own + np.einsum("nka,ab,nkb->nk", through, common, through)

    def _reduced(self, through: Array) -> Array:
        return np.asarray(self.common - (self.between.swapaxes(1, 2) @ through).sum(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    views: HeadViews
    free: tuple[str, ...]
    free_tags: tuple[int, ...]
    noise_px: float
    repeat_rad: Array

    def normal(self, at: _Point) -> _Normal:
        """Add up the normal equations."""
        residual, by_link = missed_px(at.model, at.T_world_tag, self.views, at.off_rad)
        weight, costs = counted(np.square(residual / self.noise_px).sum(axis=1), robust=True)
        weight = weight / self.noise_px**2
        common, own = self._columns(at, by_link)
        a, n = common.shape[2], len(at.off_rad)
        weighted = common * weight[:, None, None]
        # Of each view by itself: small products, for which no library starts threads.
        H = (weighted.swapaxes(1, 2) @ common).sum(axis=0)
        vague = np.array([_VAGUE_M if is_length(name) else _VAGUE_RAD for name in self.free])
        H[np.arange(len(vague)), np.arange(len(vague))] += vague**-2.0
        own_H, between, g_own = np.zeros((n, 2, 2)), np.zeros((n, 2, a)), np.zeros((n, 2))
        np.add.at(own_H, self.views.shot, (own * weight[:, None, None]).swapaxes(1, 2) @ own)
        np.add.at(between, self.views.shot, own.swapaxes(1, 2) @ weighted)
        np.add.at(g_own, self.views.shot, ((own * weight[:, None, None]).swapaxes(1, 2) @ residual[..., None])[..., 0])
        prior = self.repeat_rad**-2.0
        own_H[:, [0, 1], [0, 1]] += prior
        g = (residual[:, None] @ weighted).sum(axis=(0, 1))
        return _Normal(H, own_H, between, g, g_own + prior * at.off_rad, self._cost(costs, at), residual)

    def cost(self, at: _Point) -> float:
        """Return what is minimised."""
        residual, _ = missed_px(at.model, at.T_world_tag, self.views, at.off_rad)
        return self._cost(counted(np.square(residual / self.noise_px).sum(axis=1), robust=True)[1], at)

    def _cost(self, costs: Array, at: _Point) -> float:
        return float(costs.sum()) + float(np.square(at.off_rad / self.repeat_rad).sum())

    def _columns(self, at: _Point, by_link: Array) -> tuple[Array, Array]:
        """Return the derivatives (m, 8, a) by the free numbers and tags, and (m, 8, 2) by the shot's own angles."""
        views, model = self.views, at.model
        own = np.stack([by_link[:, :, 1, 5], -by_link[:, :, 3, 4]], axis=2)
        known: dict[str, Array] = {}
        for k, name in ((PAN, "pan"), (TILT, "tilt")):
            slopes = model.axes[k].slopes(views.reported_rad[:, k], views.travel[:, k])[views.shot]
            known |= {f"{name} {part}": own[:, :, k] * slopes[:, p, None] for p, part in enumerate(AXIS_PARTS)}
        turned = np.kron(np.eye(2), model.T_world_base[:3, :3])
        frames = {"base": by_link[:, :, 0] @ turned, "arm": by_link[:, :, 2], "mount": by_link[:, :, 4]}
        for part, names in _PARTS.items():
            known |= {f"{part} {name}": frames[part][:, :, axis] for name, axis in names.items()}
        m = len(views.shot)
        tags = np.zeros((m, 8, len(views.tags), 6))
        tags[np.arange(m), :, views.tag] = by_link[:, :, 5]
        columns = [known[name][:, :, None] for name in self.free]
        return np.concatenate([*columns, tags[:, :, self.free_tags].reshape(m, 8, -1)], axis=2), own

    def stepped(self, at: _Point, common: Array, own: Array) -> _Point:
        """Return the point moved by a step."""
        by = dict(zip(self.free, common.tolist(), strict=False))
        pan, tilt = (
            axis.moved(np.array([by.get(f"{name} {part}", 0.0) for part in AXIS_PARTS]))
            for name, axis in zip(("pan", "tilt"), at.model.axes, strict=True)
        )
        change = {part: np.zeros(6) for part in _PARTS}
        for part, names in _PARTS.items():
            for name, axis in names.items():
                change[part][axis] = by.get(f"{part} {name}", 0.0)
        model = HeadModel(
            moved(at.model.T_world_base, change["base"]),
            perturb(at.model.T_arm_tilt, change["arm"]),
            perturb(at.model.T_mount_camera, change["mount"]),
            (pan, tilt),
        )
        tags = at.T_world_tag.copy()
        for k, change_of_tag in zip(self.free_tags, common[len(self.free) :].reshape(-1, 6), strict=True):
            tags[k] = perturb(tags[k], change_of_tag)
        return _Point(model, tags, at.off_rad + own)


def fit(
    views: HeadViews,
    start: HeadModel,
    T_world_tag: Mapping[str, Array],
    free: Sequence[str],
    anchors: Sequence[str] = (),
) -> HeadFit:
    """Fit the ``free`` ones of ``UNKNOWNS`` and all tags but the ``anchors`` from a start that is roughly right."""
    free_tags = tuple(k for k, name in enumerate(views.tags) if name not in anchors)
    shown = np.unique(views.shot)
    at = _Point(start, np.stack([T_world_tag[name] for name in views.tags]), np.zeros_like(views.reported_rad))
    noise_px, repeat_rad = _FIRST_PX, np.full(2, _FIRST_RAD)
    left = max(_LEAST_LEFT, 1.0 - (len(free) + 6 * len(free_tags) + len(shown)) / (8.0 * len(views.shot)))
    for _ in range(_ROUNDS):
        problem = _Problem(views, tuple(free), free_tags, noise_px, repeat_rad)
        at, normal = _solve(problem, at)
        covariance, variances = normal.covariances()
        spread = np.sqrt(np.mean(at.off_rad[shown] ** 2 + variances[shown], axis=0))
        repeat_rad = np.maximum(spread, _LEAST_RAD)
        chi2 = float(np.median(np.square(normal.residual_px).sum(axis=1)))
        noise_px = max(math.sqrt(chi2 / (_MEDIAN_CHI2_OF_8 * left)), _LEAST_PX)
    off_rad = np.full_like(at.off_rad, np.nan)
    off_rad[shown] = at.off_rad[shown]
    covariance = covariance[: len(free), : len(free)]
    return HeadFit(
        model=at.model,
        T_world_tag=dict(zip(views.tags, at.T_world_tag, strict=True)),
        sigma=dict(zip(free, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        off_rad=off_rad,
        missed_px=normal.residual_px,
        views=views,
        noise_px=noise_px,
        repeat_rad=repeat_rad,
    )


def _solve(problem: _Problem, at: _Point) -> tuple[_Point, _Normal]:
    """Return the minimum and the normal equations there."""
    damping = 1e-3
    normal = problem.normal(at)
    for _ in range(_STEPS):
        trial = problem.stepped(at, *normal.damped(damping).step())
        gain = normal.cost - problem.cost(trial)
        if gain >= 0.0:
            at, damping = trial, max(0.1 * damping, 1e-12)
            normal = problem.normal(at)
        else:
            damping = min(10.0 * damping, 1e9)
        if abs(gain) <= _DONE_SHARE * normal.cost:
            break
    return at, normal


def off_model_rad(model: HeadModel, T_world_tag: Mapping[str, Array], views: HeadViews) -> Array:
    """Return (n, 2): by how much each shot's angles are off the model, which is held; NaN where it shows no tag."""
    tags = np.stack([T_world_tag[name] for name in views.tags])
    n = len(views.reported_rad)
    off = np.zeros((n, 2))
    shown = np.unique(views.shot)
    for _ in range(3):
        residual, by_link = missed_px(model, tags, views, off)
        J = np.stack([by_link[:, :, 1, 5], -by_link[:, :, 3, 4]], axis=2)
        for k in shown:
            own = views.shot == k
            off[k] -= np.linalg.lstsq(J[own].reshape(-1, 2), residual[own].ravel(), rcond=None)[0]
    found = np.full((n, 2), np.nan)
    found[shown] = off[shown]
    return found


def without(fitted: HeadFit, names: Sequence[str]) -> HeadViews:
    """Return the views of a fit without some tags."""
    kept = tuple(name for name in fitted.views.tags if name not in names)
    chosen = np.array([fitted.views.tags[k] in kept for k in fitted.views.tag], bool)
    views = fitted.views.only(chosen)
    return replace(views, tag=np.array([kept.index(fitted.views.tags[k]) for k in views.tag], int), tags=kept)
