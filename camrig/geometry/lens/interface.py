"""What every lens model offers; the models are frozen dataclasses, picklable and hashable by identity."""

from __future__ import annotations

from typing import Protocol

from camrig.geometry.arrays import Array


class Lens(Protocol):
    """Maps between directions in the camera's optical frame and pixels, vectorised over leading axes.

    *Ideal* coordinates are ``(a, b) = (X/Z, Y/Z)`` in the optical frame (x right, y down, z forward);
    *sensor* coordinates are the distorted ``(a, b)``, before focal length and centre; pixels are OpenCV's,
    the centre of the first pixel at (0, 0). Nothing beyond ``r_max`` counts as visible.
    """

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        ...

    @property
    def focal_px(self) -> tuple[float, float]:
        """``fx, fy``."""
        ...

    @property
    def centre_px(self) -> tuple[float, float]:
        """``cx, cy``."""
        ...

    @property
    def r_max(self) -> float:
        """Radius tan(beta) up to which the model holds: one-to-one, and calibrated where that is known."""
        ...

    def distort(self, ideal: Array) -> Array:
        """Map (..., 2) ideal to (..., 2) sensor coordinates."""
        ...

    def undistort(self, sensor: Array) -> Array:
        """Map (..., 2) sensor to (..., 2) ideal coordinates; NaN where no ideal point within ``r_max`` maps there."""
        ...

    def jacobian(self, ideal: Array) -> Array:
        """Return (..., 2, 2) ``d sensor / d ideal`` at (..., 2) ideal points, analytic."""
        ...

    def project(self, points_camera: Array) -> Array:
        """Map (..., 3) optical-frame points in metres to (..., 2) pixels; NaN behind the camera or past ``r_max``."""
        ...

    def unproject(self, pixels: Array) -> Array:
        """Map (..., 2) pixels to (..., 2) ideal coordinates; NaN where there are none."""
        ...
