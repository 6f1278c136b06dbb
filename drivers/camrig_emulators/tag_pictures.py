"""Pictures of AprilTags as they are printed, for the renderer: the black square and a white quiet zone around it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage
from camrig.rig import TagKey

_DICTIONARIES = {
    "tag16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "tag25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "tag36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "tag36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
WHITE = 220
BLACK = 28


def black_cells(family: str) -> int:
    """Return the number of cells along a side of the black square; raises InputError for an unknown family."""
    return int(_dictionary(family).markerSize) + 2


@lru_cache(maxsize=1024)
def tag_cells(key: TagKey) -> GreyImage:
    """Return the printed tag, one pixel a cell, the quiet zone one cell wide; row 0 is the tag's +y side."""
    dictionary = _dictionary(key.family)
    if not 0 <= key.id < dictionary.bytesList.shape[0]:
        raise InputError(f"{key}: {key.family} has the ids 0 to {dictionary.bytesList.shape[0] - 1}")
    inner = cv2.aruco.generateImageMarker(dictionary, key.id, black_cells(key.family))
    # OpenCV numbers a tag's corners half a turn from AprilTag's order, so its upright is AprilTag's upside down.
    cells = np.pad(inner[::-1, ::-1], 1, constant_values=255)
    return np.where(cells > 127, WHITE, BLACK).astype(np.uint8)


@lru_cache(maxsize=1024)
def tag_texture(key: TagKey, texels_per_cell: int) -> GreyImage:
    """Return ``tag_cells`` with square texels, ``texels_per_cell`` along each cell."""
    return np.kron(tag_cells(key), np.ones((texels_per_cell, texels_per_cell), dtype=np.uint8))


def _dictionary(family: str) -> cv2.aruco.Dictionary:
    if family not in _DICTIONARIES:
        raise InputError(f"the emulated world cannot draw {family} tags; it knows {', '.join(sorted(_DICTIONARIES))}")
    return cv2.aruco.getPredefinedDictionary(_DICTIONARIES[family])
