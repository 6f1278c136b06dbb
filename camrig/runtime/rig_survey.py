"""A rig's own cameras look round for ``camrig calibrate extrinsics --live``: fixed ones once, heads from stop to stop.

One head moves at a time, within its limits, goes back to where it was, and is stopped and closed however that ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from camrig.calibrate.head_aims import Stop
from camrig.calibrate.sighted import Shot
from camrig.clock import Clock
from camrig.config.rig_file import RigConfig
from camrig.errors import HardwareError, InputError, PartialError
from camrig.geometry.arrays import Array
from camrig.geometry.corner_noise import tag_width_px
from camrig.interfaces import Head
from camrig.locate.tags import CELL, MIN_WIDTH_PX
from camrig.messages import TagDetections
from camrig.rig import FixedMount, HeadMount
from camrig.runtime.build import make_devices
from camrig.runtime.enabled_head import enabled
from camrig.runtime.head_bench import Eye, HeadBench, Interrupted
from camrig.runtime.head_calibration import camera_eye

_PICTURES = 3
_DARK_S = 5.0
_PAUSE_S = 0.05

Tell = Callable[[str], None]


class _All:
    """A container of all names."""

    def __contains__(self, name: object) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class RigSurvey:
    """What is looked through, and where each head is sent; ``tell`` is told of every stop."""

    config: RigConfig
    clock: Clock
    stops: Mapping[str, Sequence[tuple[float, float]]]
    asked_to_end: Callable[[], bool]
    tell: Tell

    def shots(self) -> tuple[list[Shot], list[str]]:
        """Look; return what was seen, and a sentence for each camera or head that failed. Raises Interrupted."""
        found: list[Shot] = []
        faults: list[str] = []
        heads: Mapping[str, Head] = make_devices(self.config, "heads")
        for name, camera in self.config.rig.cameras.items():
            try:
                match camera.mount:
                    case FixedMount():
                        found.append(self._fixed(name))
                    case HeadMount(head=head):
                        for shot in self._on_head(name, head, heads[head], 1 + len(found)):
                            found.append(shot)  # noqa: PERF402 - those before a fault count
                    case _:
                        continue
            except (HardwareError, InputError, PartialError) as error:
                faults.append(f"{name}: {error}")
        return found, faults

    def _fixed(self, name: str) -> Shot:
        """Look through a camera that rests."""
        self.tell(name)
        with camera_eye(self.config, name, self.clock) as eye:
            for frame in self._whole(eye, name):
                return Shot(name, 0, self._inside(name, {str(tag.key): tag.corners_px for tag in frame.tags}))
        raise HardwareError(f"camera {name} has sent no picture for {_DARK_S:g} s")

    def _on_head(self, name: str, head_id: str, head: Head, first: int) -> Iterator[Shot]:
        """Look through a camera from stop to stop of its head."""
        with camera_eye(self.config, name, self.clock) as eye, enabled(head_id, head):
            bench = HeadBench(
                head_id, head, eye, self.clock, _All(), self.asked_to_end, reports_optics=True, narrower="in the file"
            )
            bench.begin()
            home = bench.reported_rad
            for number, stop in enumerate(self.stops[head_id]):
                self.tell(f"{name}, {number + 1} of {len(self.stops[head_id])}")
                for seen in bench.visit([Stop(*stop)]):
                    pan, tilt = map(float, seen.reported_rad)
                    yield Shot(name, first + number, self._inside(name, seen.corners_px), aim_rad=(pan, tilt))
            bench.go(*home)

    def _whole(self, eye: Eye, name: str) -> Iterator[TagDetections]:
        until_s, left = self.clock.now_s() + _DARK_S, _PICTURES
        while self.clock.now_s() < until_s:
            if self.asked_to_end():
                raise Interrupted
            for frame in eye.take():
                left -= frame.whole
                if frame.whole and left <= 0:
                    yield frame
            self.clock.sleep_s(_PAUSE_S)

    def _inside(self, name: str, corners_px: Mapping[str, Array]) -> dict[str, Array]:
        """Return the tags that the picture's edge does not cut, and that are large enough to be real."""
        size_px = self.config.rig.cameras[name].lens.size_px
        return {tag: px for tag, px in corners_px.items() if _is_inside(px, size_px)}


def _is_inside(corners_px: Array, size_px: tuple[int, int]) -> bool:
    width_px = float(tag_width_px(corners_px))
    rim_px = CELL * width_px
    inside = (corners_px > rim_px).all() and (corners_px < [size - 1.0 - rim_px for size in size_px]).all()
    return bool(inside) and width_px >= MIN_WIDTH_PX
