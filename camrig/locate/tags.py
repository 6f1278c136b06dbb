"""Sorting one picture's tags: whose they are, which can be used, and which of two with one number is meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.corner_noise import tag_width_px
from camrig.geometry.lens import Lens
from camrig.geometry.lens.errors import error_slopes
from camrig.geometry.pnp import TAG_CORNERS, ImagePoints, observe_tags
from camrig.geometry.pose import apply
from camrig.messages import TagDetection
from camrig.rig import Rig, TagKey

MIN_WIDTH_PX = 6.0
"""A tag has 8 cells and more across: what is smaller than this was never read."""

CELL = 1.0 / 8.0
"""A corner that could not be refined and lies within the tag's white rim of the picture's edge is a guess of the
detector's, pixels off: the edge cuts the tag.
"""


@dataclass(frozen=True, slots=True, eq=False)
class TagOwner:
    """What carries a listed tag: a target, or the room (``target_id`` None, an anchor)."""

    target_id: str | None
    T_owner_tag: Transform
    size_m: float

    @property
    def corners_m(self) -> Array:
        """The (4, 3) corners p0..p3 in the owner's frame."""
        return apply(self.T_owner_tag, self.size_m * TAG_CORNERS)


@dataclass(frozen=True, slots=True, eq=False)
class SeenTag:
    """A listed tag in the picture: its owner, its width, its four corners, undistorted and weighed, and how (4, 2, 4)
    these, whitened, move with the lens's errors (geometry.lens.errors).
    """

    detection: TagDetection
    owner: TagOwner
    width_px: float
    corners_m: Array
    points: ImagePoints
    lens_slopes: Array

    @property
    def key(self) -> TagKey:
        return self.detection.key


@lru_cache(maxsize=4)
def owners(rig: Rig) -> dict[TagKey, TagOwner]:
    """Return who carries each tag the rig lists."""
    found = {anchor.key: TagOwner(None, anchor.T_world_tag, anchor.size_m) for anchor in rig.anchors}
    for body in rig.targets.values():
        found |= {tag.key: TagOwner(body.id, tag.T_body_tag, tag.size_m) for tag in body.tags}
    return found


def undistorted(lens: Lens, listed: Sequence[tuple[TagDetection, TagOwner]]) -> tuple[SeenTag, ...]:
    """Undistort all corners in one go; leaves out tags too small to be real, those cut by the picture's edge, and any
    with a corner past ``r_max``.
    """
    if not listed:
        return ()
    corners_px = np.stack([detection.corners_px for detection, _ in listed])
    refined = np.array([detection.refined for detection, _ in listed])
    points = observe_tags(lens, corners_px, refined)
    width_px = tag_width_px(corners_px)
    usable = np.isfinite(points.ideal).all(axis=(1, 2)) & (width_px >= MIN_WIDTH_PX)
    usable &= ~cut_by_edge(corners_px, refined, width_px, lens.size_px)
    slopes = error_slopes(lens, points.ideal) / points.sigma_px[..., None, None]
    return tuple(
        SeenTag(detection, owner, float(width_px[k]), owner.corners_m, points.of(k), slopes[k])
        for k, (detection, owner) in enumerate(listed)
        if usable[k]
    )


def cut_by_edge(
    corners_px: Array, refined: npt.NDArray[np.bool_], width_px: Array, size_px: tuple[int, int]
) -> npt.NDArray[np.bool_]:
    """Tell (n,) which tags the picture's edge cuts: by (n, 4, 2) corners, whether these were refined, and widths."""
    inside_px = np.minimum(corners_px, np.array(size_px) - 1.0 - corners_px).min(axis=2)
    near = inside_px < CELL * width_px[:, None]
    return np.asarray((near & ~refined).any(axis=1) | (inside_px < 0.0).any(axis=1))


def without_repeats(
    tags: Sequence[SeenTag], predicted_px: Callable[[SeenTag], Array | None]
) -> tuple[tuple[SeenTag, ...], tuple[TagKey, ...]]:
    """Return the tags with at most one of each number, and the numbers that were there more than once.

    Of several the one is kept whose centre lies within its own width of where the tag is expected, if it is the only
    such one; ``predicted_px`` returns that place, (2,) pixels, or None where nothing is known. Else all are dropped.
    """
    counts = Counter(tag.key for tag in tags)
    repeated = tuple(key for key, count in counts.items() if count > 1)
    kept = [tag for tag in tags if counts[tag.key] == 1]
    for key in repeated:
        fitting = [tag for tag in tags if tag.key == key and _is_at(tag, predicted_px(tag))]
        kept.extend(fitting if len(fitting) == 1 else ())
    return tuple(kept), repeated


def _is_at(tag: SeenTag, expected_px: Array | None) -> bool:
    if expected_px is None:
        return False
    distance = np.linalg.norm(np.asarray(tag.detection.centre_px) - expected_px)
    return bool(distance <= tag.width_px)
