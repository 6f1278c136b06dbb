"""AprilTag's C library as two wheels pack it: pyapriltags (the default) and pupil-apriltags.

Both call it through ctypes.CDLL, which releases the GIL for the length of each call. Corners come with the first
pixel's centre at (0.5, 0.5) and leave in OpenCV's convention. The library's own pose is never asked for: it
knows no distortion and one solution of two, and in pupil-apriltags it leaks 3 kB a tag.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.interfaces import TagDetector
from camrig.messages import TagDetection
from camrig.rig import TagKey
from camrig_drivers.apriltag.guards import OneThread, require_raw
from camrig_drivers.apriltag.sections import DetectorSection, PupilSection, PyapriltagsSection

_HALF_PIXEL = 0.5


class _Found(Protocol):
    """What both wheels say of a tag."""

    tag_family: bytes
    tag_id: int
    hamming: int
    decision_margin: float
    center: Array
    corners: Array


class _Library(Protocol):
    """What both wheels call ``Detector``; ``tag_detector_ptr`` points to the C library's settings."""

    tag_detector_ptr: Any

    def detect(self, img: GreyImage) -> Sequence[_Found]: ...


_Settings = tuple[type[Any], tuple[str, ...]]

_idle: dict[_Settings, list[_Library]] = {}
"""Detectors whose owner is gone, to be used again: none is ever destroyed (see ``_build``)."""


class CDetector:
    """One detector of the C library, for one thread at a time."""

    def __init__(self, wheel: type[Any], section: DetectorSection, families: tuple[str, ...]) -> None:
        self._section = section
        idle = _idle.setdefault((wheel, families), [])
        self._library = idle.pop() if idle else _build(wheel, families)
        self._one_thread = OneThread()
        weakref.finalize(self, idle.append, self._library).atexit = False

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        """Find all tags; see ``camrig.interfaces.TagDetector``."""
        return self.detect_shrunk(image, self._section.decimate)

    def detect_shrunk(self, image: GreyImage, decimate: float) -> tuple[TagDetection, ...]:
        """Find all tags; see ``camrig.interfaces.SearchesCoarser``."""
        require_raw(image)
        with self._one_thread.entered():
            self._library.tag_detector_ptr.contents.quad_decimate = decimate  # the library reads it for each picture
            found = self._library.detect(image)
        return tuple(tag for tag in map(_detection, found) if self._section.counts(tag))


def _detection(found: _Found) -> TagDetection:
    x, y = found.center
    return TagDetection(
        TagKey(found.tag_family.decode("ascii"), int(found.tag_id)),
        np.asarray(found.corners, dtype=np.float64) - _HALF_PIXEL,
        (float(x) - _HALF_PIXEL, float(y) - _HALF_PIXEL),
        int(found.hamming),
        float(found.decision_margin),
    )


def _build(wheel: type[Any], families: tuple[str, ...]) -> _Library:
    """Make a detector that lives as long as the process.

    pupil-apriltags frees the families before the detector that uses them, which corrupts the heap. A module's
    list would not do: the interpreter empties it at exit and the destructors run. So one reference is never given
    back; the 37 MB return with the process.
    """
    library: _Library = wheel(families=" ".join(families), nthreads=1, refine_edges=1)
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(library))
    return library


def make_pyapriltags(section: PyapriltagsSection) -> TagDetector:
    """Build a detector on pyapriltags."""
    from pyapriltags import Detector  # noqa: PLC0415 - only the backend that is asked for loads its library

    return CDetector(Detector, section, section.families)


def make_pupil(section: PupilSection) -> TagDetector:
    """Build a detector on pupil-apriltags; raises InputError where it is not installed."""
    try:
        from pupil_apriltags import Detector  # noqa: PLC0415 - declared for x86_64 alone
    except ImportError as error:
        raise InputError(
            "detector 'pupil' needs pupil-apriltags, which exists for x86_64 and Python < 3.14 alone;"
            " use pyapriltags, which is AprilTag's newer C library"
        ) from error
    return CDetector(Detector, section, section.families)
