"""What a camera's worker does: where tags are expected, and twice a second in the whole picture, it looks for them."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import EndOfInput, LinkLost
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens
from camrig.messages import Expected, Level, TagDetection
from camrig.rig import TagKey
from camrig.runtime.camera_job import WHOLE_EVERY_S, CameraJob
from camrig.runtime.complaints import OVER_S
from camrig_drivers.apriltag.guards import require_raw
from camrig_emulators.fakes import FakeCamera
from tests.drawn_tags import draw_tag, random_pose

WHOLE = (480, 640)
GREY = np.full(WHOLE, 90, np.uint8)


LENS = BrownLens((640, 480), (600.0, 600.0), (320.0, 240.0))


@dataclass
class SeenPictures:
    """A detector that remembers the shape of every picture it was shown, and finds what it is told: in whole ones, and
    in parts. A side under 16 px it refuses, as all do.
    """

    shapes: list[tuple[int, ...]] = field(default_factory=list)
    in_whole: tuple[TagDetection, ...] = ()
    in_parts: tuple[TagDetection, ...] = ()

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        require_raw(image)
        self.shapes.append(image.shape)
        return self.in_whole if image.shape == WHOLE else self.in_parts


@dataclass
class Eye:
    """A camera's job under test, and what its detector saw."""

    job: CameraJob
    camera: FakeCamera
    detectors: list[SeenPictures]

    def look(self, *stamps_s: float, image: GreyImage = GREY) -> list[tuple[int, ...]]:
        """Take frames of these stamps; return the shapes of the pictures that were searched."""
        seen = self.detectors[-1].shapes
        seen.clear()
        for stamp_s in stamps_s:
            self.camera.push(image, stamp_s)
            self.job.turn()
        return list(seen)

    def said(self) -> list[str]:
        return [event.text for event in self.job.notes.take_all()]


@pytest.fixture
def eye(manual_clock: ManualClock) -> Eye:
    camera = FakeCamera("north", clock=manual_clock)
    detectors: list[SeenPictures] = []

    def make() -> SeenPictures:
        detectors.append(SeenPictures())
        return detectors[-1]

    job = CameraJob("north", camera, make, manual_clock, LENS)
    job.open()
    return Eye(job, camera, detectors)


REGIONS = ((100, 50, 164, 98), (300, 200, 340, 240))
KEYS = (TagKey("tag36h11", 1), TagKey("tag36h11", 2))


def expecting(from_s: float, until_s: float) -> Expected:
    edges_px = np.tile(np.array(REGIONS, dtype=np.float64), (3, 1, 1)) - [0.0, 0.0, 1.0, 1.0]
    return Expected("north", from_s, until_s, KEYS, edges_px, np.full(2, np.nan))


def tag(key: TagKey, x_px: float = 120.0) -> TagDetection:
    return TagDetection(
        key, np.array([[0.0, 30.0], [30.0, 30.0], [30.0, 0.0], [0.0, 0.0]]) + x_px, (x_px, 60.0), 0, 50.0
    )


def in_parts(shapes: list[tuple[int, ...]]) -> bool:
    """Tell whether only parts about as large as the regions were searched."""
    return len(shapes) == len(REGIONS) and all(height <= 64 and width <= 80 for height, width in shapes)


def test_without_expectations_the_whole_picture_is_searched(eye: Eye) -> None:
    assert eye.look(0.0, 0.1) == [WHOLE, WHOLE]
    found = eye.job.detections.take_all()
    assert [(detections.stamp_s, detections.whole) for detections in found] == [(0.0, True), (0.1, True)]
    assert (eye.job.frames, eye.job.whole_frames) == (2, 2)


def test_regions_are_searched_only_while_they_hold(eye: Eye) -> None:
    eye.look(0.0)
    eye.job.expected.put(expecting(0.10, 0.20))
    assert eye.look(0.05) == [WHOLE]
    assert in_parts(eye.look(0.10))
    assert in_parts(eye.look(0.20))
    assert eye.look(0.25) == [WHOLE]
    eye.job.expected.put(expecting(0.0, 9.0))
    assert in_parts(eye.look(0.3))
    eye.job.expected.clear()
    assert eye.look(0.35) == [WHOLE]


def test_the_whole_picture_is_searched_twice_a_second_whatever_is_expected(eye: Eye) -> None:
    eye.job.expected.put(expecting(-1.0, 99.0))
    whole = [stamp_s for k in range(41) for stamp_s in [0.05 * k] if WHOLE in eye.look(stamp_s)]
    assert whole == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    assert eye.job.whole_frames == 5
    assert eye.job.frames == 41
    assert WHOLE_EVERY_S == 0.5


def test_of_few_pictures_a_second_every_tenth_is_searched_whole(eye: Eye) -> None:
    eye.job.expected.put(expecting(-1.0, 99.0))
    whole = [k for k in range(31) if WHOLE in eye.look(0.4 * k)]
    assert whole == [0, 10, 20, 30]


def test_a_tag_that_is_missing_from_its_region_has_the_whole_of_that_picture_searched_once(eye: Eye) -> None:
    eye.detectors[-1].in_whole = eye.detectors[-1].in_parts = (tag(KEYS[0]),)
    eye.look(0.0)
    eye.job.expected.put(expecting(-1.0, 99.0))
    assert WHOLE not in eye.look(0.05)
    eye.detectors[-1].in_parts = ()
    assert eye.look(0.10)[-1] == WHOLE
    assert [found.key for found in eye.job.detections.take_all()[-1].tags] == [KEYS[0]]
    eye.detectors[-1].in_whole = ()
    assert eye.look(0.15)[-1] == WHOLE
    assert WHOLE not in eye.look(0.20, 0.25)


