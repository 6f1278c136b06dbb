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
from camrig.messages import Frame, Region, TagDetection, TagDetections, Window
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from tests.painted_room import FINE, paint

SIZE_PX = (640, 480)


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
    windows = None if given_regions is None else [Window(region) for region in given_regions]
    return detect_tags(frame, detector, lambda: 0.0, windows), detector.images


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
    part = detect_tags(frame, detector, lambda: 0.0, [Window(around(quad, rng)) for quad in quads])
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
    part = detect_tags(Frame("c", image, 1.0, 7), detector_of(1.0), lambda: 0.0, [Window(around(quads[2], rng))])
    assert [tag.key.id for tag in part.tags] == [2]


# --- what is expected decides how it is searched ---------------------------------------------------------------


def many_families() -> TagDetector:
    plugin = load_plugin("detectors", "pyapriltags")
    detector: TagDetector = plugin.make(plugin.section(families=("tag36h11", "tag25h9", "tag16h5")))
    return detector


def picture_of(rng: np.random.Generator, tags: Sequence[tuple[TagKey, float, tuple[float, float]]]) -> GreyImage:
    """Draw tags of the given sides about the given places."""
    picture = np.full((SIZE_PX[1] * FINE, SIZE_PX[0] * FINE), 120.0, np.float32)
    for key, side, place in tags:
        turn = rng.uniform(0.0, 2.0 * np.pi) + 0.5 * np.pi * np.arange(4)
        paint(picture, 0.7071 * side * np.column_stack([np.cos(turn), -np.sin(turn)]) + place, key)
    small = cv2.resize(picture, SIZE_PX, interpolation=cv2.INTER_AREA)
    noisy = cv2.GaussianBlur(small, (0, 0), 0.7) + rng.normal(0.0, 3.0, small.shape)
    return np.asarray(np.clip(noisy, 0, 255), np.uint8)


def window(key: TagKey, side: float, place: tuple[float, float], told: float | None = None) -> Window:
    reach = 0.9 * side + 8.0
    region = int(place[0] - reach), int(place[1] - reach), int(place[0] + reach), int(place[1] + reach)
    return Window(region, key, side if told is None else told)


def test_tags_of_several_families_and_sizes_are_found_in_windows_of_one_picture() -> None:
    tags = [
        (TagKey("tag36h11", 7), 14.0, (60.0, 60.0)),
        (TagKey("tag36h11", 8), 130.0, (470.0, 160.0)),
        (TagKey("tag25h9", 7), 45.0, (120.0, 300.0)),
        (TagKey("tag16h5", 7), 60.0, (450.0, 400.0)),
    ]
    image = picture_of(np.random.default_rng(4), tags)
    found = detect_tags(Frame("c", image, 1.0, 7), many_families(), lambda: 0.0, [window(*tag) for tag in tags])
    assert not found.whole
    places = {tag.key: tag.centre_px for tag in found.tags}
    assert places.keys() == {key for key, _, _ in tags}
    for key, _, place in tags:
        np.testing.assert_allclose(places[key], place, atol=0.5)


def test_two_tags_of_one_number_are_told_apart_by_their_places() -> None:
    key, places = TagKey("tag36h11", 7), [(150.0, 120.0), (480.0, 330.0)]
    frame = Frame("c", picture_of(np.random.default_rng(5), [(key, 50.0, place) for place in places]), 1.0, 7)
    for windows in (None, [window(key, 50.0, place) for place in places]):
        found = detect_tags(frame, detector_of(1.0), lambda: 0.0, windows)
        assert [tag.key for tag in found.tags] == [key, key]
        np.testing.assert_allclose(sorted(tag.centre_px for tag in found.tags), places, atol=0.5)


def test_more_small_tags_are_found_where_they_are_known_to_be_small_and_their_corners_are_right() -> None:
    rng = np.random.default_rng(6)
    places = [(x, y) for x in range(60, 600, 100) for y in range(80, 440, 150)]
    tags = [(TagKey("tag36h11", number), 13.0, (float(x), float(y))) for number, (x, y) in enumerate(places)]
    frame, detector = Frame("c", picture_of(rng, tags), 1.0, 7), detector_of(1.0)
    as_small = detect_tags(frame, detector, lambda: 0.0, [window(*tag) for tag in tags]).tags
    as_any = detect_tags(frame, detector, lambda: 0.0, [window(*tag, told=np.nan) for tag in tags]).tags
    assert len(as_small) > 2 * len(as_any) > 0
    for tag in as_small:
        np.testing.assert_allclose(tag.centre_px, places[tag.key.id], atol=0.5)
        np.testing.assert_allclose(np.linalg.norm(tag.corners_px - tag.centre_px, axis=1), 0.7071 * 13.0, atol=0.7)


@dataclass
class Coarse(Watched):
    """Remembers by how much it was to shrink pictures, too."""

    shrinking: list[float] = field(default_factory=list)

    def detect_shrunk(self, image: GreyImage, decimate: float) -> tuple[TagDetection, ...]:
        self.shrinking.append(decimate)
        return self.detect(image)


@pytest.mark.parametrize(
    ("side_px", "shrinking", "shape"),
    [
        (15.0, [], (96, 96)),
        (25.0, [], (48, 48)),
        (26.0, [2.0], (48, 48)),
        (39.0, [3.0], (48, 48)),
        (52.0, [4.0], (48, 48)),
    ],
)
def test_a_region_is_enlarged_or_shrunk_as_the_expected_size_asks_for(
    side_px: float, shrinking: list[float], shape: tuple[int, int]
) -> None:
    detector, key = Coarse(), TagKey("tag36h11", 1)
    frame = Frame("c", np.zeros((480, 640), np.uint8), 1.0, 7)
    detect_tags(frame, detector, lambda: 0.0, [Window((80, 80, 128, 128), key, side_px)])
    assert detector.shrinking == shrinking
    assert [image.shape for image in detector.images] == [shape]


def test_of_tags_that_share_a_region_the_smallest_decides_and_one_of_unknown_size_above_all() -> None:
    frame, keys = Frame("c", np.zeros((480, 640), np.uint8), 1.0, 7), [TagKey("tag36h11", k) for k in range(2)]
    for other, shrinking in ((34.0, [2.0]), (np.nan, [])):
        detector = Coarse()
        windows = [Window((80, 80, 160, 160), keys[0], 90.0), Window((120, 120, 200, 200), keys[1], other)]
        detect_tags(frame, detector, lambda: 0.0, windows)
        assert detector.shrinking == shrinking
        assert len(detector.images) == 1


def test_a_wanted_tag_that_is_in_no_window_is_looked_for_in_the_whole_picture() -> None:
    rng = np.random.default_rng(3)
    image, quads = drawn(rng, 4)
    frame, windows = Frame("c", image, 1.0, 7), [Window(around(quads[2], rng), TagKey("tag36h11", 2), 25.0)]
    found = detect_tags(frame, detector_of(1.0), lambda: 0.0, windows, wanted=[TagKey("tag36h11", 3)])
    assert found.whole
    assert sorted(tag.key.id for tag in found.tags) == [0, 1, 2, 3]
