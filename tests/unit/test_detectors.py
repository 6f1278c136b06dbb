"""The detectors' sections, and what only one backend has."""

import sys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from camrig.errors import InputError
from camrig.messages import TagDetection
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from camrig_drivers.apriltag.edges import refine_corners
from camrig_drivers.apriltag.sections import HUGE_FAMILIES, OpencvSection, PupilSection, PyapriltagsSection


def tag(family: str = "tag36h11", *, hamming: int = 0, margin: float = 50.0) -> TagDetection:
    return TagDetection(TagKey(family, 1), np.zeros((4, 2)), (0.0, 0.0), hamming, margin)


def test_a_small_family_needs_a_larger_margin_than_a_large_one() -> None:
    section = PyapriltagsSection(families=("tag36h11", "tag16h5"))
    assert section.counts(tag("tag36h11", margin=20.0))
    assert not section.counts(tag("tag16h5", margin=20.0))
    assert section.counts(tag("tag16h5", margin=30.0))


def test_a_margin_that_is_given_counts_for_every_family() -> None:
    section = PyapriltagsSection(min_margin=15.0)
    assert section.counts(tag("tag16h5", margin=15.0))
    assert not section.counts(tag("tag36h11", margin=14.9))


def test_corrected_bits_count_only_where_allowed() -> None:
    assert not PyapriltagsSection().counts(tag(hamming=1))
    assert PyapriltagsSection(max_hamming=2).counts(tag(hamming=2))


@pytest.mark.parametrize("family", HUGE_FAMILIES)
def test_families_that_need_gigabytes_are_refused_by_name(family: str) -> None:
    with pytest.raises(ValidationError, match=f"{family} needs 3 GB"):
        PyapriltagsSection(families=(family,))


def test_pupil_refuses_several_families() -> None:
    with pytest.raises(ValidationError, match="silently loads one family of several"):
        PupilSection(families=("tag36h11", "tag25h9"))


@pytest.mark.parametrize("section", [PyapriltagsSection, PupilSection, OpencvSection])
@pytest.mark.parametrize(
    "wrong",
    [
        {"families": ()},
        {"families": ("tag36h11", "tag36h11")},
        {"decimate": 0.5},
        {"max_hamming": 3},
        {"min_margin": -1.0},
        {"min_margin": float("nan")},
        {"nthreads": 4},
    ],
)
def test_sections_refuse_what_is_out_of_range_or_unknown(section: type, wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        section(**wrong)


def test_only_opencv_has_border_bits() -> None:
    assert OpencvSection(border_bits=2).border_bits == 2
    with pytest.raises(ValidationError):
        OpencvSection.model_validate({"border_bits": 3})
    with pytest.raises(ValidationError):
        PyapriltagsSection.model_validate({"border_bits": 2})


def test_pupil_says_what_to_use_where_it_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pupil_apriltags", None)  # import raises ImportError
    plugin = load_plugin("detectors", "pupil")
    with pytest.raises(InputError, match=r"x86_64.*use pyapriltags"):
        plugin.make(plugin.section())


def test_opencv_reads_a_two_bit_border_and_its_corners_are_those_of_the_whole_square() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(cv2.aruco.generateImageMarker(dictionary, 8, 10, borderBits=2), 3, constant_values=255)
    image = np.kron(cells, np.ones((12, 12), np.uint8))  # the black square spans 36 to 156 px in both axes
    plugin = load_plugin("detectors", "opencv")
    (found,) = plugin.make(plugin.section(border_bits=2)).detect(image)
    assert found.key == TagKey("tag36h11", 8)
    low, high = 35.5, 155.5
    # OpenCV draws tags upside down: AprilTag's bottom-left is the picture's top-right.
    expected = [[high, low], [low, low], [low, high], [high, high]]
    np.testing.assert_allclose(found.corners_px, expected, atol=0.1)
    assert plugin.make(plugin.section(border_bits=1)).detect(image) == ()


@settings(max_examples=40, deadline=None)
@given(
    start_error_px=st.lists(st.floats(-3.0, 3.0), min_size=8, max_size=8),
    # Not along the pixel rows: four samples a pixel would draw such an edge up to an eighth of a pixel off its place.
    turn_rad=st.floats(0.05, 1.5),
    side_px=st.floats(50.0, 120.0),
)
def test_corners_are_refined_from_anywhere_within_half_a_cell(
    start_error_px: list[float], turn_rad: float, side_px: float
) -> None:
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side_px
    corners = square @ np.array([[c, s], [-s, c]]) + [100.2, 99.7]
    fine_px = (np.indices((800, 800))[::-1].reshape(2, -1).T + 0.5) / 4.0 - 0.5
    inside = (np.abs((fine_px - [100.2, 99.7]) @ np.array([[c, -s], [s, c]])) < side_px / 2.0).all(axis=1)
    sharp = np.round(255.0 * (1.0 - inside.reshape(200, 4, 200, 4).mean(axis=(1, 3)))).astype(np.uint8)
    image = np.asarray(cv2.GaussianBlur(sharp, (0, 0), 0.7), np.uint8)
    start = corners + np.reshape(start_error_px, (4, 2))
    refined = refine_corners(image, start, cell_px=side_px / 8.0)
    assert refined is not None
    np.testing.assert_allclose(refined, corners, atol=0.15)


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_nothing_is_refined_where_the_picture_shows_no_square(grey: int) -> None:
    corners = np.array([[10.0, 10.0], [50.0, 12.0], [48.0, 52.0], [9.0, 50.0]])
    assert refine_corners(np.full((60, 60), grey, np.uint8), corners, cell_px=5.0) is None
