"""From the buffers of a device to grey pictures, at the cost of one copy or one decoding; never through colour.

A device's memory may be slow to read and is wanted back: the picture is copied out once and the buffer returned.
"""

from __future__ import annotations

import mmap
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import GreyImage

PixelFormat = Literal[
    "YUYV", "GREY", "NV12", "MJPG", "YVYU", "UYVY", "VYUY", "NV21", "NV16", "NV61", "NV24", "NV42", "YU12", "YV12",
    "422P", "Y10", "Y12", "Y16", "Y16-BE", "YUVA", "YUVX", "AYUV", "XYUV", "YUV4", "VUYA", "VUYX", "JPEG",
]  # fmt: skip
"""All formats that hold luma as it is; those of colour (RGB, Bayer) are for other programs."""

Luma = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.uint32]
"""(height, width) view of a buffer; the low byte of each element, once shifted, is the pixel's luma."""

_HUGE_PAGE_BYTES = 1 << 21
_END_OF_JPEG = b"\xff\xd9"
_JPEG = ("MJPG", "JPEG")
_FIRST_OF_PAIR, _SECOND_OF_PAIR, _OF_FOUR = "<u2", ">u2", "<u4"
"""Luma is one byte of each element: numpy copies low bytes four times as fast as every second byte."""
_LUMA_TYPES = {
    **dict.fromkeys(("YUYV", "YVYU", "Y16-BE"), _FIRST_OF_PAIR),
    **dict.fromkeys(("UYVY", "VYUY", "Y16"), _SECOND_OF_PAIR),
    **dict.fromkeys(("Y10", "Y12"), "<u2"),
    **dict.fromkeys(("YUVA", "YUVX", "AYUV", "XYUV", "YUV4", "VUYA", "VUYX"), _OF_FOUR),
}
"""All other formats begin with a plane of luma bytes."""
_SHIFTS = {"Y10": 2, "Y12": 4, "AYUV": 8, "XYUV": 8, "YUV4": 8, "VUYA": 16, "VUYX": 16}


@dataclass(frozen=True, slots=True)
class LumaLayout:
    """Where the luma of an uncompressed picture lies in its buffer."""

    kind: np.dtype[np.uint8] | np.dtype[np.uint16] | np.dtype[np.uint32]
    size_px: tuple[int, int]
    line_bytes: int
    shift: int = 0
    """How many bits of an element lie below its luma."""

    @property
    def needed_bytes(self) -> int:
        """Up to the last pixel; lines may be padded, the last need not be."""
        return self.line_bytes * (self.size_px[1] - 1) + self.size_px[0] * self.kind.itemsize

    def view(self, buffer: mmap.mmap) -> Luma:
        """View the luma in a buffer of at least ``needed_bytes``; copies nothing. The buffer cannot be closed
        while it is viewed: ``frombuffer`` sees to that, the constructor alone would read on where no memory is.
        """
        data = np.frombuffer(buffer, np.uint8)
        return np.ndarray(self.size_px[::-1], self.kind, data, strides=(self.line_bytes, self.kind.itemsize))

    def copy(self, luma: Luma, image: GreyImage) -> None:
        """Copy the luma of a ``view`` into a picture of its size."""
        if self.shift:
            np.right_shift(luma, self.shift, out=image, casting="unsafe")
        else:
            np.copyto(image, luma, casting="unsafe")


def empty_picture(size_px: tuple[int, int]) -> GreyImage:
    """Return a picture to be filled again and again, in memory of huge pages where the kernel has them.

    They spare the processor the look-ups of a page every 4 KB, about a tenth of what a picture of 1280x720 costs.
    """
    width, height = size_px
    memory = mmap.mmap(-1, width * height + 2 * _HUGE_PAGE_BYTES)
    with suppress(OSError):  # a kernel without them
        memory.madvise(mmap.MADV_HUGEPAGE)
    data = np.frombuffer(memory, np.uint8)
    start = -data.ctypes.data % _HUGE_PAGE_BYTES
    return data[start : start + width * height].reshape(height, width)


def luma_layout(pixels: PixelFormat, size_px: tuple[int, int], line_bytes: int) -> LumaLayout | None:
    """Return the layout of a format whose lines are ``line_bytes`` apart, 0 for no padding; None for JPEG."""
    if pixels in _JPEG:
        return None
    kind = np.dtype(_LUMA_TYPES.get(pixels, "u1"))
    return LumaLayout(kind, size_px, line_bytes or size_px[0] * kind.itemsize, _SHIFTS.get(pixels, 0))


def decode_jpeg(buffer: mmap.mmap, used_bytes: int, size_px: tuple[int, int]) -> GreyImage | None:
    """Decode the luma of a JPEG; None where it is damaged, ends early or is of another size."""
    if buffer.rfind(_END_OF_JPEG, 0, used_bytes) < 0:
        return None  # OpenCV would fill up the missing rows with grey
    data = np.frombuffer(buffer, np.uint8, used_bytes)
    try:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    if image is None or image.shape != (size_px[1], size_px[0]):
        return None
    return np.asarray(image, dtype=np.uint8)
