"""The emulated drone's battery."""

from __future__ import annotations

_ENDURANCE_S = 1200.0
_FULL_V, _EMPTY_V = 16.8, 14.0


class Battery:
    """Empties steadily from ``charge`` (0 to 1) on."""

    def __init__(self, charge: float, start_s: float) -> None:
        self._charge = charge
        self._since_s = start_s

    def set(self, charge: float, now_s: float) -> None:
        """Make it so full, 0 to 1."""
        self._charge, self._since_s = charge, now_s

    def charge(self, now_s: float) -> float:
        """Return what is left, 0 to 1."""
        return max(0.0, self._charge - (now_s - self._since_s) / _ENDURANCE_S)

    def voltage_V(self, now_s: float) -> float:
        """Return the voltage of its four cells together."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.charge(now_s)
