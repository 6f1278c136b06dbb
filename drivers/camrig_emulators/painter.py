"""``camrig.painters: emulated``: pictures of a rig one by one, off-line, as ``camrig experiment`` takes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import Lens
from camrig.interfaces import Instant, Painter, Plugin
from camrig.rig import Rig
from camrig_emulators.backdrop import Backdrop
from camrig_emulators.lens_rays import LensRays, lens_rays
from camrig_emulators.renderer import Renderer, Sensor, Shot
from camrig_emulators.scenery import Scenery
from camrig_emulators.sprites import painting_order

_LENSES_KEPT = 16
"""A table of rays takes 9 MB and a third of a second for a megapixel."""


class PainterSection(BaseModel):
    """What sensor and optics do to a picture."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    exposure_s: Annotated[float, Field(gt=0.0, le=0.1)] = 0.002
    noise_grey: Annotated[float, Field(ge=0.0, le=50.0)] = 4.0
    psf_px: Annotated[float, Field(ge=0.0, le=5.0)] = 0.7


class EmulatedPainter:
    """A ``Painter`` on the renderer of the emulated world."""

    def __init__(self, section: PainterSection) -> None:
        self._sensor = Sensor(section.exposure_s, section.noise_grey, section.psf_px)
        self._rays: dict[str, LensRays] = {}
        self._scenery: tuple[Rig, Scenery] | None = None

    def paint(self, rig: Rig, lens: Lens, instant_at: Callable[[float], Instant], seed: int) -> GreyImage:
        if self._scenery is None or self._scenery[0] is not rig:
            self._scenery = rig, Scenery(rig, {})
        scenery, rays = self._scenery[1], self._rays_of(lens)

        def shot_at(stamp_s: float) -> Shot:
            T_world_camera, places = instant_at(stamp_s)
            robots = scenery.posed(places)
            order = painting_order(scenery.anchors, robots, scenery.boxes, scenery.box_limits_m, T_world_camera[:3, 3])
            return Shot(T_world_camera, order)

        return Renderer(rays, Backdrop(rays), self._sensor, seed).render(shot_at, 0.0, 0)

    def _rays_of(self, lens: Lens) -> LensRays:
        key = repr(lens)  # a lens is a frozen dataclass: its repr is all it is
        if key not in self._rays:
            if len(self._rays) >= _LENSES_KEPT:
                del self._rays[next(iter(self._rays))]
            self._rays[key] = lens_rays(lens)
        return self._rays[key]


def _make(section: PainterSection) -> Painter:
    return EmulatedPainter(section)


painter: Plugin[Painter] = Plugin(PainterSection, _make)
