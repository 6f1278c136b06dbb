"""Smooth random processes: white noise through three equal low-pass stages."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array

_STAGES = 3
_VARIANCE_GAIN = 3.0 / 16.0  # of h(t) = t^2 e^(-t/tau) / (2 tau^3): the integral of h^2 is 3 / (16 tau)


class ColouredNoise:
    """Channels of stationary noise with a value, a rate and an acceleration that belong together.

    ``sigma`` (n,) is each channel's standard deviation, ``tau_s`` (n,) the time constant of each stage; rate and
    acceleration have sigmas of sigma / (sqrt(3) tau) and sigma / tau^2.
    """

    def __init__(self, sigma: Array, tau_s: Array, rng: np.random.Generator) -> None:
        self._tau_s = tau_s
        self._intensity = sigma / np.sqrt(_VARIANCE_GAIN / tau_s)
        self._rng = rng
        self._stages = np.zeros((_STAGES, sigma.size))
        settle_s = float(np.min(tau_s)) / 10.0
        for _ in range(math.ceil(10.0 * float(np.max(tau_s)) / settle_s)):
            self.advance(settle_s)

    def advance(self, dt_s: float) -> None:
        """Move on by ``dt_s``, which must be small against the time constants."""
        white = self._intensity * self._rng.standard_normal(self._tau_s.size) / math.sqrt(dt_s)
        inputs = np.vstack([white, self._stages[:-1]])
        self._stages = self._stages + (inputs - self._stages) * (dt_s / self._tau_s)

    @property
    def value(self) -> Array:
        """(n,)."""
        return np.asarray(self._stages[2])

    @property
    def rate(self) -> Array:
        """(n,) per second."""
        return np.asarray((self._stages[1] - self._stages[2]) / self._tau_s)

    @property
    def acceleration(self) -> Array:
        """(n,) per second squared."""
        return np.asarray((self._stages[0] - 2.0 * self._stages[1] + self._stages[2]) / self._tau_s**2)
