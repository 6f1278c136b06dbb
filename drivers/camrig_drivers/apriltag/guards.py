"""What every backend refuses, and what no thread may do twice at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage

MIN_SIDE_PX = 16
"""A side of 2 px crashes the C library, at ``decimate`` 4 one of 8 px; no tag is read below 16 px anyway."""


def require_raw(image: GreyImage) -> None:
    """Raise InputError unless ``image`` is a C-contiguous (height, width) uint8 array of at least 16 px a side."""
    if image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(f"a detector takes a (height, width) uint8 picture, not {image.shape} {image.dtype}")
    height, width = image.shape
    if min(height, width) < MIN_SIDE_PX:
        raise InputError(f"a picture of {width}x{height} px is too small to search; a side needs {MIN_SIDE_PX} px")
    if not image.flags.c_contiguous:
        raise InputError("a detector takes a contiguous picture; copy a crop with numpy.ascontiguousarray first")


class OneThread:
    """A tripwire, not a lock: two threads in one C detector are a segmentation fault, so the second one raises."""

    def __init__(self) -> None:
        self._busy = threading.Lock()

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Hold the detector; raises RuntimeError where another thread holds it."""
        if not self._busy.acquire(blocking=False):
            raise RuntimeError("two threads use one tag detector; give each camera its own")
        try:
            yield
        finally:
            self._busy.release()
