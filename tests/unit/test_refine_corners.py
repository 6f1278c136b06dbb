"""Corners refined through the lens: as good as promised on exact pictures, left alone where nothing tells better."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.corner_noise import tag_width_px
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.pose import transform
from camrig.geometry.refine_corners import MOST_MOVED_PX, MOST_MOVED_WIDTHS, RefinedCorners, refine_corners
from camrig.interfaces import TagDetector
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from camrig_emulators.tag_pictures import BLACK, WHITE, tag_cells
from tests.drawn_tags import SHARP, DrawnTag, Optics, draw_tag, random_pose
from tests.lenses import FISHEYE, LAB, PRISM, RATIONAL

AnyLens = BrownLens | FisheyeLens
CELLS = np.array([8.0])


def refined(tag: DrawnTag, lens: AnyLens, start_px: Array, cells: float = 8.0) -> RefinedCorners:
    return refine_corners(tag.image, lens, start_px[None], np.array([cells]))


def near(tag: DrawnTag, rng: np.random.Generator, off_px: float = 0.2) -> Array:
    """Return corners as wrong as a detector's may be."""
    return np.asarray(tag.corners_px + rng.normal(0.0, off_px, (4, 2)))


def drawn(lens: AnyLens, width_px: float, radius: float, seed: int, optics: Optics = SHARP) -> DrawnTag:
    """Draw a tag at the first place of its kind that is wholly in the picture."""
    rng = np.random.default_rng(seed)
    while (tag := draw_tag(lens, random_pose(lens, rng, width_px, radius), rng, optics=optics)) is None:
        pass
    return tag


def rms(errors: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))


@lru_cache(maxsize=1)
def detector() -> TagDetector:
    plugin = load_plugin("detectors", "pyapriltags")
    found: TagDetector = plugin.make(plugin.section())
    return found


def detected(tag: DrawnTag) -> Array:
    left, top, right, bottom = tag.region
    (found,) = detector().detect(np.ascontiguousarray(tag.image[top:bottom, left:right]))
    return np.asarray(found.corners_px + np.array([left, top]))


@pytest.mark.parametrize(("widths_px", "bar_px"), [((25.0, 40.0), 0.035), ((40.0, 90.0), 0.02), ((90.0, 130.0), 0.02)])
def test_a_detectors_corners_are_refined_at_any_angle_off_the_axis(
    widths_px: tuple[float, float], bar_px: float
) -> None:
    rng = np.random.default_rng(0)
    before, after = [], []
    for seed, radius in enumerate((0.05, 0.1, 0.2, 0.3, 0.35, 0.4, 0.5, 0.55, 0.6)):
        tag = drawn(LAB, rng.uniform(*widths_px), radius, seed)
        start = detected(tag)
        found = refined(tag, LAB, start)
        assert found.refined.all()
        before.append(start - tag.corners_px)
        after.append(found.corners_px[0] - tag.corners_px)
    assert rms(after) < bar_px
    assert rms(after) < 0.8 * rms(before)


@pytest.mark.parametrize("lens", [RATIONAL, PRISM, FISHEYE], ids=["rational", "prism", "fisheye"])
def test_the_bend_of_any_lens_is_taken_out(lens: AnyLens) -> None:
    rng = np.random.default_rng(1)
    errors = []
    for seed, radius in enumerate((0.1, 0.3, 0.45, 0.6)):
        tag = drawn(lens, 60.0, radius, seed)
        found = refined(tag, lens, near(tag, rng))
        assert found.refined.all()
        errors.append(found.corners_px[0] - tag.corners_px)
    assert rms(errors) < 0.02


def inverted(key: TagKey) -> GreyImage:
    """Return a tag of white border on black, as the standard families have them."""
    return np.asarray(WHITE + BLACK - tag_cells(key), dtype=np.uint8)


def double_bordered(key: TagKey) -> GreyImage:
    """Return a tag whose black border is two cells wide, as Kalibr's grids have them, in a quiet zone of one."""
    return np.pad(np.pad(tag_cells(key)[1:-1, 1:-1], 1, constant_values=BLACK), 1, constant_values=WHITE)


@pytest.mark.parametrize(
    ("cells", "across"), [(inverted(TagKey("tag36h11", 5)), 8.0), (double_bordered(TagKey("tag36h11", 5)), 8.0)]
)
def test_borders_of_either_sense_and_of_two_cells_are_refined(cells: GreyImage, across: float) -> None:
    rng = np.random.default_rng(2)
    tag = draw_tag(LAB, random_pose(LAB, rng, 55.0, 0.3), rng, cells=cells)
    assert tag is not None
    found = refined(tag, LAB, near(tag, rng), across)
    assert found.refined.all()
    assert rms([found.corners_px[0] - tag.corners_px]) < 0.03


def test_several_tags_are_refined_together_as_each_alone() -> None:
    tags = [drawn(LAB, width, radius, seed) for seed, (width, radius) in enumerate([(30.0, 0.1), (60.0, 0.5)])]
    rng = np.random.default_rng(3)
    image = np.where(tags[0].image == tags[0].image[0, 0], tags[1].image, tags[0].image)
    starts = np.stack([near(tag, rng) for tag in tags])
    found = refine_corners(image, LAB, starts, np.array([8.0, 8.0]))
    for k in range(2):
        alone = refine_corners(image, LAB, starts[k : k + 1], CELLS)
        np.testing.assert_allclose(found.corners_px[k], alone.corners_px[0], atol=1e-3)
    assert rms([found.corners_px[k] - tags[k].corners_px for k in range(2)]) < 0.03


