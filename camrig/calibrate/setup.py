"""What is known before the pictures are looked at: lenses, sizes, what stands where, what carries what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camrig.calibrate.sighted import ROOM
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pan_tilt import PanTilt

CARRIED = "carried"
"""The body of every mark of which nothing else is said."""

_STIFF = 1e-5
"""One sigma, in metres and radians, of what a head's joints do not leave free."""


@dataclass(frozen=True, slots=True, eq=False)
class OnHead:
    """A camera on a pan-tilt head: how its axes lie, how the camera sits on it, one sigma of the angles that it says,
    and whether how the camera sits on it is to be found too.
    """

    T_arm_tilt: Transform
    T_mount_camera: Transform
    angle_sigma_rad: float
    find_mount: bool = False

    def T_base_mount(self, aim_rad: tuple[float, float]) -> Transform:
        """Return where the mount is if the head is where it says."""
        return self._axes.T_world_mount(*aim_rad)

    def T_base_camera(self, aim_rad: tuple[float, float]) -> Transform:
        """Return where the camera is if the head is where it says."""
        return self.T_base_mount(aim_rad) @ self.T_mount_camera

    def information(self, aim_rad: tuple[float, float]) -> Array:
        """Return the (6, 6) information (geometry.pose) of ``T_base_mount``."""
        J = self._axes.jacobian(*aim_rad, np.eye(4))
        return np.asarray(np.linalg.inv(self.angle_sigma_rad**2 * J @ J.T + _STIFF**2 * np.eye(6)))

    @property
    def _axes(self) -> PanTilt:
        return PanTilt(np.eye(4), self.T_arm_tilt)


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Lenses by camera, sizes by tag, and what else is known.

    ``anchors`` are the marks whose ``T_world_mark`` is known, taken for exact. ``bodies`` tells what carries a mark:
    the name of what moves, or ``ROOM``; a mark that is not there is ``CARRIED``. ``heads`` by camera; ``kept``
    are cameras (their heads' bases) whose place is not asked but known. ``frames`` tells of a body which of its marks
    it hangs on, and ``T_body_mark`` of that; of others it is the mark of which most is seen.
    """

    lenses: Mapping[str, Lens]
    sizes_m: Mapping[str, float]
    anchors: Mapping[str, Transform] = field(default_factory=dict)
    bodies: Mapping[str, str] = field(default_factory=dict)
    heads: Mapping[str, OnHead] = field(default_factory=dict)
    kept: Mapping[str, Transform] = field(default_factory=dict)
    frames: Mapping[str, tuple[str, Transform]] = field(default_factory=dict)

    def body_of(self, mark: str) -> str:
        """Return what carries a mark."""
        return ROOM if mark in self.anchors else self.bodies.get(mark, CARRIED)

    @property
    def still(self) -> frozenset[str]:
        """The marks that stand in the room."""
        return frozenset(self.anchors) | {mark for mark, body in self.bodies.items() if body == ROOM}
