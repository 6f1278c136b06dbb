"""Looking only where tags are expected: the regions themselves, and that a region shows what the picture shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.detect import MIN_SIDE_PX, WHOLE_SHARE, detect_tags, merged
from camrig.geometry.arrays import Array, GreyImage
from camrig.interfaces import TagDetector
from camrig.messages import Frame, Region, TagDetection, TagDetections
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from camrig_emulators.tag_pictures import tag_texture

SIZE_PX = (640, 480)
FINE = 4
"""Tags are drawn in pixels so much smaller, then averaged."""
TEXELS = 16


# --- regions --------------------------------------------------------------------------------------------------


def regions(width: int, height: int) -> st.SearchStrategy[list[Region]]:
    across, down = st.integers(-60, width + 60), st.integers(-60, height + 60)
    return st.lists(st.tuples(across, down, across, down), max_size=12)


sizes = st.tuples(st.integers(16, 700), st.integers(16, 500))
anywhere = sizes.flatmap(lambda size: st.tuples(regions(*size), st.just(size)))


def inside(region: Region, size_px: tuple[int, int]) -> Region:
    return max(0, region[0]), max(0, region[1]), min(size_px[0], region[2]), min(size_px[1], region[3])


def holds(outer: Region, inner: Region) -> bool:
    return outer[0] <= inner[0] and outer[1] <= inner[1] and outer[2] >= inner[2] and outer[3] >= inner[3]


@given(anywhere)
def test_every_region_lies_whole_in_one_of_the_merged(given_and_size: tuple[list[Region], tuple[int, int]]) -> None:
    given_regions, size_px = given_and_size
    found = merged(given_regions, size_px)
    for region in given_regions:
        left, top, right, bottom = shown = inside(region, size_px)
        if left < right and top < bottom:
            assert any(holds(outer, shown) for outer in found)


@given(anywhere)
def test_merged_regions_are_disjoint_in_the_picture_and_large_enough(
    given_and_size: tuple[list[Region], tuple[int, int]],
) -> None:
    given_regions, (width, height) = given_and_size
    found = merged(given_regions, (width, height))
    for left, top, right, bottom in found:
        assert holds((0, 0, width, height), (left, top, right, bottom))
        assert right - left >= min(MIN_SIDE_PX, width)
        assert bottom - top >= min(MIN_SIDE_PX, height)
    for a, b in combinations(found, 2):
        assert a[0] >= b[2] or b[0] >= a[2] or a[1] >= b[3] or b[1] >= a[3]


@given(anywhere.flatmap(lambda case: st.tuples(st.just(case), st.permutations(case[0]))))
def test_neither_order_nor_merging_again_changes_the_regions(
    case: tuple[tuple[list[Region], tuple[int, int]], list[Region]],
) -> None:
    (given_regions, size_px), shuffled = case
    found = sorted(merged(given_regions, size_px))
    assert sorted(merged(shuffled, size_px)) == found
    assert sorted(merged(found, size_px)) == found


def test_regions_outside_the_picture_are_none() -> None:
    assert merged([(-50, 10, 0, 90), (10, 480, 90, 500), (90, 10, 90, 40)], SIZE_PX) == ()


# --- what is searched -----------------------------------------------------------------------------------------


@dataclass
class Watched:
    """A detector that finds nothing and remembers what it was given."""

    images: list[GreyImage] = field(default_factory=list)

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        self.images.append(image)
        return ()


def searched(given_regions: Sequence[Region] | None) -> tuple[TagDetections, list[GreyImage]]:
    width, height = SIZE_PX
    frame = Frame("c", np.zeros((height, width), np.uint8), 1.0, 7)
    detector = Watched()
    return detect_tags(frame, detector, lambda: 0.0, given_regions), detector.images


def test_without_regions_the_whole_picture_is_searched() -> None:
    found, images = searched(None)
    assert found.whole
    assert [image.shape for image in images] == [(480, 640)]


def test_only_the_regions_are_searched_each_as_a_picture_of_its_own() -> None:
    found, images = searched([(8, 16, 72, 80), (400, 200, 480, 280)])
    assert not found.whole
    assert found.size_px == SIZE_PX
    assert sorted(image.shape for image in images) == [(64, 64), (80, 80)]
    assert all(image.flags.c_contiguous for image in images)


def test_no_regions_mean_that_nothing_is_searched() -> None:
    found, images = searched([])
    assert not found.whole
    assert found.tags == ()
    assert images == []


@pytest.mark.parametrize(("share", "whole"), [(WHOLE_SHARE - 0.05, False), (WHOLE_SHARE + 0.05, True)])
def test_regions_that_cover_much_of_the_picture_give_way_to_all_of_it(share: float, whole: bool) -> None:
    width, height = SIZE_PX
    found, images = searched([(0, 0, round(share * width), height)])
    assert found.whole is whole
    assert (images[0].shape == (height, width)) is whole


# --- what is found --------------------------------------------------------------------------------------------


def drawn(rng: np.random.Generator, count: int) -> tuple[GreyImage, list[Array]]:
    """Return a noisy picture of ``count`` tags, turned and in perspective, and their (4, 2) corners."""
    width, height = SIZE_PX
    picture = np.full((height * FINE, width * FINE), 120.0, np.float32)
    quads: list[Array] = []
    places = [(x, y) for x in (110, 320, 530) for y in (120, 360)]
    for number, place in enumerate(places[:count]):
        side = rng.uniform(25.0, 80.0)
        turn = rng.uniform(0.0, 2.0 * np.pi) + 0.5 * np.pi * np.arange(4)
        square = 0.707 * side * np.column_stack([np.cos(turn), -np.sin(turn)])
        quad = square + rng.uniform(-0.12, 0.12, (4, 2)) * side + place + rng.uniform(-40.0, 40.0, 2)
        paint(picture, quad, TagKey("tag36h11", number))
        quads.append(quad)
    small = cv2.resize(picture, SIZE_PX, interpolation=cv2.INTER_AREA)
    noisy = cv2.GaussianBlur(small, (0, 0), 0.7) + rng.normal(0.0, 3.0, small.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), quads


def paint(picture: np.ndarray, quad: Array, key: TagKey) -> None:
    """Lay a tag with its rim over the finely drawn picture; ``quad`` are its corners p0..p3 in coarse pixels."""
    texture = tag_texture(key, TEXELS).astype(np.float32)
    low, high = TEXELS - 0.5, len(texture) - TEXELS - 0.5
    corners = np.array([[low, high], [high, high], [high, low], [low, low]], np.float32)
    H = cv2.getPerspectiveTransform(corners, ((quad + 0.5) * FINE - 0.5).astype(np.float32))
    size = picture.shape[1], picture.shape[0]
    cv2.warpPerspective(texture, H, size, dst=picture, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)


def around(quad: Array, rng: np.random.Generator) -> Region:
    """Return a region that holds a tag, its rim, and 8 to 16 px more on every side."""
    rim = quad.mean(axis=0) + 1.25 * (quad - quad.mean(axis=0))
    low, high = rim.min(axis=0) - rng.uniform(8.0, 16.0, 2), rim.max(axis=0) + rng.uniform(8.0, 16.0, 2)
    return int(low[0]), int(low[1]), int(high[0]) + 1, int(high[1]) + 1


def detector_of(decimate: float) -> TagDetector:
    plugin = load_plugin("detectors", "pyapriltags")
    detector: TagDetector = plugin.make(plugin.section(decimate=decimate, families=("tag36h11",)))
    return detector


@pytest.mark.parametrize("decimate", [1.0, 2.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_tag_in_a_region_is_found_where_it_is_in_the_whole_picture(decimate: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, quads = drawn(rng, 6)
    frame, detector = Frame("c", image, 1.0, 7), detector_of(decimate)
    whole = {tag.key: tag for tag in detect_tags(frame, detector, lambda: 0.0).tags}
    part = detect_tags(frame, detector, lambda: 0.0, [around(quad, rng) for quad in quads])
    assert not part.whole
    assert sorted(tag.key for tag in part.tags) == sorted(whole)
    assert len(whole) == len(quads)
    for tag in part.tags:
        np.testing.assert_allclose(tag.corners_px, whole[tag.key].corners_px, atol=0.01)
        np.testing.assert_allclose(tag.centre_px, whole[tag.key].centre_px, atol=0.01)
        np.testing.assert_allclose(tag.corners_px, quads[tag.key.id], atol=1.0)


def test_a_tag_outside_the_regions_is_not_found() -> None:
    rng = np.random.default_rng(3)
    image, quads = drawn(rng, 4)
    part = detect_tags(Frame("c", image, 1.0, 7), detector_of(1.0), lambda: 0.0, [around(quads[2], rng)])
    assert [tag.key.id for tag in part.tags] == [2]
