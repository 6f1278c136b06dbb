"""A scene as arrays: what all kernels work on. Every camera has the same six variables, most of them not free.

A *vector* is (x, y, z, pan, tilt, zoom): metres in the world, radians, and the place in the lens's zoom table (0 is its
first row). A head's place is where its pan axis stands and is not free unless it is still to be mounted; a drone's pan
is its yaw, and it does not tilt; a bolted camera has nothing free. Free is what its limits leave free.

The arrays are few and wide, a row for each thing, because kernels are called with all of them: these are their columns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array

X, Y, Z, PAN, TILT, ZOOM = range(6)
VARIABLES = 6

PIXEL, FISHER, PERSPECTIVE = range(3)
"""Quality models."""

CHANNELS = (1, 6, 1)
"""What a quality model adds up over cameras: a gain 1/Q, or the (3, 3) information of a place as xx xy xz yy yz zz."""

# Cameras: from the pan axis's frame to the world; the tilt axis in the frame of the panned arm; the camera in that of
# the tilted mount; limits; one sigma of what the pose is uncertain by (metres, radians about any axis, pan, tilt); the
# horizontal distance that a drone keeps (-1: no drone); whether it must see an anchor; the first row of its lens, and
# how many rows there are.
BASE_R, ARM_R, ARM_T, CAMERA_R, CAMERA_T, LOW, HIGH, PRIOR = 0, 9, 18, 21, 30, 33, 39, 45
SEPARATION, NEEDS_ANCHOR, LENS_FIRST, LENS_COUNT = 49, 50, 51, 52
CAMERA_SIZE = 53

# Targets, and anchors alike: the centre; the tag's corners (of a point: four times the point); the corners of the
# square that must be in the picture; the unit normal; by how much it may be elsewhere; weight; whether it has a tag.
POINT, CORNERS, ROOM, NORMAL, REACH, WEIGHT, TAGGED = 0, 3, 15, 27, 30, 31, 32
TARGET_SIZE = 33

MARGIN, MIN_TAG_PX, LEAST_FACING, RANGE, CONE, QUALITY = range(6)
"""Settings: radians, pixels, the cosine of the flattest angle off its normal at which a tag is seen, metres, 1 for the
paper's cone, and the quality model."""
SETTINGS_SIZE = 6

Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


class Problem(NamedTuple):
    """n cameras, L rows of lenses (geometry.lens_row), m targets, A anchors, B boxes; metres, radians, world frame."""

    cameras: Array
    """(n, CAMERA_SIZE)"""
    lenses: Array
    targets: Array
    """(m, TARGET_SIZE)"""
    anchors: Array
    """(A, TARGET_SIZE)"""
    boxes: Array
    """(B, 2, 3) keep-out boxes: lowest and highest corner."""
    settings: Array
    """(SETTINGS_SIZE,)"""

    # What follows is for Python; kernels read the columns.

    @property
    def low(self) -> Array:
        """(n, 6) lowest vectors."""
        return self.cameras[:, LOW : LOW + VARIABLES]

    @property
    def high(self) -> Array:
        """(n, 6) highest vectors."""
        return self.cameras[:, HIGH : HIGH + VARIABLES]

    @property
    def separation_m(self) -> Array:
        """(n,) what drones keep from each other horizontally; -1 for what is no drone."""
        return self.cameras[:, SEPARATION]

    @property
    def needs_anchor(self) -> Flags:
        """(n,) who must see an anchor."""
        return self.cameras[:, NEEDS_ANCHOR] > 0.0

    @property
    def points(self) -> Array:
        """(m, 3) where the targets are."""
        return self.targets[:, POINT : POINT + 3]

    @property
    def weights(self) -> Array:
        """(m,) what the targets weigh."""
        return self.targets[:, WEIGHT]

    @property
    def quality(self) -> int:
        """The quality model."""
        return int(self.settings[QUALITY])

    @property
    def cone(self) -> bool:
        """Whether the paper's cone is the visibility."""
        return bool(self.settings[CONE] > 0.0)

    @property
    def channels(self) -> int:
        """How many numbers a camera adds to a target."""
        return CHANNELS[self.quality]
