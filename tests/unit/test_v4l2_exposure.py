"""The exposure policy: motion stays sharp whatever the light, gain comes last, and missing light is said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.clock import ManualClock
from camrig.errors import HardwareError
from camrig.messages import Frame
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.exposure import SETTLE_FRAMES, Policy, Range, Setting, white_level
from tests.v4l2_control_bank import EXPOSURE, USUAL_CONTROLS, Control
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import MONOTONIC, FakeKernel, Habits, yuyv
from tests.wire.test_v4l2_camera import NOW_S, SPEC

POLICY = Policy(Range(1, 80), Range(0, 100, 5), 150.0)


def shown(setting: Setting, light: float) -> float:
    """What a sensor makes of it: white in proportion to light, time and gain, burnt out at 255."""
    return min(255.0, light * setting.exposure * (1.0 + setting.gain / 20.0))


@given(light=st.floats(0.01, 100.0), first=st.tuples(st.integers(1, 80), st.integers(0, 20)))
def test_any_light_ends_in_the_right_white_or_in_a_complaint(light: float, first: tuple[int, int]) -> None:
    setting = Setting(first[0], 5 * first[1])
    for _ in range(120):
        bright = shown(setting, light)
        later = POLICY.after(setting, bright)
        assert 1 <= later.exposure <= 80
        assert later.gain in range(0, 101, 5)
        if later.gain > setting.gain:
            assert setting.exposure == 80, "gain is noise: the time that the blur allows is used up first"
        setting = later
    bright = shown(setting, light)
    assert POLICY.after(setting, bright) == setting, "it comes to rest"
    told = POLICY.complaint(setting, bright)
    assert told.startswith("light is missing") == (light * 80 * 6 < 75.0)
    if told == "" and light < 100.0:
        assert 75.0 <= bright <= 225.0


def test_it_begins_with_all_the_light_that_the_blur_allows() -> None:
    assert POLICY.first() == Setting(80, 0)


@pytest.mark.parametrize(
    ("allowed", "value", "clipped"), [(Range(1, 80), 80.9, 80), (Range(0, 100, 5), 37.0, 35), (Range(3, 9, 3), 1.0, 3)]
)
def test_values_are_those_that_the_device_has(allowed: Range, value: float, clipped: int) -> None:
    assert allowed.clip(value) == clipped


def test_white_is_judged_by_the_bright_tenth() -> None:
    image = np.full((480, 640), 30, np.uint8)
    image[:, :40] = 255
    assert white_level(image) < 60.0
    image[:, :80] = 255
    assert white_level(image) == 255.0


BLUR = {"max_blur_px": 1.0, "speed_deg_s": 120.0}
"""60 px of focal length: 8 ms."""


def camera_on(kernel: FakeKernel, **section: object) -> V4l2Camera:
    kernel.clock = ManualClock(NOW_S)
    model = V4l2Section.model_validate({"device": "/dev/video0", "exposure": BLUR, **section})
    return V4l2Camera(SPEC, model, kernel.clock, Hub([kernel]))


def frames_of(camera: V4l2Camera, kernel: FakeKernel, grey: int, number: int = SETTLE_FRAMES) -> Frame:
    frame = None
    for _ in range(number):
        kernel.expose(yuyv(bytes([grey]) * (64 * 48), 64), NOW_S - 0.1, MONOTONIC)
        frame = camera.read(0.0)
    assert frame is not None
    return frame


def test_the_device_is_set_to_the_limit_and_followed_by_the_stamps() -> None:
    kernel = camera_at("/dev/video0", "usb-1")
    camera = camera_on(kernel)
    camera.open()
    assert kernel.controls.held("Auto Exposure") == 1
    assert kernel.controls.held("Exposure Time, Absolute") == 79
    assert kernel.controls.held("Gain") == 0
    frame = frames_of(camera, kernel, 150)
    assert frame.stamp_s == pytest.approx(NOW_S - 0.1 - 0.010 - 0.00395)
    frames_of(camera, kernel, 255)
    assert kernel.controls.held("Exposure Time, Absolute") == 46
    assert frames_of(camera, kernel, 150, 1).stamp_s == pytest.approx(NOW_S - 0.1 - 0.010 - 0.0023)
    camera.close()
    assert kernel.free


def test_missing_light_is_said_until_it_is_there_and_no_blur_is_bought_with_it() -> None:
    kernel = camera_at("/dev/video0", "usb-1")
    camera = camera_on(kernel)
    camera.open()
    assert frames_of(camera, kernel, 20).note == ""
    note = frames_of(camera, kernel, 20, 21 * SETTLE_FRAMES).note
    assert note.startswith("light is missing: white is at 20 of 150 with the highest gain and the longest exposure")
    assert "(7.9 ms)" in note
    assert kernel.controls.held("Exposure Time, Absolute") == 79
    assert kernel.controls.held("Gain") == 100
    assert frames_of(camera, kernel, 40).note == note, "its figures do not change with every picture"
    assert frames_of(camera, kernel, 150).note == ""
    camera.close()


def test_gain_has_a_limit_of_its_own() -> None:
    kernel = camera_at("/dev/video0", "usb-1")
    camera = camera_on(kernel, exposure={**BLUR, "max_gain": 22})
    camera.open()
    assert "light is missing" in frames_of(camera, kernel, 20, 10 * SETTLE_FRAMES).note
    assert kernel.controls.held("Gain") == 20
    camera.close()


def test_after_a_replug_it_begins_anew() -> None:
    kernel = camera_at("/dev/video0", "usb-1")
    kernel.first = yuyv(bytes([150]) * (64 * 48), 64)
    camera = camera_on(kernel)
    camera.open()
    frames_of(camera, kernel, 255, 2 * SETTLE_FRAMES)
    camera.close()
    kernel.unplug()
    kernel.replug()
    camera.open()
    assert kernel.controls.held("Exposure Time, Absolute") == 79
    camera.close()


def test_a_limit_that_the_device_cannot_keep_is_refused_with_what_it_can() -> None:
    kernel = camera_at("/dev/video0", "usb-1", habits=Habits(controls=(Control(EXPOSURE, "Exposure", 1, 50, 5000),)))
    camera = camera_on(kernel, exposure={"max_blur_px": 0.1, "speed_deg_s": 120.0})
    with pytest.raises(HardwareError, match=r"exposes for 5\.0 ms at least, .* allows 0\.80 ms; allow more blur"):
        camera.open()
    assert kernel.free


def test_a_device_without_an_exposure_time_is_refused() -> None:
    without = tuple(control for control in USUAL_CONTROLS if control.id != EXPOSURE)
    camera = camera_on(camera_at("/dev/video0", "usb-1", habits=Habits(controls=without)))
    with pytest.raises(HardwareError, match="has no exposure time that can be set; take `exposure` out"):
        camera.open()
