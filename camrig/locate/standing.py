"""What stays wrong with the rig's cameras, learnt from frame after frame: where their mounts are, and their lenses.

One Gaussian over all cameras, for a body that two cameras see joins their errors. By camera [dx dy dz rx ry rz] of its
pose against what carries it (geometry.pose, world axes), then its lens's four (geometry.lens.errors). Each is the same
in every frame, so what is known of it beforehand enters once; once a carrier has moved, the error of its angles is new.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.bundle_kernel import CAMERA
from camrig.geometry.pose import PosePriors, difference
from camrig.rig import DroneMount, FixedMount, FreeMount, HeadMount, Rig

MEMORY_S = 1800.0
"""What is known of a lens beyond its calibration fades in about half an hour: lenses drift with their temperature."""

MOVED_M, MOVED_RAD = 0.002, 0.001
"""A carrier that is elsewhere by more has moved."""

VAGUE_VARIANCE: Array = np.square([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
"""Of a pose of which nothing is known, in m2 and rad2."""

CHANCE = 1e-6
"""News that chance brings more rarely than this contradicts what was learnt: something was knocked."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Mean (10 c,) and covariance (10 c, 10 c) of the rig's cameras in their order, at ``stamp_s``.

    ``carried`` is where each carrier had its camera when the error of its pose began.
    """

    mean: Array
    covariance: Array
    stamp_s: float
    carried: Mapping[str, Transform] = field(default_factory=dict)

    def lens(self, k: int) -> tuple[Array, Array]:
        """Return mean (4,) and covariance (4, 4) of what is wrong with a camera's lens."""
        own = slice(CAMERA * k + 6, CAMERA * (k + 1))
        return self.mean[own], self.covariance[own, own]

    def pose(self, rig: Rig, name: str, T_carried: Transform) -> tuple[Array, Array] | None:
        """Return mean (6,) and covariance (6, 6) of what is wrong with the pose that a carrier has for its camera; None
        where nothing was learnt since it moved.
        """
        if name not in self.carried or _has_moved(self.carried[name], T_carried):
            return None
        first = CAMERA * list(rig.cameras).index(name)
        own = slice(first, first + 6)
        return self.mean[own], self.covariance[own, own]


def begun(rig: Rig, stamp_s: float) -> Standing:
    """Return what calibrations say, and nothing of poses."""
    sigmas = [np.concatenate([VAGUE_VARIANCE, np.square(camera.lens_sigma)]) for camera in rig.cameras.values()]
    variance = np.concatenate(sigmas)
    return Standing(np.zeros(len(variance)), np.diag(variance), stamp_s)


def aged(standing: Standing, rig: Rig, stamp_s: float) -> Standing:
    """Let lenses forget: an Ornstein-Uhlenbeck process about their calibration."""
    keep, variance = np.ones(len(standing.mean)), np.zeros(len(standing.mean))
    for k, camera in enumerate(rig.cameras.values()):
        own = slice(CAMERA * k + 6, CAMERA * (k + 1))
        keep[own], variance[own] = math.exp(-(stamp_s - standing.stamp_s) / MEMORY_S), np.square(camera.lens_sigma)
    covariance = standing.covariance * np.outer(keep, keep) + np.diag((1.0 - keep**2) * variance)
    return replace(standing, mean=keep * standing.mean, covariance=covariance, stamp_s=stamp_s)


def carried_on(standing: Standing, rig: Rig, names: Sequence[str], carriers: PosePriors) -> Standing:
    """Take in where carriers have these cameras now: pose errors that begin, and those that a movement renews."""
    order, carried = list(rig.cameras), dict(standing.carried)
    for name, T, information in zip(names, carriers.T, carriers.information, strict=True):
        first = CAMERA * order.index(name)
        before = carried.get(name)
        if before is None and information.any():
            standing = _renewed(standing, slice(first, first + 6), np.linalg.inv(information))
        elif before is None or _has_moved(before, T):
            renewed = slice(first + _stays(rig, name), first + 6)
            standing = _renewed(standing, renewed, np.diag(VAGUE_VARIANCE[renewed.start - first :]))
        else:
            continue
        carried[name] = T
    return replace(standing, carried=carried)


def _has_moved(before: Transform, now: Transform) -> bool:
    apart = difference(now, before)
    return float(np.linalg.norm(apart[:3])) > MOVED_M or float(np.linalg.norm(apart[3:])) > MOVED_RAD


def _stays(rig: Rig, name: str) -> int:
    """Return how many of a pose's six errors stay when the carrier moves: of a head those of its place."""
    match rig.cameras[name].mount:
        case HeadMount() | FixedMount():
            return 3
        case DroneMount() | FreeMount():
            return 0


def _renewed(standing: Standing, own: slice, covariance: Array) -> Standing:
    mean, whole = standing.mean.copy(), standing.covariance.copy()
    mean[own] = 0.0
    whole[own], whole[:, own] = 0.0, 0.0
    whole[own, own] = covariance
    return replace(standing, mean=mean, covariance=whole)


def told(standing: Standing, rig: Rig, names: Sequence[str], information: Array, vector: Array) -> Standing:
    """Add the evidence on these cameras: information (10 c, 10 c) and, times the most probable errors, vector (10 c,).

    Where it contradicts what was learnt, poses are taken for renewed: a knock must not bend lenses.
    """
    order = list(rig.cameras)
    at = np.concatenate([CAMERA * order.index(name) + np.arange(CAMERA) for name in names])
    after, surprise = _added(standing, at, information, vector)
    if surprise <= chdtri(len(at), CHANCE):
        return after
    for name in names:
        first = CAMERA * order.index(name)
        standing = _renewed(standing, slice(first, first + 6), np.diag(VAGUE_VARIANCE))
    return _added(standing, at, information, vector)[0]


def _added(standing: Standing, at: npt.NDArray[np.int64], information: Array, vector: Array) -> tuple[Standing, float]:
    """Return it with the evidence, and by how much (squared Mahalanobis distance) the mean has moved for it."""
    known = np.linalg.inv(standing.covariance)
    whole, says = known.copy(), known @ standing.mean
    whole[np.ix_(at, at)] += information
    says[at] += vector
    covariance = np.linalg.inv(whole)
    mean = covariance @ says
    step = mean - standing.mean
    covariance = 0.5 * (covariance + covariance.T)
    return replace(standing, mean=mean, covariance=covariance), float(step @ known @ step)
