"""Agrees with a device on the format and rate of its pictures."""

from __future__ import annotations

import logging
from typing import get_args

from camrig.errors import HardwareError
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.node import Node, PictureFormat

_log = logging.getLogger(__name__)

_RATE_TOLERANCE = 0.01


def negotiate(
    node: Node, label: str, pixels: PixelFormat, size_px: tuple[int, int], fps: float | None
) -> PictureFormat:
    """Set the format and ask for the rate; log what the device gave.

    Raises HardwareError where the node is no camera or gives another format or size: a lens is calibrated for one.
    Another rate is only logged.
    """
    identity = node.identity()
    if not identity.is_camera:
        raise HardwareError(f"{label} ({identity}) gives no pictures; a camera's pictures are on its first node")
    given = node.set_format(pixels, size_px)
    if (given.pixels, given.size_px) != (pixels, size_px):
        raise HardwareError(
            f"{label} ({identity}) was asked for {size_px[0]}x{size_px[1]} {pixels} and gives {given}; "
            f"it offers {_offers(node)}"
        )
    if not given.progressive:
        raise HardwareError(f"{label} ({identity}) gives interlaced pictures, whose lines are of different times")
    given_fps = node.set_rate(fps)
    off = fps is not None and (given_fps is None or abs(given_fps - fps) > _RATE_TOLERANCE * fps)
    _log.log(
        logging.WARNING if off else logging.INFO,
        "%s is %s: %s at %s (asked: %s)",
        label,
        identity,
        given,
        _rate(given_fps, "a rate it does not tell"),
        _rate(fps, "its own"),
    )
    return given


def _rate(fps: float | None, unknown: str) -> str:
    return unknown if fps is None else f"{fps:.5g} fps"


def _offers(node: Node) -> str:
    """List what of the device's offer this driver reads, or all formats where it reads none."""
    formats = node.pixel_formats()
    usable = [pixels for pixels in formats if pixels in get_args(PixelFormat)]
    if not usable:
        return ", ".join(formats) or "no format"
    return "; ".join(f"{pixels} {', '.join(node.picture_sizes(pixels))}".rstrip() for pixels in usable)
