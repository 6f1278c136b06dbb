"""From the buffers of a device to grey pictures, at the cost of one copy or one decoding; never through colour.

A device's memory may be slow to read and is wanted back: the picture is copied out once and the buffer returned.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import GreyImage

PixelFormat = Literal["YUYV", "GREY", "NV12", "MJPG"]

Luma = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""(height, width) view of a buffer; the low byte of each element is the pixel's luma."""

_END_OF_JPEG = b"\xff\xd9"
_LUMA_TYPES = {"GREY": "u1", "NV12": "u1", "YUYV": "<u2"}
"""The first byte of each YUYV pair is luma: numpy copies low bytes four times as fast as every second byte."""


@dataclass(frozen=True, slots=True)
class LumaLayout:
    """Where the luma of an uncompressed picture lies in its buffer."""

    kind: np.dtype[np.uint8] | np.dtype[np.uint16]
    size_px: tuple[int, int]
    line_bytes: int

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


def luma_layout(pixels: PixelFormat, size_px: tuple[int, int], line_bytes: int) -> LumaLayout | None:
    """Return the layout of a format whose lines are ``line_bytes`` apart, 0 for no padding; None for JPEG."""
    if pixels == "MJPG":
        return None
    kind = np.dtype(_LUMA_TYPES[pixels])
    return LumaLayout(kind, size_px, line_bytes or size_px[0] * kind.itemsize)


def copy_luma(luma: Luma, image: GreyImage) -> None:
    """Copy the low bytes of a view into a picture of its size."""
    np.copyto(image, luma, casting="unsafe")


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
