"""Pictures from disk, delivered in real time as a camera would."""

from __future__ import annotations

import logging
import threading
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path

from camrig import pictures
from camrig.clock import Clock, RealClock
from camrig.errors import EndOfInput, HardwareError, InputError
from camrig.geometry.arrays import GreyImage
from camrig.interfaces import Camera
from camrig.messages import Frame
from camrig.rig import CameraSpec
from camrig_drivers.images.section import ImagesSection
from camrig_drivers.images.timeline import DEFAULT_FPS, Timeline, at_rate, from_file

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class _Due:
    """A picture of the right size, and when it is due after ``open``."""

    sequence: int
    offset_s: float
    image: GreyImage
    source: str


class ImagesCamera:
    """A ``Camera`` of files. Unlike a live one it drops nothing: a slow reader gets every picture, late.

    Picture k is stamped ``open`` time + its offset and delivered no earlier. A file that cannot be read, or is of
    another size than the lens, is logged, named in ``skipped`` and leaves a gap in time and sequence numbers.
    """

    def __init__(self, spec: CameraSpec, section: ImagesSection, clock: Clock) -> None:
        self.skipped: list[str] = []
        self._spec = spec
        self._section = section
        self._clock = clock
        self._woken = threading.Event()
        self._start_s = 0.0
        self._frames: Generator[_Due] | None = None
        self._next: _Due | None = None

    def open(self) -> None:
        """Find the files and decode the first; raises InputError where there is nothing to read, or the stamps do
        not fit, and HardwareError where no picture is of the lens's size.
        """
        self.close()
        self.skipped.clear()
        paths = pictures.find(self._section.path)
        self._frames = self._read(paths, _timeline(self._section, paths))
        self._next = next(self._frames, None)
        if self._next is None:
            raise HardwareError(
                f"camera {self._spec.id}: none of the pictures in {self._section.path} can be used; {self.skipped[0]}"
            )
        self._start_s = self._clock.now_s()

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next picture once it is due; see ``camrig.interfaces.Camera``."""
        deadline_s = self._clock.now_s() + timeout_s
        if self._next is None and self._frames is not None:
            self._next = next(self._frames, None)
        due = self._next
        if due is None:
            raise EndOfInput(f"camera {self._spec.id}: {self._section.path} has been read to its end")
        stamp_s = self._start_s + due.offset_s
        if not self._wait_until(stamp_s, deadline_s):
            return None
        self._next = None
        return Frame(self._spec.id, due.image, stamp_s, due.sequence, source=due.source)

    def wake(self) -> None:
        """Make ``read``, now or the next, return None."""
        self._woken.set()

    def close(self) -> None:
        """Let go of the files."""
        if self._frames is not None:
            self._frames.close()
        self._frames = None
        self._next = None

    def _wait_until(self, stamp_s: float, deadline_s: float) -> bool:
        """Wait for a stamp; False on time-out or ``wake``."""
        while True:
            if self._woken.is_set():
                self._woken.clear()
                return False
            now_s = self._clock.now_s()
            if now_s >= stamp_s:
                return True
            if now_s >= deadline_s:
                return False
            self._woken.wait(min(stamp_s, deadline_s) - now_s)

    def _read(self, paths: tuple[Path, ...], timeline: Timeline) -> Generator[_Due]:
        """Give every usable picture, again and again where the section says ``loop``."""
        sequence, begin_s = 0, 0.0
        while True:
            usable, end_s = 0, 0.0
            for index, picture in enumerate(pictures.read(paths)):
                offset_s = timeline.offset_s(index)
                if offset_s is None:
                    self._skip(f"{picture.path} goes on after its {index} stamps; the rest is left out")
                    break
                image = self._usable(picture)
                if image is not None:
                    usable += 1
                    yield _Due(sequence, begin_s + offset_s, image, str(picture.path))
                sequence += 1
                end_s = offset_s + timeline.step_s
            if not (self._section.loop and usable):
                return
            begin_s += end_s

    def _usable(self, picture: pictures.Picture) -> GreyImage | None:
        image = picture.image
        if image is None:
            self._skip(f"{picture.path} {picture.fault}")
            return None
        size_px, lens_px = (image.shape[1], image.shape[0]), self._spec.lens.size_px
        if size_px != lens_px:
            self._skip(f"{picture.path} is {size_px[0]}x{size_px[1]} px, the lens {lens_px[0]}x{lens_px[1]} px")
            return None
        return image

    def _skip(self, what: str) -> None:
        if what in self.skipped:  # of an earlier round
            return
        self.skipped.append(what)
        _log.warning("camera %s: skipped: %s", self._spec.id, what)


def _timeline(section: ImagesSection, paths: tuple[Path, ...]) -> Timeline:
    if section.stamps is None:
        return at_rate(section.fps or DEFAULT_FPS)
    names = None if any(map(pictures.is_video, paths)) else [path.name for path in paths]
    return from_file(Path(section.stamps).expanduser(), names)


def check(sections: Mapping[str, tuple[CameraSpec, ImagesSection]]) -> list[tuple[str, str, str]]:
    """Return a fault for every place without a readable picture, or whose first is of another size than the lens."""
    faults = []
    for camera, (spec, section) in sections.items():
        try:
            paths = pictures.find(section.path)
        except InputError as error:
            faults.append((camera, "path", str(error)))
            continue
        try:
            _timeline(section, paths)
        except InputError as error:
            faults.append((camera, "stamps", str(error)))
        found = next((p.image for p in pictures.read(paths) if p.image is not None), None)
        if found is None:
            faults.append((camera, "path", f"{section.path} holds no picture that can be read"))
        elif (size_px := (found.shape[1], found.shape[0])) != (lens_px := spec.lens.size_px):
            text = f"pictures are {size_px[0]}x{size_px[1]} px, the camera's lens is for {lens_px[0]}x{lens_px[1]} px"
            faults.append((camera, "path", text))
    return faults


def make(sections: Mapping[str, tuple[CameraSpec, ImagesSection]]) -> dict[str, Camera]:
    """Build the cameras; opens nothing."""
    clock = RealClock()
    return {camera: ImagesCamera(spec, section, clock) for camera, (spec, section) in sections.items()}
