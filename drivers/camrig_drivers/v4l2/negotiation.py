"""Agrees with a device on the format and rate of its pictures."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import get_args

from camrig.errors import HardwareError
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.node import Identity, Node, PictureFormat
from camrig_drivers.v4l2.offers import picture_sizes, pixel_formats

_log = logging.getLogger(__name__)

_RATE_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class Agreement:
    """What was asked of a device, and what it gave; a rate is None where it was not asked, or is not told."""

    identity: Identity
    given: PictureFormat
    asked_fps: float | None
    given_fps: float | None

    @property
    def rate_kept(self) -> bool:
        if self.asked_fps is None:
            return True
        return self.given_fps is not None and abs(self.given_fps - self.asked_fps) <= _RATE_TOLERANCE * self.asked_fps

    def __str__(self) -> str:
        given = _rate(self.given_fps, "a rate it does not tell")
        return f"{self.identity}: {self.given} at {given} (asked: {_rate(self.asked_fps, 'its own')})"


def negotiate(
    node: Node, identity: Identity, label: str, pixels: PixelFormat, size_px: tuple[int, int], fps: float | None
) -> Agreement:
    """Set the format and ask for the rate; log what the device gave.

    Raises HardwareError where the node is no camera or gives another format or size: a lens is calibrated for one.
    Another rate is only warned of.
    """
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
    agreement = Agreement(identity, given, fps, node.set_rate(fps))
    _log.log(logging.INFO if agreement.rate_kept else logging.WARNING, "%s is %s", label, agreement)
    return agreement


def _rate(fps: float | None, unknown: str) -> str:
    return unknown if fps is None else f"{fps:.5g} fps"


def _offers(node: Node) -> str:
    """List what of the device's offer this driver reads, or all formats where it reads none."""
    formats = pixel_formats(node)
    usable = [pixels for pixels in formats if pixels in get_args(PixelFormat)]
    if not usable:
        return ", ".join(formats) or "no format"
    sizes = {pixels: ", ".join(map(str, picture_sizes(node, pixels))) for pixels in usable}
    return "; ".join(f"{pixels} {sizes[pixels]}".rstrip() for pixels in usable)
