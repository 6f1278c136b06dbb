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

    def mixed(self, becomes: Array) -> Modes:
        """Return them where mode i ``becomes`` (n, n) mode j with that probability: what each then begins with."""
        if len(self.weights) == 1:
            return self
        joint = self.weights[:, None] * becomes
        weights = joint.sum(axis=0)
        second = (joint[1] / weights)[:, None]
        off, apart = self.means[1] - self.means[0], self.sensitivities[1] - self.sensitivities[0]
        between = np.outer(off, off) + apart @ apart.T
        second3 = second[..., None]
        whites = self.whites[0] + second3 * (self.whites[1] - self.whites[0] + (1.0 - second3) * between)
        return Modes(weights, self.means[0] + second * off, whites, self.sensitivities[0] + second3 * apart)

    def moved(self, F: Array, Q: Array) -> Modes:
        """Return them after a transition (6, 6), with the noise (n, 6, 6) of each."""
        return Modes(self.weights, self.means @ F.T, F @ self.whites @ F.T + Q, F @ self.sensitivities)

    def knowing(self, columns: int) -> Modes:
        """Return them with so many columns of sensitivity, 0 where they were none."""
        n, rows, known = self.sensitivities.shape
        grown = np.zeros((n, rows, columns))
        grown[..., :known] = self.sensitivities
        return Modes(self.weights, self.means, self.whites, grown)

    def taken(self, place_m: Array, C: Array, factors: Array, doubt: Array) -> Modes:
        """Return them after a measured place (3,) of white covariance C and ``factors`` (3, m), by gains of least
        variance that reckon with ``doubt`` (3, 3) besides.
        """
        D = factors - self.sensitivities[:, :3]
        transposed = D.swapaxes(1, 2)
        across = self.whites[:, :, :3] - self.sensitivities @ transposed
        spread = self.whites[:, :3, :3] + D @ transposed + (C + doubt)
        innovation = (place_m - self.means[:, :3])[..., None]
        solved = np.linalg.solve(spread, np.concatenate([across.swapaxes(1, 2), innovation], axis=2))
        worth = self.weights
        if len(worth) > 1:
            squared = (innovation * solved[..., 6:]).sum(axis=(1, 2))
            worth = worth * np.exp(0.5 * (squared.min() - squared)) / np.sqrt(np.linalg.det(spread))
            worth = np.maximum(worth / worth.sum(), _LEAST)
        return self._by(solved[..., :6].swapaxes(1, 2), innovation, C, D, worth / worth.sum())

    def taken_by(self, K: Array, place_m: Array, C: Array, factors: Array) -> Modes:
        """Return them after it by one gain (6, 3), whatever that is, which tells nothing of which mode is right."""
        D = factors - self.sensitivities[:, :3]
        gains = np.broadcast_to(K, (len(self.weights), 6, 3))
        return self._by(gains, (place_m - self.means[:, :3])[..., None], C, D, self.weights)

    def _by(self, K: Array, innovation: Array, C: Array, D: Array, weights: Array) -> Modes:
        A = np.tile(np.eye(6), (len(K), 1, 1))
        A[:, :, :3] -= K
        means = self.means + (K @ innovation)[..., 0]
        whites = A @ self.whites @ A.swapaxes(1, 2) + K @ C @ K.swapaxes(1, 2)
        return Modes(weights, means, whites, self.sensitivities + K @ D)
