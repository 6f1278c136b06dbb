"""Streaming from mapped buffers: the newest good picture, and a count of all that was lost."""

from __future__ import annotations

import mmap
from contextlib import suppress
from dataclasses import dataclass

from camrig.errors import HardwareError
from camrig.geometry.arrays import GreyImage
from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.grey import Luma, PixelFormat, decode_jpeg, empty_picture, luma_layout
from camrig_drivers.v4l2.node import Filled, Node, PictureFormat
from camrig_drivers.v4l2.port import Ready

BUFFERS = 6
"""A reader may be held up for so many periods before frames are missed."""
_SEQUENCES = 1 << 32


@dataclass(slots=True)
class Counters:
    """What became of the frames since ``open``."""

    read: int = 0
    missed: int = 0
    """Never came: gaps in the device's sequence numbers."""
    flagged: int = 0
    """Dropped: the device says that their content is wrong."""
    broken: int = 0
    """Dropped: too short, or a JPEG that cannot be decoded."""
    skipped: int = 0
    """Dropped: a newer one was there already."""

    def __str__(self) -> str:
        return (
            f"{self.read} frames read, {self.skipped} skipped for newer ones, {self.missed} missed, "
            f"{self.flagged} flagged as wrong, {self.broken} broken"
        )


class Stream:
    """A node that streams, from building until ``close``."""

    def __init__(self, node: Node, label: str, pixels: PixelFormat, given: PictureFormat, counters: Counters) -> None:
        self._node = node
        self._size_px = given.size_px
        self._layout = luma_layout(pixels, given.size_px, given.line_bytes)
        self._counters = counters
        self._last_sequence: int | None = None
        self._maps: list[mmap.mmap] = []
        self._lumas: list[Luma] = []
        self._image = empty_picture(given.size_px)
        try:
            self._start(label, given)
        except BaseException:
            self.close()
            raise

    def poll(self, wake_fd: int, timeout_s: float) -> Ready:
        """Block until there is a frame or a fault, ``wake_fd`` is readable or the time is up."""
        return self._node.poll(wake_fd, timeout_s)

    def newest(self) -> Filled | None:
        """Take all filled buffers; give back all but the newest good one, or None."""
        newest = None
        while (filled := self._node.dequeue()) is not None:
            self._count_gap(filled.sequence)
            if filled.flags & abi.BUF_FLAG_ERROR:
                self._counters.flagged += 1
                self._node.queue(filled.index)
                continue
            if newest is not None:
                self._counters.skipped += 1
                self._node.queue(newest.index)
            newest = filled
        return newest

    def picture(self, filled: Filled) -> GreyImage | None:
        """Return the grey picture of a buffer, valid until the next call, and give the buffer back; None if broken."""
        image = self._grey(filled)
        self._node.queue(filled.index)
        if image is None:
            self._counters.broken += 1
        else:
            self._counters.read += 1
        return image

    def close(self) -> None:
        """Stop streaming and unmap the buffers."""
        with suppress(OSError):  # the device may be gone
            self._node.stream_off()
        self._lumas.clear()  # a viewed buffer cannot be unmapped
        while self._maps:
            self._maps.pop().close()

    def _start(self, label: str, given: PictureFormat) -> None:
        for index in range(self._node.request_buffers(BUFFERS)):
            buffer = self._node.map_buffer(index)
            self._maps.append(buffer)
            if self._layout is not None:
                if len(buffer) < self._layout.needed_bytes:
                    raise HardwareError(
                        f"{label} makes buffers of {len(buffer)} bytes, but a picture of {given} needs "
                        f"{self._layout.needed_bytes}; choose another format"
                    )
                self._lumas.append(self._layout.view(buffer))
            self._node.queue(index)
        self._node.stream_on()

    def _grey(self, filled: Filled) -> GreyImage | None:
        if self._layout is None:
            return decode_jpeg(self._maps[filled.index], filled.used_bytes, self._size_px)
        if filled.used_bytes < self._layout.needed_bytes:
            return None
        self._layout.copy(self._lumas[filled.index], self._image)
        return self._image

    def _count_gap(self, sequence: int) -> None:
        if self._last_sequence is not None:
            step = (sequence - self._last_sequence) % _SEQUENCES
            if 1 < step < _SEQUENCES // 2:  # a device that does not count, or counts anew, tells nothing
                self._counters.missed += step - 1
        self._last_sequence = sequence
