"""A frame becomes the tags in it: in the whole picture, or only where tags are expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens, Lens
from camrig.interfaces import TagDetector
from camrig.messages import Frame, Region, TagDetection, TagDetections

WHOLE_SHARE = 0.5
"""Regions that together cover more of the picture than this save too little for what is missed elsewhere: detection
costs about as much as the share searched (a tenth for 14 % of 1280 x 720, pyapriltags, decimate 1 and 2).
"""

MIN_SIDE_PX = 32
GRID_PX = 8
"""Regions begin and end on this grid: where a detector halves the picture and thresholds it in tiles of 4 x 4, it then
does in a region exactly what it does in the whole picture. Corners differ by 0.0001 px, by up to 1 px off the grid
(2 x 96 tags of 25 to 90 px, pyapriltags, decimate 1 and 2).
"""

CELLS_ACROSS = {"tag16h5": 6, "tag25h9": 7, "tag36h10": 8, "tag36h11": 8, "tagCircle21h7": 5, "tagStandard41h12": 5}
"""Cells between the corners of a tag, by family: how near to an edge the next one may be."""
MOST_CELLS_ACROSS = 10
"""Of any other family."""


def detect_tags(
    frame: Frame,
    detector: TagDetector,
    now_s: Callable[[], float],
    regions: Sequence[Region] | None = None,
    lens: Lens | None = None,
) -> TagDetections:
    """Find the tags of a frame; ``now_s`` is the clock that tells how long it took.

    With the ``lens`` of its camera their corners are refined through it, unless it is one for pictures of another size.
    With ``regions`` only those are searched, unless they cover so much that the whole picture costs no more. A tag
    that a region cuts is not found. Raises InputError for a picture that no detector takes (a side under 16 px).
    """
    begun_s = now_s()
    height, width = frame.image.shape
    searched = None if regions is None else merged(regions, (width, height))
    if searched is None or sum(_area(region) for region in searched) > WHOLE_SHARE * width * height:
        tags, whole = detector.detect(frame.image), True
    else:
        tags, whole = tuple(tag for region in searched for tag in _detect_in(frame, detector, region)), False
    if tags and lens is not None and lens.size_px == (width, height):
        tags = _refined(frame.image, lens, tags)
    return TagDetections(
        frame.camera_id, frame.stamp_s, frame.sequence, (width, height), tags, now_s() - begun_s, frame.source, whole
    )


def warm_up() -> None:
    """Load the machine code of refinement, or compile it: a quarter of a minute, once after an installation."""
    from camrig.geometry.refine_corners import refine_corners  # noqa: PLC0415 - as below

    square = np.array([[[16.0, 16.0], [48.0, 16.0], [48.0, 48.0], [16.0, 48.0]]])
    lens = BrownLens((64, 64), (64.0, 64.0), (32.0, 32.0))
    refine_corners(np.zeros((64, 64), np.uint8), lens, square, np.full(1, 8.0))


def merged(regions: Sequence[Region], size_px: tuple[int, int]) -> tuple[Region, ...]:
    """Return disjoint regions inside a picture of ``size_px`` that hold all the given ones, each large enough."""
    width, height = size_px
    waiting = [grown for region in regions if (grown := _fitted(region, width, height)) is not None]
    done: list[Region] = []
    while waiting:
        region = waiting.pop()
        touching = next((other for other in done if _overlap(region, other)), None)
        if touching is None:
            done.append(region)
        else:
            done.remove(touching)
            waiting.append(_union(region, touching))
    return tuple(done)


def _refined(image: GreyImage, lens: Lens, tags: Sequence[TagDetection]) -> tuple[TagDetection, ...]:
    from camrig.geometry.refine_corners import refine_corners  # noqa: PLC0415 - loads numba; a stop must not wait for it

    cells = np.array([CELLS_ACROSS.get(tag.key.family, MOST_CELLS_ACROSS) for tag in tags], dtype=np.float64)
    found = refine_corners(image, lens, np.stack([tag.corners_px for tag in tags]), cells)
    return tuple(
        replace(tag, corners_px=corners_px, refined=tuple(refined.tolist()))
        for tag, corners_px, refined in zip(tags, found.corners_px, found.refined, strict=True)
    )


def _detect_in(frame: Frame, detector: TagDetector, region: Region) -> tuple[TagDetection, ...]:
    left, top, right, bottom = region
    # The detector takes a picture of its own: rows of a view would lie a whole picture's width apart.
    found = detector.detect(frame.image[top:bottom, left:right].copy())
    return tuple(
        replace(
            tag,
            corners_px=tag.corners_px + np.array([left, top]),
            centre_px=(tag.centre_px[0] + left, tag.centre_px[1] + top),
        )
        for tag in found
    )


def _fitted(region: Region, width: int, height: int) -> Region | None:
    """Return the part of a region inside the picture, grown to the grid and the least side; None: outside."""
    left, top, right, bottom = max(0, region[0]), max(0, region[1]), min(width, region[2]), min(height, region[3])
    if left >= right or top >= bottom:
        return None
    left, right = _on_grid(left, right, width)
    top, bottom = _on_grid(top, bottom, height)
    return left, top, right, bottom


def _on_grid(low: int, high: int, size: int) -> tuple[int, int]:
    """Return an interval around the given one, at least ``MIN_SIDE_PX`` long, from grid line to grid line."""
    missing = max(0, MIN_SIDE_PX - (high - low))
    low = max(0, min(low - missing // 2, size - MIN_SIDE_PX))
    high = max(high, low + MIN_SIDE_PX)
    return low // GRID_PX * GRID_PX, min(size, -(-high // GRID_PX) * GRID_PX)


def _overlap(a: Region, b: Region) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _union(a: Region, b: Region) -> Region:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _area(region: Region) -> int:
    return (region[2] - region[0]) * (region[3] - region[1])
