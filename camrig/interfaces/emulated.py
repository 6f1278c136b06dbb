"""Emulated rigs and devices, and what draws pictures of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from camrig.geometry.arrays import GreyImage, Transform
from camrig.geometry.lens import Lens
from camrig.rig import Rig


class World(Protocol):
    """An emulated rig: scenery, robots, and emulated heads and drones on real ports."""

    def start(self) -> Mapping[str, str]:
        """Start everything; return the port or url of each head, drone and camera, by id."""
        ...

    def truth(self, stamp_s: float) -> Mapping[str, Transform]:
        """Return the true ``T_world_body`` of every target at any stamp, by id."""
        ...

    def elapsed_s(self, stamp_s: float) -> float:
        """Return the world's own time at a stamp: two worlds of one seed are alike at the same elapsed time."""
        ...

    def stop(self) -> None:
        """Stop everything, leaving no thread, descriptor or child; twice is allowed."""
        ...


Instant = tuple[Transform, Mapping[str, Transform]]
"""``T_world_camera``, and ``T_world_body`` of every target by id, at one time."""


class Painter(Protocol):
    """Draws what a camera truly sees of a rig's targets, anchors and boxes, off-line. Used by one thread."""

    def paint(self, rig: Rig, lens: Lens, instant_at: Callable[[float], Instant], seed: int) -> GreyImage:
        """Return the raw (height, width) picture through ``lens``, whatever the rig believes of its cameras. Of
        ``instant_at`` seconds within the exposure are asked, 0 in its middle. ``seed`` is of the noise: the same
        arguments give the same picture. Raises InputError for what cannot be drawn.
        """
        ...


class Emulator(Protocol):
    """One emulated device on a real port, as ``camrig emulate`` and other people's tests run it."""

    def start(self) -> str:
        """Start it; return the port or url that the real driver opens."""
        ...

    def describe(self) -> str:
        """Return its state in one line, for a person."""
        ...

    def stop(self) -> None:
        """Stop it, leaving no thread or descriptor; twice is allowed."""
        ...
