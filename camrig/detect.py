"""A frame becomes the tags in it: in the whole picture, or only where tags are expected."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens, Lens
from camrig.interfaces import SearchesCoarser, TagDetector
from camrig.messages import Frame, Region, TagDetection, TagDetections, Window
from camrig.rig import TagKey

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

SMALL_CELL_PX = 2.5
ENLARGED = 2
"""Where cells are smaller than this a region is enlarged before it is searched. Of tags of 12 to 14 px 93 % are found
then instead of 44 %, and up to 20 px their corners are half as noisy (120 tags36h11 a bin, point spread 0.7 px, noise 4
grey levels, ``docs/accuracy.md``); three times as large finds no more.
"""
SHRINKING = (4.0, 3.0, 2.0)
SHRUNK_CELL_PX = 1.6
"""Quads are searched in a region shrunk by the largest of these that leaves cells this size: none of 120 tags a bin is
lost from 1.5 px on. Corners and bits are read in the full picture all the same.
"""

BLACK, WHITE = 16, 250
BLIND_SHARE = 0.9
SAMPLED_EVERY = 16
"""A picture is black, or over-exposed, where so large a share of every 16th pixel of every 16th row is below, or above.
"""


def detect_tags(
    frame: Frame,
    detector: TagDetector,
    now_s: Callable[[], float],
    windows: Sequence[Window] | None = None,
    lens: Lens | None = None,
    wanted: Collection[TagKey] = (),
) -> TagDetections:
    """Find the tags of a frame; ``now_s`` is the clock that tells how long it took.

    With the ``lens`` of its camera their corners are refined through it, unless it is one for pictures of another size.
    With ``windows`` only those are searched, unless they cover so much that the whole picture costs no more, or a
    ``wanted`` tag is in none of them: then the whole picture is searched after all. A tag that a window cuts is not
    found. A tag that is in the picture twice is told twice, each with its place. Raises InputError for a picture that
    no detector takes.
    """
    begun_s = now_s()
    if frame.image.ndim != 2:
        raise InputError(f"a picture has rows and columns of grey, not the shape {frame.image.shape}")
    height, width = frame.image.shape
    tags = None if windows is None else _in_windows(frame.image, detector, windows)
    whole = tags is None or not {tag.key for tag in tags}.issuperset(wanted)
    if tags is None or whole:
        tags = detector.detect(np.ascontiguousarray(frame.image))
    if tags and lens is not None and lens.size_px == (width, height):
        tags = _refined(frame.image, lens, tags)
    return TagDetections(
        frame.camera_id, frame.stamp_s, frame.sequence, (width, height), tags, now_s() - begun_s, frame.source, whole
    )


def blindness(image: GreyImage) -> str:
    """Say why a picture shows nothing, empty where it may show something. Takes a hundredth of a millisecond."""
    if image.ndim != 2 or not image.size:
        return ""
    sample = image[::SAMPLED_EVERY, ::SAMPLED_EVERY]
    if (sample < BLACK).mean() >= BLIND_SHARE:
        return "pictures are black: take the cap off, switch the light on or allow a longer exposure"
    if (sample > WHITE).mean() >= BLIND_SHARE:
        return "pictures are over-exposed: shorten the exposure or lower the gain"
    return ""


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


def _in_windows(image: GreyImage, detector: TagDetector, windows: Sequence[Window]) -> tuple[TagDetection, ...] | None:
    """Search the windows alone; None where the whole picture costs no more."""
    height, width = image.shape
    regions = merged([window.region for window in windows], (width, height))
    cells_px = [_smallest_cell_px(region, windows) for region in regions]
    costs = [
        _area(region) * (ENLARGED**2 if px < SMALL_CELL_PX else 1) for region, px in zip(regions, cells_px, strict=True)
    ]
    if sum(costs) > WHOLE_SHARE * width * height:
        return None
    return tuple(
        tag for region, px in zip(regions, cells_px, strict=True) for tag in _in_region(image, detector, region, px)
    )


def _in_region(image: GreyImage, detector: TagDetector, region: Region, cell_px: float) -> Iterator[TagDetection]:
    """Search one region, enlarged or shrunk as the smallest cells that are expected there ask for."""
    left, top, right, bottom = region
    # The detector takes a picture of its own: rows of a view would lie a whole picture's width apart.
    part, scale = image[top:bottom, left:right].copy(), 1
    if cell_px < SMALL_CELL_PX:
        larger = cv2.resize(part, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
        part, scale = np.asarray(larger, np.uint8), ENLARGED
    shrinking = next((by for by in SHRINKING if cell_px >= by * SHRUNK_CELL_PX), None)
    if shrinking is not None and isinstance(detector, SearchesCoarser):
        found = detector.detect_shrunk(part, shrinking)
    else:
        found = detector.detect(part)
    return (_placed(tag, scale, left, top) for tag in found)


def _smallest_cell_px(region: Region, windows: Sequence[Window]) -> float:
    """Return how small the cells of the tags are that are expected in a region; NaN where one is not known."""
    return float(np.min([_cell_px(window) for window in windows if _overlap(window.region, region)]))


def _cell_px(window: Window) -> float:
    """Return how small the cells of the window's tag are; NaN where that is not known."""
    return np.nan if window.key is None else window.side_px / _cells(window.key)


def _cells(key: TagKey) -> int:
    return CELLS_ACROSS.get(key.family, MOST_CELLS_ACROSS)


def _placed(tag: TagDetection, scale: int, left: int, top: int) -> TagDetection:
    """Return a tag found in a part of the picture that was enlarged ``scale`` times, where it is in the picture."""
    corner = np.array([left, top])
    # Enlarging keeps the outer rims of pixels in place, and the first pixel's centre is (0, 0).
    corners, (x, y) = (tag.corners_px + 0.5) / scale - 0.5 + corner, tag.centre_px
    centre = ((x + 0.5) / scale - 0.5 + left, (y + 0.5) / scale - 0.5 + top)
    return replace(tag, corners_px=corners, centre_px=centre)


def _refined(image: GreyImage, lens: Lens, tags: Sequence[TagDetection]) -> tuple[TagDetection, ...]:
    from camrig.geometry.refine_corners import refine_corners  # noqa: PLC0415 - loads numba; a stop must not wait for it

    cells = np.array([_cells(tag.key) for tag in tags], dtype=np.float64)
    found = refine_corners(image, lens, np.stack([tag.corners_px for tag in tags]), cells)
    return tuple(
        replace(tag, corners_px=corners_px, refined=tuple(refined))
        for tag, corners_px, refined in zip(tags, found.corners_px, found.refined.tolist(), strict=True)
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
