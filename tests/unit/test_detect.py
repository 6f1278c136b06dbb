"""Frame -> TagDetections, and the pose that ``camrig detect`` reports."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from camrig.cli.tag_pose import tag_pose
from camrig.detect import detect_tags, merged
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, difference, transform
from camrig.geometry.rotation import rotation_exp
from camrig.messages import Frame, TagDetection, Window
from camrig.rig import TagKey
from tests.drawn_tags import DrawnTag, draw_tag, random_pose

LENS = BrownLens((1280, 800), (828.0, 828.0), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0))
FACING = rotation_exp(np.array([np.pi, 0.0, 0.0]))
"""R_camera_tag of an upright tag that faces the camera."""


@dataclass
class Finds:
    """A detector that finds what it is told."""

    tags: tuple[TagDetection, ...]

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        del image
        return self.tags


def test_detections_carry_the_frames_identity_size_and_the_time_taken() -> None:
    tag = TagDetection(TagKey("tag36h11", 3), np.zeros((4, 2)), (0.0, 0.0), 0, 50.0)
    ticks = iter([10.0, 10.25])
    frame = Frame("north", np.zeros((48, 64), np.uint8), 7.5, 12, source="a.png")
    found = detect_tags(frame, Finds((tag,)), lambda: next(ticks))
    assert (found.camera_id, found.stamp_s, found.sequence, found.source) == ("north", 7.5, 12, "a.png")
    assert found.size_px == (64, 48)
    assert found.tags == (tag,)
    assert found.detect_s == 0.25


def near(tag: DrawnTag) -> TagDetection:
    """What a detector may say of a drawn tag."""
    corners = tag.corners_px + np.array([[0.2, 0.1], [-0.1, 0.2], [0.1, -0.2], [-0.2, 0.0]])
    return TagDetection(TagKey("tag36h11", 7), corners, (0.0, 0.0), 0, 60.0)


def drawn_tag() -> DrawnTag:
    rng = np.random.default_rng(0)
    tag = draw_tag(LENS, random_pose(LENS, rng, 50.0, 0.3), rng)
    assert tag is not None
    return tag


@pytest.mark.parametrize("in_regions", [False, True])
def test_with_the_cameras_lens_corners_are_refined_wherever_they_were_looked_for(in_regions: bool) -> None:
    tag = drawn_tag()
    found_there = near(tag)
    if in_regions:  # a detector that is shown a part of the picture counts from its corner
        found_there = replace(
            found_there, corners_px=found_there.corners_px - np.array(merged([tag.region], LENS.size_px)[0][:2])
        )
    frame = Frame("c", tag.image, 0.0, 0)
    (found,) = detect_tags(
        frame, Finds((found_there,)), lambda: 0.0, [Window(tag.region)] if in_regions else None, LENS
    ).tags
    assert found.refined == (True, True, True, True)
    assert np.abs(found.corners_px - tag.corners_px).max() < 0.06


def test_through_no_lens_or_one_for_another_size_corners_stay_the_detectors() -> None:
    tag = drawn_tag()
    frame, other = Frame("c", tag.image, 0.0, 0), BrownLens((640, 400), (414.0, 414.0), (320.0, 200.0))
    for lens in (None, other):
        (found,) = detect_tags(frame, Finds((near(tag),)), lambda: 0.0, lens=lens).tags
        assert found.refined == (False, False, False, False)
        np.testing.assert_array_equal(found.corners_px, near(tag).corners_px)


def test_the_pose_of_a_tilted_tag_is_found_through_a_distorting_lens_and_is_the_only_one() -> None:
    T_camera_tag = transform(rotation_exp(np.array([0.5, -0.4, 0.0])) @ FACING, np.array([0.2, -0.1, 1.5]))
    pose = tag_pose(LENS, LENS.project(apply(T_camera_tag, 0.16 * TAG_CORNERS)), 0.16)
    assert pose is not None
    np.testing.assert_allclose(difference(T_camera_tag, pose.T_camera_tag), 0.0, atol=1e-5)
    assert pose.alternatives == 0
    assert pose.sigma_m.shape == (3,)


def test_a_small_far_tag_seen_nearly_head_on_has_an_alternative() -> None:
    T_camera_tag = transform(rotation_exp(np.array([0.15, 0.0, 0.0])) @ FACING, np.array([0.0, 0.0, 5.0]))
    pose = tag_pose(LENS, LENS.project(apply(T_camera_tag, 0.12 * TAG_CORNERS)), 0.12)
    assert pose is not None
    assert pose.alternatives == 1


def test_the_sigma_of_the_position_is_what_noise_on_the_corners_does_to_it() -> None:
    T_camera_tag = transform(rotation_exp(np.array([0.5, -0.4, 0.0])) @ FACING, np.array([0.05, -0.05, 1.2]))
    corners = LENS.project(apply(T_camera_tag, 0.05 * TAG_CORNERS))
    width_px = np.linalg.norm(corners[0] - corners[1])
    rng = np.random.default_rng(2)
    sigma_px = max(0.06, 2.0 / float(width_px))  # the noise law of geometry.corner_noise; the lens's bend is tiny here
    poses = [tag_pose(LENS, corners + rng.normal(0.0, sigma_px, (4, 2)), 0.05) for _ in range(400)]
    found = np.array([pose.T_camera_tag[:3, 3] for pose in poses if pose is not None])
    expected = tag_pose(LENS, corners, 0.05)
    assert expected is not None
    np.testing.assert_allclose(found.std(axis=0), expected.sigma_m, rtol=0.25)


@pytest.mark.parametrize("corners", [np.zeros((4, 2)), np.array([[-9e5, 0.0], [0.0, 0.0], [0.0, 9e5], [5.0, 5.0]])])
def test_corners_that_are_no_square_before_the_lens_have_no_pose(corners: np.ndarray) -> None:
    assert tag_pose(LENS, corners, 0.16) is None
