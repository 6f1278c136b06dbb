"""What a camera's worker does: where tags are expected, and twice a second in the whole picture, it looks for them."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import EndOfInput, LinkLost
from camrig.geometry.arrays import GreyImage
from camrig.messages import Expected, Level, TagDetection
from camrig.runtime.camera_job import WHOLE_EVERY_S, CameraJob
from camrig_emulators.fakes import FakeCamera

WHOLE = (480, 640)


@dataclass
class SeenPictures:
    """A detector that finds nothing and remembers the shape of every picture it was shown."""

    shapes: list[tuple[int, ...]] = field(default_factory=list)

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        self.shapes.append(image.shape)
        return ()


@dataclass
class Eye:
    """A camera's job under test, and what its detector saw."""

    job: CameraJob
    camera: FakeCamera
    detectors: list[SeenPictures]

    def look(self, *stamps_s: float) -> list[tuple[int, ...]]:
        """Take frames of these stamps; return the shapes of the pictures that were searched."""
        seen = self.detectors[-1].shapes
        seen.clear()
        for stamp_s in stamps_s:
            self.camera.push(np.zeros(WHOLE, np.uint8), stamp_s)
            self.job.turn()
        return list(seen)


@pytest.fixture
def eye(manual_clock: ManualClock) -> Eye:
    camera = FakeCamera("north", clock=manual_clock)
    detectors: list[SeenPictures] = []

    def make() -> SeenPictures:
        detectors.append(SeenPictures())
        return detectors[-1]

    job = CameraJob("north", camera, make, manual_clock)
    job.open()
    return Eye(job, camera, detectors)


REGIONS = ((100, 50, 164, 98), (300, 200, 340, 240))


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
    eye.job.expected.put(Expected("north", 0.10, 0.20, REGIONS))
    assert eye.look(0.05) == [WHOLE]
    assert in_parts(eye.look(0.10))
    assert in_parts(eye.look(0.20))
    assert eye.look(0.25) == [WHOLE]
    eye.job.expected.put(Expected("north", 0.0, 9.0, REGIONS))
    assert in_parts(eye.look(0.3))
    eye.job.expected.clear()
    assert eye.look(0.35) == [WHOLE]


def test_the_whole_picture_is_searched_twice_a_second_whatever_is_expected(eye: Eye) -> None:
    eye.job.expected.put(Expected("north", -1.0, 99.0, REGIONS))
    whole = [stamp_s for k in range(41) for stamp_s in [0.05 * k] if WHOLE in eye.look(stamp_s)]
    assert whole == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    assert eye.job.whole_frames == 5
    assert eye.job.frames == 41
    assert WHOLE_EVERY_S == 0.5


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
        eye.camera.push(np.zeros(WHOLE, np.uint8), 0.0, note)
        eye.job.turn()
    told = [(event.level, event.about, event.text) for event in eye.job.notes.take_all()]
    assert told == [
        (Level.WARNING, "north", "light is missing"),
        (Level.INFO, "north", "no longer so: light is missing"),
    ]


def test_the_end_of_a_recording_is_passed_on_after_its_last_frame(eye: Eye) -> None:
    eye.camera.push(np.zeros(WHOLE, np.uint8), 0.0)
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
