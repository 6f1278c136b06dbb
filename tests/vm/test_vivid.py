"""The V4L2 driver on the real kernel's API: formats, rates, stamps and names of vivid's virtual cameras."""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from typing import get_args

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.errors import HardwareError
from camrig.messages import Frame
from camrig_drivers.v4l2 import V4l2Camera
from camrig_drivers.v4l2.discovery import discover
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.node import Node
from camrig_drivers.v4l2.offers import pixel_formats
from camrig_drivers.v4l2.stream import BUFFERS, Counters
from tests.vm.standstill import watched
from tests.vm.vivid import (
    COLOUR_BARS,
    END_OF_FRAME,
    FULL_RANGE,
    FULL_RATE_FPS,
    GRAY_RAMP,
    INSTANCES,
    NO_OSD,
    OSD,
    PATTERN,
    PLUGGED_IN,
    PORT,
    RUN_S,
    STAMPS,
    START_OF_EXPOSURE,
    bus,
    camera,
    frame_of,
    opened,
    path_of,
    tell,
)

PERIOD_S = 1.0 / FULL_RATE_FPS

pytestmark = [
    pytest.mark.vm,
    pytest.mark.v4l2,
    pytest.mark.skipif(not PLUGGED_IN, reason="no vivid device: these run in the VM"),
]


def test_every_format_that_holds_luma_gives_the_same_picture() -> None:
    """Of the others the section says which there are."""
    tell(0, PATTERN, GRAY_RAMP)
    tell(0, OSD, NO_OSD)
    node = Node(PORT, path_of(0))
    offered = pixel_formats(node)
    node.close()
    pictures: dict[str, np.ndarray] = {}
    for pixels in offered:
        if pixels not in get_args(PixelFormat):
            with pytest.raises(ValidationError, match="'YUYV', 'GREY', 'NV12'"):
                camera(format=pixels)
            continue
        with opened(camera(format=pixels)) as made:
            pictures[pixels] = frame_of(made).image.copy()
    tell(0, PATTERN, COLOUR_BARS)
    assert {"YUYV", "UYVY", "NV12", "GREY", "Y10", "Y16", "Y16-BE", "422P", "AYUV"} <= pictures.keys()
    studio = (pictures["YUYV"].astype(float) - 16.0) * 255.0 / 219.0
    for pixels, picture in pictures.items():
        assert int(picture.max()) - int(picture.min()) > 200, pixels
        full_range = pixels in FULL_RANGE
        levels = picture.astype(float) if full_range else (picture.astype(float) - 16.0) * 255.0 / 219.0
        assert np.abs(levels - studio).max() <= 3.0, pixels
    print(f"{len(pictures)} of {len(offered)} formats read: {', '.join(pictures)}")


def test_another_size_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        HardwareError, match=r"was asked for 600x400 YUYV and gives .*; it offers YUYV 320x180, 640x360"
    ):
        camera(0, (600, 400)).open()


def test_a_control_out_of_range_is_refused_with_its_range() -> None:
    with pytest.raises(HardwareError, match="control brightness is 999; allowed: 0 to 255"):
        camera(controls={"brightness": 999}).open()


def test_all_is_found_under_names_of_its_own() -> None:
    found = {each.facts["bus_info"]: each for each in discover() if each.title.startswith("vivid")}
    assert list(found) == [bus(instance) for instance in range(INSTANCES)]
    first = found[bus(0)]
    assert f"bus={bus(0)}" in str(first.facts["names"])
    assert first.size_px == (640, 480)
    assert first.section["format"] == "YUYV"
    assert first.trouble == ""
    assert "brightness" in str(first.facts["controls"])


