"""A picture with its tags drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.messages import TagDetection

ColourImage = npt.NDArray[np.uint8]
"""(height, width, 3) in OpenCV's order: blue, green, red."""

_SIDE = (0, 220, 0)
_BOTTOM = (0, 80, 255)
_AXES = ((0, 0, 255), (0, 220, 0), (255, 80, 0))
_SHIFT = 4
"""Fractional bits of the coordinates that OpenCV draws at."""


def draw_tags(image: GreyImage, tags: Sequence[TagDetection], axes_px: Sequence[Array | None]) -> ColourImage:
    """Draw outlines, the bottom side in red, numbers, and where known the axes x, y, z in red, green, blue.

    ``axes_px``: (4, 2) pixels of each tag's origin and the ends of its axes; NaN where out of sight.
    """
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for tag, axes in zip(tags, axes_px, strict=True):
        p = tag.corners_px
        for start, end in ((1, 2), (2, 3), (3, 0), (0, 1)):
            _line(canvas, p[start], p[end], _BOTTOM if start == 0 else _SIDE)
        for end, colour in enumerate(_AXES, 1):
            if axes is not None:
                _line(canvas, axes[0], axes[end], colour)
        _number(canvas, tag)
    return np.asarray(canvas, dtype=np.uint8)


def write_picture(path: Path, picture: ColourImage) -> None:
    """Write a PNG; raises InputError where that cannot be done."""
    try:
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error


def _line(canvas: cv2.typing.MatLike, start: Array, end: Array, colour: tuple[int, int, int]) -> None:
    if np.isfinite(start).all() and np.isfinite(end).all():
        a, b = (np.clip(np.round(point * 2**_SHIFT), -(2**24), 2**24).astype(int).tolist() for point in (start, end))
        cv2.line(canvas, a, b, colour, 2, cv2.LINE_AA, _SHIFT)


def _number(canvas: cv2.typing.MatLike, tag: TagDetection) -> None:
    text = str(tag.key.id)
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 2)
    place = (round(tag.centre_px[0] - width / 2), round(tag.centre_px[1] + height / 2))
    for colour, thickness in (((0, 0, 0), 4), ((0, 255, 255), 2)):
        cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, thickness, cv2.LINE_AA)
