"""Draws what a camera truly sees, with OpenCV's projection: area sampling, motion blur, point spread, noise.

Only rectangles round tags and bodies are sampled finely; the floor is smooth and drawn coarsely. The order of things
is that of a camera: the shutter integrates over pixels and time, the lens smears, the sensor adds noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.rig import TagKey
from camrig_emulators.backdrop import Backdrop
from camrig_emulators.lens_rays import LensRays
from camrig_emulators.scenery import Thing
from camrig_emulators.sprites import Rect, Sprite, paint, sprites

_HALO_PX = 3
_STEP_PX = 0.5
_MAX_EXPOSURES = 12
_NOISE_SPARE_PX = 256


@dataclass(frozen=True, slots=True)
class Sensor:
    """What the sensor and the optics do to a picture: exposure, sigma of the noise, sigma of the point spread."""

    exposure_s: float = 0.004
    noise_grey: float = 3.5
    psf_px: float = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One instant: where the camera is, and the things before it in painting order."""

    T_world_camera: Transform
    things: Sequence[Thing]


class Renderer:
    """Draws for one camera. Not for two threads at a time."""

    def __init__(self, rays: LensRays, backdrop: Backdrop, sensor: Sensor, seed: int) -> None:
        self._rays = rays
        self._backdrop = backdrop
        self._sensor = sensor
        self._seed = seed
        self._noise = _noise_tiles(rays.size_px, sensor.noise_grey, seed)

    def render(self, shot_at: Callable[[float], Shot], stamp_s: float, sequence: int) -> GreyImage:
        """Draw the (height, width) picture whose exposure has its middle at ``stamp_s``.

        ``shot_at`` is asked for stamps within the exposure. The same arguments give the same picture.
        """
        half_s = self._sensor.exposure_s / 2.0
        middle = shot_at(stamp_s)
        moved_px = self._moved_px(middle, shot_at(stamp_s - half_s), shot_at(stamp_s + half_s))
        count = int(np.clip(np.ceil(moved_px / _STEP_PX), 1, _MAX_EXPOSURES))
        offsets = ((np.arange(count) + 0.5) / count - 0.5) * self._sensor.exposure_s
        shots = [middle] if count == 1 else [shot_at(stamp_s + float(offset)) for offset in offsets]
        picture = self._backdrop.draw(middle.T_world_camera)
        self._expose(picture, [sprites(shot.things, shot.T_world_camera, self._rays) for shot in shots])
        if self._rays.dark is not None:
            picture[self._rays.dark] = 0
        return self._with_noise(picture, sequence)

    def _moved_px(self, middle: Shot, first: Shot, last: Shot) -> float:
        """Return how far the fastest plate moves across the picture during the exposure."""
        tracks = [self._plate_pixels(shot) for shot in (first, middle, last)]
        moved = [
            2.0 * float(np.linalg.norm(end[key] - tracks[1][key]))
            for end in (tracks[0], tracks[2])
            for key in tracks[1].keys() & end.keys()
        ]
        return max(moved, default=0.0)

    def _plate_pixels(self, shot: Shot) -> dict[TagKey, Array]:
        """Return the centre (2,) of every plate that is before the lens."""
        plates = [plate for thing in shot.things for plate in thing.plates]
        centres = np.array([plate.T_world_tag[:3, 3] for plate in plates]).reshape(-1, 3)
        T = shot.T_world_camera
        pixels = self._rays.project((centres - T[:3, 3]) @ T[:3, :3])
        return {plate.key: at for plate, at in zip(plates, pixels, strict=True) if np.isfinite(at[0])}

    def _expose(self, picture: GreyImage, exposures: Sequence[Sequence[Sprite]]) -> None:
        """Paint the sprites of all sub-exposures over the picture, averaged, and smear them."""
        rects = _merged([sprite.rect for exposure in exposures for sprite in exposure])
        supersampling = 3 if len(exposures) <= 2 else 2
        for rect in rects:
            x0, y0, x1, y1 = rect
            picture[y0:y1, x0:x1] = self._average(picture[y0:y1, x0:x1], rect, exposures, supersampling)
        if self._sensor.psf_px > 0.0:
            sharp = picture.copy()
            for rect in rects:
                _smear(sharp, picture, rect, self._sensor.psf_px)

    def _average(
        self, ground: GreyImage, rect: Rect, exposures: Sequence[Sequence[Sprite]], supersampling: int
    ) -> GreyImage:
        size = (rect[2] - rect[0], rect[3] - rect[1])
        finer = cv2.resize(ground, None, fx=supersampling, fy=supersampling, interpolation=cv2.INTER_LINEAR)
        fine = np.asarray(finer, dtype=np.uint8)
        total = np.zeros(ground.shape, dtype=np.float32)
        for exposure in exposures:
            painted = fine.copy()
            for sprite in exposure:
                paint(painted, rect, sprite, self._rays, supersampling)
            cv2.accumulate(cv2.resize(painted, size, interpolation=cv2.INTER_AREA), total)
        return np.asarray(np.rint(total / len(exposures)), dtype=np.uint8)

    def _with_noise(self, picture: GreyImage, sequence: int) -> GreyImage:
        if self._noise is None:
            return picture
        rng = np.random.default_rng([self._seed, sequence])
        x, y = (int(value) for value in rng.integers(0, _NOISE_SPARE_PX, 2))
        height, width = picture.shape
        brighter, darker = (tile[y : y + height, x : x + width] for tile in self._noise)
        return np.asarray(cv2.subtract(cv2.add(picture, brighter), darker), dtype=np.uint8)


def _noise_tiles(size_px: tuple[int, int], sigma_grey: float, seed: int) -> tuple[GreyImage, GreyImage] | None:
    """Return what white noise adds and what it takes, on an area larger than the picture to cut pieces from."""
    if sigma_grey <= 0.0:
        return None
    shape = (size_px[1] + _NOISE_SPARE_PX, size_px[0] + _NOISE_SPARE_PX)
    noise = np.rint(np.random.default_rng(seed).normal(0.0, sigma_grey, shape))
    return np.clip(noise, 0, 255).astype(np.uint8), np.clip(-noise, 0, 255).astype(np.uint8)


def _smear(sharp: GreyImage, picture: GreyImage, rect: Rect, sigma_px: float) -> None:
    """Blur a rectangle of the picture by the point spread, taking in what lies around it."""
    height, width = sharp.shape
    x0, y0, x1, y1 = rect
    left, top = max(0, x0 - _HALO_PX), max(0, y0 - _HALO_PX)
    around = sharp[top : min(height, y1 + _HALO_PX), left : min(width, x1 + _HALO_PX)]
    blurred = cv2.GaussianBlur(around, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    picture[y0:y1, x0:x1] = blurred[y0 - top : y1 - top, x0 - left : x1 - left]


def _merged(rects: Sequence[Rect]) -> list[Rect]:
    """Join rectangles that overlap until none do."""
    merged: list[Rect] = []
    for rect in rects:
        joined = rect
        while (other := next((known for known in merged if _touch(joined, known)), None)) is not None:
            merged.remove(other)
            joined = (
                min(joined[0], other[0]),
                min(joined[1], other[1]),
                max(joined[2], other[2]),
                max(joined[3], other[3]),
            )
        merged.append(joined)
    return merged


def _touch(a: Rect, b: Rect) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
