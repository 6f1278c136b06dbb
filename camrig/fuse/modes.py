"""Where a target is and how fast, once for each way of moving: calmly, and swerving; by how probable each is.

Interacting multiple models: every mode has a Kalman filter of its own, begun anew at every prediction with the mixture
of all that may have become it since, and is worth what it foretells. Source: Blom and Bar-Shalom, "The interacting
multiple model algorithm for systems with Markovian switching coefficients" (1988). Covariances are in two parts, as
fuse.kalman has them; ``n`` is 1 where a motion knows no swerves, else 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array

_LEAST = 1e-6
"""No mode is less probable than this: the one that is right now must be found again."""

WRONG, WRONG_SIGMA_M = 0.05, 0.05
"""So many fixes that only a swerve explains are wrong, by so much: a tag half hidden, a flipped pose. They are not
quite believed before a second agrees.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """``weights`` (n,) are probabilities; ``means`` (n, 6) are [position, velocity], ``whites`` (n, 6, 6) and
    ``sensitivities`` (n, 6, m), a column for each number that stays the same, the parts of their covariances.
    """

    weights: Array
    means: Array
    whites: Array
    sensitivities: Array

    @property
    def mean(self) -> Array:
        """The mean (6,) of all."""
        return np.asarray(self.weights @ self.means)

    @property
    def swerving(self) -> float:
        """How probably it swerves."""
        return float(self.weights[1:].sum())

    @property
    def covariances(self) -> Array:
        """The whole covariance (n, 6, 6) of each."""
        return np.asarray(self.whites + self.sensitivities @ self.sensitivities.swapaxes(1, 2))

    @property
    def covariance(self) -> Array:
        """The whole covariance (6, 6) of all, what their means differ by included."""
        off = (self.means - self.mean) * np.sqrt(self.weights)[:, None]
        return np.asarray((self.weights[:, None, None] * self.covariances).sum(axis=0) + off.T @ off)

    def carried_on(self, F: Array, Q: Array, becomes: Array) -> Modes:
        """Return them after a transition (6, 6) with the noise (n, 6, 6) of each, before which mode i has become mode j
        with the probability ``becomes`` (n, n).
        """
        mixed = self
        if len(self.weights) > 1:
            joint = self.weights[:, None] * becomes
            weights = joint.sum(axis=0)
            mixed = self._only(0)._or(self._only(1), joint[1] / weights, weights)
        return Modes(mixed.weights, mixed.means @ F.T, F @ mixed.whites @ F.T + Q, F @ mixed.sensitivities)

    def _only(self, k: int) -> Modes:
        own = slice(k, k + 1)
        return Modes(self.weights[own], self.means[own], self.whites[own], self.sensitivities[own])

    def knowing(self, columns: int) -> Modes:
        """Return them with so many columns of sensitivity, 0 where they were none."""
        n, rows, known = self.sensitivities.shape
        grown = np.zeros((n, rows, columns))
        grown[..., :known] = self.sensitivities
        return Modes(self.weights, self.means, self.whites, grown)

    def taken(self, place_m: Array, C: Array, factors: Array, doubt: Array, *, suspect: bool = False) -> Modes:
        """Return them after a measured place (3,) of white covariance C and ``factors`` (3, m), by gains of least
        variance that reckon with ``doubt`` (3, 3) besides and, if it is ``suspect``, with a place that is wrong.
        """
        D = factors - self.sensitivities[:, :3]
        transposed = D.swapaxes(1, 2)
        across = self.whites[:, :, :3] - self.sensitivities @ transposed
        spread = self.whites[:, :3, :3] + D @ transposed + (C + doubt)
        innovation = (place_m - self.means[:, :3])[..., None]
        solved = np.linalg.solve(spread, np.concatenate([across.swapaxes(1, 2), innovation], axis=2))
        worth = _likelihood((innovation * solved[..., 6:]).sum(axis=(1, 2)), spread)
        wrong = np.zeros_like(worth)
        if suspect:
            astray = spread + WRONG_SIGMA_M**2 * np.eye(3)
            wrong = _likelihood((innovation * np.linalg.solve(astray, innovation)).sum(axis=(1, 2)), astray)
            worth, wrong = (1.0 - WRONG) * worth + WRONG * wrong, WRONG * wrong
        weights = self.weights * worth
        weights = np.maximum(weights / weights.sum(), _LEAST)
        updated = self._by(solved[..., :6].swapaxes(1, 2), innovation, C, D, weights / weights.sum())
        return updated._or(self, wrong / worth, updated.weights) if suspect else updated

    def taken_by(self, K: Array, place_m: Array, C: Array, factors: Array) -> Modes:
        """Return them after it by one gain (6, 3), whatever that is; which mode is right is not asked."""
        D = factors - self.sensitivities[:, :3]
        gains = np.broadcast_to(K, (len(self.weights), 6, 3))
        return self._by(gains, (place_m - self.means[:, :3])[..., None], C, D, self.weights)

    def _by(self, K: Array, innovation: Array, C: Array, D: Array, weights: Array) -> Modes:
        A = np.tile(np.eye(6), (len(K), 1, 1))
        A[:, :, :3] -= K
        means = self.means + (K @ innovation)[..., 0]
        whites = A @ self.whites @ A.swapaxes(1, 2) + K @ C @ K.swapaxes(1, 2)
        return Modes(weights, means, whites, self.sensitivities + K @ D)

    def _or(self, other: Modes, share: Array, weights: Array) -> Modes:
        """Return modes of these weights (n,), each the mixture of what is here with its ``share`` (n,) of others."""
        one, two = share[:, None], share[:, None, None]
        off, apart = (other.means - self.means)[..., None], other.sensitivities - self.sensitivities
        between = off @ off.swapaxes(1, 2) + apart @ apart.swapaxes(1, 2)
        whites = self.whites + two * (other.whites - self.whites + (1.0 - two) * between)
        return Modes(weights, self.means + one * off[..., 0], whites, self.sensitivities + two * apart)


def _likelihood(chi2: Array, spread: Array) -> Array:
    """Return the normal density (n,) of innovations, but for a constant; never quite none."""
    return np.asarray(np.exp(-0.5 * np.minimum(chi2, 1000.0)) / np.sqrt(np.linalg.det(spread)))