@pytest.mark.slow  # and not where a run decides whether a change lands: an emulated computer may stand still unseen
@pytest.mark.realtime
def test_full_rate_goes_on_without_a_gap() -> None:
    """A gap of a computer that stood still is its host's, not the driver's: the run begins anew."""
    stood_still_s = []
    latest_s = time.monotonic() + RUN_S
    with opened(camera(0, (640, 480))) as made:
        while time.monotonic() <= latest_s:
            with watched() as standstills:
                for _ in range(2 * BUFFERS):  # starting to watch has held up the reader
                    frame_of(made)
                run, (before_s, after_s) = run_of(made)
            stood_still_s.append(standstills.longest_s)
            if not run.missed:
                break
            excuses = standstills.between(before_s - PERIOD_S, after_s + PERIOD_S, longer_s=0.5 * PERIOD_S)
            assert excuses, f"missed frames at {before_s} to {after_s} s while the computer was awake: {run}"
        else:
            pytest.skip(f"this host is too busy to judge: the emulated computer stood still for {stood_still_s} s")
    print(f"{FULL_RATE_FPS} fps for {RUN_S:.0f} s: {run}; it stood still for {stood_still_s} s at the longest")
    assert (run.flagged, run.broken) == (0, 0)
    assert run.read + run.skipped == pytest.approx(RUN_S * FULL_RATE_FPS, abs=FULL_RATE_FPS / 2)
    assert run.skipped <= 0.01 * run.read


def run_of(made: V4l2Camera) -> tuple[Counters, tuple[float, float]]:
    """Read for the time of a run, or until a frame is missed.

    Return what became of the frames of it alone, and the stamps of the last two: where one is missed, between them.
    """
    before = replace(made.counters)
    until_s = time.monotonic() + RUN_S
    last_s = (time.monotonic(), time.monotonic())
    while time.monotonic() < until_s and made.counters.missed == before.missed:
        last_s = (last_s[1], frame_of(made).stamp_s)
    counted = asdict(made.counters)
    return Counters(**{name: counted[name] - count for name, count in asdict(before).items()}), last_s


@pytest.mark.realtime
@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_both_kinds_of_stamp_mean_the_middle_of_the_exposure(readout_s: float) -> None:
    """vivid begins frame n at the start of the stream plus n periods, and ends it nine tenths of a period later.

    Its thread can be late and is never early: of many frames the earliest is the truth, and on a busy host it takes
    more of them.
    """
    exposed_s = 0.9 * PERIOD_S
    starts_s: dict[int, list[float]] = {START_OF_EXPOSURE: [], END_OF_FRAME: []}
    before_s = time.monotonic()
    made = camera(1, (320, 180), readout_s, exposure_s=exposed_s - readout_s)
    with opened(made), watched() as standstills:
        after_s = time.monotonic()
        for _ in range(6):
            for source, found_s in starts_s.items():
                tell(1, STAMPS, source)
                found_s += [
                    frame.stamp_s - frame.sequence * PERIOD_S - exposed_s / 2.0 for frame in ended_frames(made, 4)
                ]
            began_s, ended_s = (min(found_s) for found_s in starts_s.values())
            if abs(ended_s - began_s) <= 1e-3:
                break
    print(f"start of the stream by stamps of start and end: {1e6 * (ended_s - began_s):.0f} us apart")
    if abs(ended_s - began_s) > 1e-3 and standstills.longest_s > PERIOD_S / 2.0:
        pytest.skip(f"this host is too busy to judge: the computer stood still for {standstills.longest_s} s")
    assert before_s < began_s < after_s + PERIOD_S
    assert ended_s == pytest.approx(began_s, abs=1e-3)


def ended_frames(made: V4l2Camera, number: int) -> list[Frame]:
    """Take frames late: all buffers have filled, and the exposure of the newest has ended, as vivid counts it.

    vivid makes the stamp of an end before that end has come; such a one is rightly marked as not known.
    """
    frames: list[Frame] = []
    for take in range(10 * number):
        time.sleep((BUFFERS + 2) * PERIOD_S)
        frame = frame_of(made)
        if take >= 2 and frame.stamp_known:  # the first may be of the kind that was told before
            frames.append(frame)
        if len(frames) == number:
            break
    assert len(frames) == number, "stamps of ends that have come are known"
    return frames
