"""The zoom and focus of an emulated head: they take time, count in their own range, and share contested opcodes."""

from __future__ import annotations

from camrig_emulators.pelco_d_motion import AxisMotion
from camrig_emulators.pelco_d_settings import PelcoDHeadSettings

_RAMPS = 8.0
"""A zoom reaches its speed in an eighth of its whole way's time."""


class Optics:
    """Positions are raw; magnification grows geometrically from 1 to the greatest over the zoom's range."""

    def __init__(self, settings: PelcoDHeadSettings) -> None:
        self._settings = settings
        speed = settings.zoom_limit / settings.zoom_s
        self._zoom = AxisMotion(
            0.0, limits=(0.0, float(settings.zoom_limit)), speed=speed, acceleration=_RAMPS * speed / settings.zoom_s
        )
        self._speed = speed
        self._focus = 0

    def zoom(self, stamp_s: float) -> int:
        """Return the zoom's position."""
        return round(self._zoom.motor(stamp_s))

    def zoom_share(self, stamp_s: float) -> float:
        """Return how much of its range the zoom is in."""
        return self._zoom.motor(stamp_s) / self._settings.zoom_limit

    def zoom_to(self, raw: int, at_s: float) -> None:
        """Begin to zoom to a position."""
        self._zoom.go_to(float(min(raw, self._settings.zoom_limit)), at_s)

    def jog(self, direction: int, at_s: float) -> None:
        """Zoom in (+1), out (-1), or stay (0) until the next command."""
        self._zoom.jog(direction * self._speed, at_s)

    def set_5f(self, value: int, at_s: float) -> None:
        """Obey opcode 5F: magnification in hundredths, or a focus position."""
        if self._settings.opcode_5f == "focus":
            self._focus = value
            return
        greatest, wanted = self._settings.greatest_magnification, max(1.0, value / 100.0)
        low, high = 0.0, float(self._settings.zoom_limit)
        for _ in range(40):  # the curve is monotone
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._magnification(middle, greatest) < wanted else (low, middle)
        self.zoom_to(round(low), at_s)

    def get_61(self, stamp_s: float) -> int:
        """Answer opcode 61."""
        if self._settings.opcode_5f == "focus":
            return self._focus
        return round(100.0 * self._magnification(self._zoom.motor(stamp_s), self._settings.greatest_magnification))

    def _magnification(self, zoom: float, greatest: float) -> float:
        return float(greatest ** (zoom / self._settings.zoom_limit))