def with_something_before(tag: DrawnTag, share: float) -> GreyImage:
    """Cover ``share`` of the edge from the first corner to the second, its middle part, by something grey."""
    first, second, third = tag.corners_px[0], tag.corners_px[1], tag.corners_px[2]
    y, x = np.mgrid[: tag.image.shape[0], : tag.image.shape[1]]
    apart = np.stack([x, y], axis=-1) - 0.5 * (first + second)
    along, inwards = second - first, third - second
    covered = (np.abs(apart @ along) < 0.5 * share * along @ along) & (
        np.abs(apart @ inwards) < 0.1 * inwards @ inwards
    )
    return np.where(covered, 60, tag.image).astype(np.uint8)


def test_an_edge_hidden_in_part_is_found_by_the_rest_of_it() -> None:
    tag = drawn(LAB, 80.0, 0.2, 4)
    found = refine_corners(with_something_before(tag, 0.2), LAB, tag.corners_px[None] + 0.2, CELLS)
    assert found.refined.all()
    assert np.abs(found.corners_px[0] - tag.corners_px).max() < 0.06


def test_the_corners_of_a_hidden_edge_stay_as_they_were() -> None:
    tag = drawn(LAB, 80.0, 0.2, 4)
    found = refine_corners(with_something_before(tag, 0.7), LAB, tag.corners_px[None] + 0.2, CELLS)
    assert found.refined[0].tolist() == [False, False, True, True]
    np.testing.assert_array_equal(found.corners_px[0, :2], tag.corners_px[:2] + 0.2)
    assert np.abs(found.corners_px[0, 2:] - tag.corners_px[2:]).max() < 0.06


def test_an_edge_out_of_the_picture_is_left_alone() -> None:
    tag = drawn(LAB, 60.0, 0.2, 5)
    *_, third, last = np.argsort(tag.corners_px[:, 0])
    end = int(tag.corners_px[third, 0])
    cut = BrownLens((end, 800), LAB.focal_px, LAB.centre_px, LAB.distortion[:5])
    found = refine_corners(np.ascontiguousarray(tag.image[:, :end]), cut, tag.corners_px[None], CELLS)
    assert not found.refined[0, [third, last]].any()
    np.testing.assert_array_equal(found.corners_px[0, last], tag.corners_px[last])


def test_a_shadow_across_a_tag_does_not_move_its_corners() -> None:
    tag = drawn(LAB, 60.0, 0.2, 6)
    image = tag.image.astype(float)
    image[:, : int(tag.corners_px[:, 0].mean())] *= 0.6
    found = refine_corners(image.astype(np.uint8), LAB, near(tag, np.random.default_rng(6))[None], CELLS)
    assert np.abs(found.corners_px[0] - tag.corners_px)[found.refined[0]].max() < 0.1
    assert found.refined.any()


@pytest.mark.parametrize("blurred_px", [1.5, 3.0, 8.0])
def test_motion_during_the_exposure_moves_no_corner_off_the_middle_of_the_way(blurred_px: float) -> None:
    lens = LAB
    rng = np.random.default_rng(7)
    T = random_pose(lens, rng, 70.0, 0.2)
    per_px_m = T[2, 3] / lens.focal_px[0]

    def moved(share: float) -> Array:
        return transform(T[:3, :3], T[:3, 3] + T[:3, 0] * share * blurred_px * per_px_m)

    tag = draw_tag(lens, T, rng, moved=moved)
    assert tag is not None
    start = near(tag, rng)
    found = refined(tag, lens, start)
    assert found.refined.all() == (blurred_px < 5.0)
    np.testing.assert_array_equal(found.corners_px[~found.refined], start[~found.refined[0]])
    assert np.abs(found.corners_px[0] - tag.corners_px)[found.refined[0]].max(initial=0.0) < 0.08


@pytest.mark.parametrize(
    ("width_px", "psf_px"), [(11.0, 0.7), (60.0, 3.0), (22.0, 1.6)], ids=["small cells", "out of focus", "both"]
)
def test_a_tag_that_shows_no_edges_stays_as_it_was(width_px: float, psf_px: float) -> None:
    tag = drawn(LAB, width_px, 0.2, 8, Optics(psf_px=psf_px))
    start = near(tag, np.random.default_rng(8))
    found = refined(tag, LAB, start)
    assert not found.refined.any()
    np.testing.assert_array_equal(found.corners_px[0], start)


def test_past_the_lenss_reach_nothing_is_refined() -> None:
    tag = drawn(LAB, 60.0, 0.4, 9)
    narrow = BrownLens(LAB.size_px, LAB.focal_px, LAB.centre_px, LAB.distortion[:5], r_max=0.3)
    found = refined(tag, narrow, tag.corners_px)
    assert not found.refined.any()
    np.testing.assert_array_equal(found.corners_px[0], tag.corners_px)


corner = st.tuples(st.floats(-60.0, 700.0), st.floats(-60.0, 540.0))


@settings(max_examples=60)
@given(st.lists(st.lists(corner, min_size=4, max_size=4), max_size=3), st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_whatever_is_given_stays_or_moves_as_far_as_is_believable(
    quads: list[list[tuple[float, float]]], seed: int, noise_grey: int
) -> None:
    lens = BrownLens((640, 480), (500.0, 500.0), (319.5, 239.5), (-0.3, 0.1, 0.0, 0.0))
    image = np.random.default_rng(seed).integers(0, noise_grey + 1, (480, 640), np.uint8)
    corners = np.array(quads, dtype=float).reshape(-1, 4, 2)
    found = refine_corners(image, lens, corners, np.full(len(quads), 8.0))
    moved = np.linalg.norm(found.corners_px - corners, axis=2)
    assert (moved[~found.refined] == 0.0).all()
    limit = MOST_MOVED_PX + MOST_MOVED_WIDTHS * tag_width_px(corners)[:, None]
    assert (moved <= limit + 1e-9).all()
