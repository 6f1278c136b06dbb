"""OpenCV's marker detector reading AprilTags. Its bindings release the GIL for the length of each call.

Its corners are in OpenCV's convention already, but its dictionaries hold the tags turned by 180 degrees:
AprilTag's p0..p3 are its corners 1, 0, 3, 2. It says neither how many bits it corrected nor how clear they were,
so the bits are read again between refined corners.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage
from camrig.interfaces import TagDetector
from camrig.messages import TagDetection
from camrig.rig import TagKey
from camrig_drivers.apriltag.edges import refine_corners
from camrig_drivers.apriltag.guards import OneThread, require_raw
from camrig_drivers.apriltag.sections import OpencvSection

_DICTIONARIES = {
    "tag16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "tag25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "tag36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "tag36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
_TO_APRILTAG_ORDER = [1, 0, 3, 2]
_SAMPLES = 4
"""Samples along a cell's side; the outer ones, which blur mixes with the neighbours, are left out."""


class OpencvDetector:
    """One detector of OpenCV for each family, for one thread at a time."""

    def __init__(self, section: OpencvSection) -> None:
        self._section = section
        self._families = tuple(_Family(family, section.border_bits) for family in section.families)
        self._one_thread = OneThread()

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        """Find all tags; see ``camrig.interfaces.TagDetector``."""
        return self.detect_shrunk(image, self._section.decimate)

    def detect_shrunk(self, image: GreyImage, decimate: float) -> tuple[TagDetection, ...]:
        """Find all tags; see ``camrig.interfaces.SearchesCoarser``."""
        require_raw(image)
        with self._one_thread.entered():
            small, scale = _shrunk(image, decimate)
            found = [tag for family in self._families for tag in family.detect(image, small, scale)]
        return tuple(tag for tag in found if self._section.counts(tag))


class _Family:
    def __init__(self, name: str, border_bits: int) -> None:
        self._name = name
        self._border_bits = border_bits
        self._dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARIES[name])
        self._cells = self._dictionary.markerSize + 2 * border_bits
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = border_bits
        self._detector = cv2.aruco.ArucoDetector(self._dictionary, parameters)

    def detect(self, image: GreyImage, small: GreyImage, scale: Array) -> Iterator[TagDetection]:
        quads, ids, _ = self._detector.detectMarkers(small)
        for quad, tag_id in zip(quads, [] if ids is None else ids.ravel(), strict=True):
            found = (quad.reshape(4, 2).astype(np.float64) + 0.5) * scale - 0.5
            cell_px = cv2.arcLength(found.astype(np.float32), closed=True) / 4.0 / self._cells
            corners = refine_corners(image, found, cell_px)
            if corners is None:  # a border of another width: the bits fit, the corners would be a cell off
                continue
            hamming, margin = self._read(image, corners, int(tag_id))
            ordered = corners[_TO_APRILTAG_ORDER]
            yield TagDetection(TagKey(self._name, int(tag_id)), ordered, _centre(corners), hamming, margin)

    def _read(self, image: GreyImage, corners: Array, tag_id: int) -> tuple[int, float]:
        """Return how many bits differ from tag ``tag_id``, and half the contrast of its white and black.

        The grey values are fitted by a plane (uneven light) plus the pattern: the plane is the threshold of the
        bits, the pattern's factor the margin. This is close to what AprilTag calls decision margin (1.07 of it
        at the median of 103 real tags).
        """
        size = (self._cells, self._cells)
        pattern = cv2.aruco.generateImageMarker(self._dictionary, tag_id, self._cells, borderBits=self._border_bits)
        sign = np.where(pattern > 0, 1.0, -1.0).ravel()
        grey = _cell_greys(image, corners, self._cells).ravel()
        y, x = np.indices(size).reshape(2, -1)
        model = np.column_stack([np.ones(grey.size), x, y, sign])
        fit = np.linalg.lstsq(model, grey)[0]
        wrong = (grey > model[:, :3] @ fit[:3]) != (sign > 0)
        border = self._border_bits
        return int(wrong.reshape(size)[border:-border, border:-border].sum()), float(fit[3])


def _cell_greys(image: GreyImage, corners: Array, cells: int) -> Array:
    """Return the (cells, cells) mean grey of the middle of each cell of the tag between (4, 2) corners."""
    side = cells * _SAMPLES
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]], dtype=np.float32) - np.float32(0.5)
    T_image_cells = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    grey = cv2.warpPerspective(image, T_image_cells, (side, side), flags=flags).astype(np.float64)
    return np.asarray(grey.reshape(cells, _SAMPLES, cells, _SAMPLES)[:, 1:-1, :, 1:-1].mean(axis=(1, 3)))


def _shrunk(image: GreyImage, decimate: float) -> tuple[GreyImage, Array]:
    """Return the picture shrunk by ``decimate``, and (2,) the factors in x and y back to the full one."""
    if decimate == 1.0:
        return image, np.ones(2)
    height, width = image.shape
    size = (round(width / decimate), round(height / decimate))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), np.array([width / size[0], height / size[1]])


def _centre(corners: Array) -> tuple[float, float]:
    """Return where the diagonals of (4, 2) corners meet, which is the tag's centre in any perspective."""
    a, b, c, d = corners
    along = np.linalg.solve(np.column_stack([c - a, b - d]), b - a)
    x, y = a + along[0] * (c - a)
    return float(x), float(y)


def make_opencv(section: OpencvSection) -> TagDetector:
    """Build a detector on OpenCV."""
    return OpencvDetector(section)
