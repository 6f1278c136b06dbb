"""What looking only where tags are expected saves, that it loses none, and what camrig costs beside the detector.

    pytest tests/benchmarks/test_detection_speed.py -m "slow or not slow" --benchmark-enable

Times are of the processor, both kinds on the same pictures and taking turns: ratios, on a machine shared with others.
"""

from __future__ import annotations

import mmap
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig.clock import ManualClock
from camrig.geometry.arrays import GreyImage
from camrig.host.detection import busy_picture
from camrig.interfaces import TagDetector
from camrig.messages import Expected, TagDetection, TagDetections
from camrig.pipeline.expect import expected
from camrig.plugins import load_plugin
from camrig.runtime.camera_job import CameraJob
from camrig_drivers.v4l2.grey import empty_picture, luma_layout
from camrig_emulators.fakes import FakeCamera
from tests.painted_room import KEYS, RIG, Follower, corners_at, picture_at
from tests.simulated_room import LENS

FPS = 30.0
LEAST_GAIN = 5.0
MOST_AROUND = 0.05


@dataclass
class Timed:
    """A detector that adds up its processor time."""

    detector: TagDetector
    spent_s: float = 0.0

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        return self._timed(lambda: self.detector.detect(image))

    def detect_shrunk(self, image: GreyImage, decimate: float) -> tuple[TagDetection, ...]:
        return self._timed(lambda: self.detector.detect_shrunk(image, decimate))  # type: ignore[attr-defined]

    def _timed(self, work: Callable[[], tuple[TagDetection, ...]]) -> tuple[TagDetection, ...]:
        begun_s = time.thread_time()
        found = work()
        self.spent_s += time.thread_time() - begun_s
        return found


@dataclass
class Bench:
    """A camera's job, frame by frame, with what the pipeline expects or with nothing."""

    clock: ManualClock
    detector: Timed = field(init=False)
    job: CameraJob = field(init=False)
    camera: FakeCamera = field(init=False)
    turn_s: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        plugin = load_plugin("detectors", "pyapriltags")
        self.detector = Timed(plugin.make(plugin.section(decimate=1.0)))
        self.camera = FakeCamera("wall", clock=self.clock)
        self.job = CameraJob("wall", self.camera, lambda: self.detector, self.clock, LENS)
        self.job.open()

    def take(self, image: GreyImage, stamp_s: float, told: Expected | None) -> TagDetections:
        if told is not None:
            self.job.expected.put(told)
        self.camera.push(image, stamp_s)
        begun_s = time.thread_time()
        self.job.turn()
        self.turn_s.append(time.thread_time() - begun_s)
        (found,) = self.job.detections.take_all()
        return found


def followed(frames: int, clock: ManualClock) -> tuple[Bench, Bench, int, int]:
    """Search ``frames`` pictures of moving tags in windows and whole; return both, how many tags whole pictures showed
    and how many of those the windows missed.
    """
    windows, whole, follower, rng = Bench(clock), Bench(clock), Follower(), np.random.default_rng(1)
    told: Expected | None = None
    shown = missed = 0
    ground = busy_picture()
    for number in range(frames):
        stamp_s = number / FPS
        image = picture_at(stamp_s, rng, ground)
        if number % 2:
            everything, found = whole.take(image, stamp_s, None), windows.take(image, stamp_s, told)
        else:
            found, everything = windows.take(image, stamp_s, told), whole.take(image, stamp_s, None)
        # Fetched by the next tick, so that the frame after the next is the first to know.
        _, news = follower.take(found, stamp_s + 0.02)
        told = next(iter(news), None) if news else told
        there = {tag.key for tag in found.tags}
        shown += len(everything.tags)
        missed += sum(tag.key not in there for tag in everything.tags)
        for tag in found.tags:
            error_px = tag.corners_px - corners_at(stamp_s)[KEYS.index(tag.key)]
            assert np.abs(error_px).max() < 0.5
    return windows, whole, shown, missed


@pytest.mark.slow
def test_looking_where_tags_are_expected_is_five_times_faster_and_loses_none(
    benchmark: BenchmarkFixture, manual_clock: ManualClock
) -> None:
    frames = 600
    windows, whole, shown, missed = benchmark.pedantic(  # type: ignore[no-untyped-call]
        lambda: followed(frames, manual_clock), rounds=1
    )
    gain = sum(whole.turn_s) / sum(windows.turn_s)
    benchmark.extra_info.update(
        gain=gain,
        frames=frames,
        tags=shown,
        missed=missed,
        whole_ms=1e3 * float(np.median(whole.turn_s)),
        windows_ms=1e3 * float(np.median(windows.turn_s)),
        whole_share=windows.job.whole_frames / frames,
    )
    assert (shown, missed) == (5 * frames, 0)
    assert gain >= LEAST_GAIN


def test_what_camrig_does_beside_detecting_takes_a_twentieth_of_it(
    benchmark: BenchmarkFixture, manual_clock: ManualClock
) -> None:
    frames = 40 if benchmark.enabled else 10
    windows, whole, follower, rng = Bench(manual_clock), Bench(manual_clock), Follower(), np.random.default_rng(2)
    layout = luma_layout("YUYV", LENS.size_px, 0)
    assert layout is not None
    buffer, grey = mmap.mmap(-1, 2 * 1280 * 720), empty_picture(LENS.size_px)
    told: Expected | None = None
    spent: dict[str, list[float]] = {"detector": [], "around whole": [], "around windows": [], "grey": [], "expect": []}
    for number in range(frames):
        stamp_s = number / FPS
        image = picture_at(stamp_s, rng)
        luma = layout.view(buffer)
        luma[:] = image
        begun_s = time.thread_time()
        layout.copy(luma, grey)
        spent["grey"].append(time.thread_time() - begun_s)
        for bench, name, places in ((whole, "whole", None), (windows, "windows", told)):
            bench.detector.spent_s = 0.0
            found = bench.take(image, stamp_s, places)
            if bench is whole:
                spent["detector"].append(bench.detector.spent_s)
            spent[f"around {name}"].append(bench.turn_s[-1] - bench.detector.spent_s)
        published, news = follower.take(found, stamp_s + 0.02)
        begun_s = time.thread_time()
        expected(follower.state, published.targets, RIG, stamp_s + 0.02)
        spent["expect"].append(time.thread_time() - begun_s)
        told = next(iter(news), None) if news else told
    usual = {name: float(np.median(times_s[5:])) for name, times_s in spent.items()}
    shares = {name: time_s / usual["detector"] for name, time_s in usual.items()}
    around = max(shares["around whole"], shares["around windows"]) + shares["grey"] + shares["expect"]
    benchmark.extra_info.update({name: round(share, 4) for name, share in shares.items()}, around=around)
    benchmark.extra_info["detector_ms"] = 1e3 * usual["detector"]
    benchmark.pedantic(lambda: None, rounds=1)  # type: ignore[no-untyped-call]
    assert around <= MOST_AROUND or benchmark.disabled
