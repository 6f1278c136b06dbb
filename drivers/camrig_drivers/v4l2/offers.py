"""What a device offers: formats, sizes and rates."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import TypeVar

from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.node import Node

ItemT = TypeVar("ItemT")


@dataclass(frozen=True, slots=True)
class Sizes:
    """One size, or with ``highest_px`` and ``step_px`` all from ``size_px`` on; width and height."""

    size_px: tuple[int, int]
    highest_px: tuple[int, int] | None = None
    step_px: tuple[int, int] = (1, 1)

    def __str__(self) -> str:
        lowest = f"{self.size_px[0]}x{self.size_px[1]}"
        if self.highest_px is None:
            return lowest
        steps = f"{self.step_px[0]}x{self.step_px[1]}"
        return f"{lowest} to {self.highest_px[0]}x{self.highest_px[1]} in steps of {steps}"


@dataclass(frozen=True, slots=True)
class Mode:
    """A format with its sizes, and the rates at the (largest) size, fastest first; none where it does not tell."""

    pixels: str
    sizes: Sizes
    rates_fps: tuple[float, ...]


def pixel_formats(node: Node) -> list[str]:
    """List the pixel formats that the device offers."""

    def ask(index: int) -> str:
        found = abi.FmtDesc(index=index, type=abi.BUF_TYPE_VIDEO_CAPTURE)
        node.ask(abi.VIDIOC_ENUM_FMT, found)
        return abi.fourcc_name(found.pixelformat)

    return list(_enumerate(ask))


def picture_sizes(node: Node, pixels: str) -> list[Sizes]:
    """List the picture sizes of a pixel format; a device need not tell."""

    def ask(index: int) -> Sizes:
        found = abi.FrmSizeEnum(index=index, pixel_format=abi.fourcc(pixels))
        node.ask(abi.VIDIOC_ENUM_FRAMESIZES, found)
        size = list(found.size)
        if found.type == abi.TYPE_DISCRETE:
            return Sizes((size[0], size[1]))
        return Sizes((size[0], size[3]), (size[1], size[4]), (size[2], size[5]))

    sizes = []
    for size in _enumerate(ask):
        sizes.append(size)
        if size.highest_px is not None:  # a range is the only entry, but some devices repeat it for every index
            break
    return sizes


def rates_fps(node: Node, pixels: str, size_px: tuple[int, int]) -> tuple[float, ...]:
    """List the rates of a mode, fastest first; of a range its two ends."""

    def ask(index: int) -> tuple[int, tuple[float, ...]]:
        found = abi.FrmIvalEnum(index=index, pixel_format=abi.fourcc(pixels), width=size_px[0], height=size_px[1])
        node.ask(abi.VIDIOC_ENUM_FRAMEINTERVALS, found)
        interval = list(found.interval)
        pairs = [interval[:2]] if found.type == abi.TYPE_DISCRETE else [interval[:2], interval[2:4]]
        return found.type, tuple(below / above for above, below in pairs if above and below)

    rates: set[float] = set()
    for kind, found in _enumerate(ask):
        rates |= {round(rate, 3) for rate in found}
        if kind != abi.TYPE_DISCRETE:
            break
    return tuple(sorted(rates, reverse=True))


def modes(node: Node) -> list[Mode]:
    """List everything that the device offers."""
    return [
        Mode(pixels, sizes, rates_fps(node, pixels, sizes.highest_px or sizes.size_px))
        for pixels in pixel_formats(node)
        for sizes in picture_sizes(node, pixels)
    ]


def _enumerate(ask: Callable[[int], ItemT]) -> Iterator[ItemT]:
    """Count up until the kernel says that there are no more, or that it does not enumerate at all."""
    for index in count():
        try:
            found = ask(index)
        except OSError:
            return
        yield found