def test_a_tag_that_nobody_expects_is_no_reason_to_search_whole_pictures(eye: Eye) -> None:
    eye.detectors[-1].in_whole = (tag(TagKey("tag36h11", 99)),)
    eye.look(0.0)
    eye.job.expected.put(expecting(-1.0, 99.0))
    assert WHOLE not in eye.look(0.05, 0.10)


def test_the_same_number_twice_is_told_twice_each_with_its_place_and_counted(eye: Eye) -> None:
    eye.detectors[-1].in_whole = (tag(KEYS[0], 120.0), tag(KEYS[0], 400.0), tag(KEYS[1], 300.0))
    eye.look(0.0, 0.1)
    (found, _) = eye.job.detections.take_all()
    assert [each.centre_px[0] for each in found.tags if each.key == KEYS[0]] == [120.0, 400.0]
    assert eye.job.statistics()["repeated_tags"] == 2


BLACK, WHITE = np.full(WHOLE, 3, np.uint8), np.full(WHOLE, 255, np.uint8)


@pytest.mark.parametrize(
    ("image", "counted", "said"),
    [
        (BLACK, "blind_frames", "pictures are black"),
        (WHITE, "blind_frames", "pictures are over-exposed"),
        (GREY[:8], "unusable_frames", "pictures cannot be searched: a picture of 640x8 px is too small"),
        (GREY[:0], "unusable_frames", "pictures cannot be searched"),
        (np.zeros((480, 640, 3), np.uint8), "unusable_frames", "pictures cannot be searched"),
        (GREY.astype(np.float32), "unusable_frames", "pictures cannot be searched"),
    ],
    ids=["black", "white", "flat", "empty", "colour", "float"],
)
def test_pictures_that_show_nothing_are_counted_and_told_once_as_they_begin_and_end(
    eye: Eye, image: GreyImage, counted: str, said: str
) -> None:
    eye.job.expected.put(expecting(-1.0, 99.0))
    eye.look(*(0.1 * k for k in range(40)), image=image)
    (told,) = eye.said()
    assert told.startswith(said)
    assert eye.job.statistics()[counted] == eye.job.frames == 40
    assert eye.look(4.0 + OVER_S) == [WHOLE]
    assert eye.said() == [f"no longer so: {told}"]


def test_pictures_that_flicker_between_black_and_good_are_one_complaint(eye: Eye) -> None:
    for k in range(20):
        eye.look(0.1 * k, image=BLACK if k % 2 else GREY)
    assert len(eye.said()) == 1
    assert eye.job.statistics()["blind_frames"] == 10


@pytest.mark.parametrize("shape", [(480, 600), (300, 640), (240, 320), (960, 1280)], ids=str)
def test_pictures_of_another_size_than_the_lenss_are_counted_and_never_searched_where_tags_would_be_in_its_own(
    eye: Eye, shape: tuple[int, int]
) -> None:
    eye.look(0.0)
    eye.job.expected.put(expecting(-1.0, 99.0))
    assert eye.look(0.1, 0.2, image=np.full(shape, 90, np.uint8)) == [shape, shape]
    assert eye.job.statistics()["odd_sized_frames"] == 2
    assert [found.size_px for found in eye.job.detections.take_all()][1:] == [shape[::-1]] * 2


@pytest.mark.parametrize("refine", [True, False])
def test_corners_are_refined_through_the_lens_unless_that_is_not_wanted(eye: Eye, refine: bool) -> None:
    rng = np.random.default_rng(0)
    drawn = draw_tag(LENS, random_pose(LENS, rng, 60.0, 0.1), rng)
    assert drawn is not None
    eye.job.refine = refine
    eye.detectors[-1].in_whole = (replace(tag(KEYS[0]), corners_px=drawn.corners_px + 0.1),)
    eye.look(0.0, image=drawn.image)
    (found,) = eye.job.detections.take_all()[0].tags
    assert found.refined == (refine,) * 4


def test_a_camera_without_a_frame_detectsnothing(eye: Eye) -> None:
    eye.job.wake()
    eye.job.turn()
    assert eye.job.detections.take_all() == ()
    assert eye.job.frames == 0


def test_its_detector_outlives_a_lost_link(eye: Eye) -> None:
    eye.camera.faults.unplug()
    with pytest.raises(LinkLost):
        eye.job.turn()
    eye.job.close()
    eye.camera.faults.replug()
    eye.job.open()
    assert eye.look(1.0) == [WHOLE]
    assert len(eye.detectors) == 1


def test_what_a_frame_notes_is_told_once_as_it_begins_and_once_as_it_ends(eye: Eye) -> None:
    for note in ("", "light is missing", "light is missing", "", ""):
        eye.camera.push(GREY, 0.0, note)
        eye.job.turn()
    told = [(event.level, event.about, event.text) for event in eye.job.notes.take_all()]
    assert told == [
        (Level.WARNING, "north", "light is missing"),
        (Level.INFO, "north", "no longer so: light is missing"),
    ]


def test_the_end_of_a_recording_is_passed_on_after_its_last_frame(eye: Eye) -> None:
    eye.camera.push(GREY, 0.0)
    eye.camera.end()
    eye.job.turn()
    assert len(eye.job.detections.take_all()) == 1
    with pytest.raises(EndOfInput):
        eye.job.turn()


def test_a_camera_waiting_for_a_frame_can_be_woken(eye: Eye) -> None:
    waiter = threading.Thread(target=eye.job.turn)
    began_s = time.monotonic()
    waiter.start()
    eye.job.wake()
    waiter.join()
    assert time.monotonic() - began_s < 0.4  # its time-out is 0.5 s
