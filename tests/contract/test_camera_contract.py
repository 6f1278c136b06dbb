"""What every camera must do, whatever it is made of: one class, run on each.

A new camera joins by a function in ``CAMERAS`` that starts one of ``SIZE_PX`` with a given frame rate.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest

from camrig.clock import RealClock
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens
from camrig.interfaces import Camera
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.images import driver as images_driver
from camrig_emulators.fakes import FakeCamera
from camrig_emulators.frame_server import FrameGrid, FrameServer
from camrig_emulators.rendered_camera import driver as rendered_driver
from tests.v4l2_kernel import start_self_exposing

SIZE_PX = (64, 48)
SPEC = CameraSpec("cam", BrownLens(SIZE_PX, (60.0, 60.0), (31.5, 23.5)), FreeMount())
FAST_FPS = 100.0
SLOW_FPS = 0.02

StartCamera = Callable[[Path, float, ExitStack], Camera]


def picture(number: int) -> GreyImage:
    width, height = SIZE_PX
    return np.full((height, width), 40 + number % 100, np.uint8)


def start_images(folder: Path, fps: float, _stack: ExitStack) -> Camera:
    for number in range(5):
        cv2.imwrite(str(folder / f"{number}.png"), picture(number))
    section = images_driver.section(path=str(folder), fps=fps, loop=True)
    return images_driver.make({"cam": (SPEC, section)})["cam"]


def start_fake(_folder: Path, fps: float, _stack: ExitStack) -> Camera:
    return FakeCamera("cam", lambda _stamp_s: picture(0), fps=fps)


def start_rendered(folder: Path, fps: float, stack: ExitStack) -> Camera:
    exposure_s = min(0.004, 0.5 / fps)
    grid = FrameGrid(RealClock().now_s(), 1.0 / fps, exposure_s)
    server = FrameServer("cam", folder / "socket", grid, lambda _stamp_s, number: picture(number), RealClock())
    server.start()
    stack.callback(server.stop)
    section = rendered_driver.section(url=server.url, fps=fps)
    return rendered_driver.make({"cam": (SPEC, section)})["cam"]


def start_v4l2(_folder: Path, fps: float, stack: ExitStack) -> Camera:
    return start_self_exposing(SPEC, fps, stack)


CAMERAS: dict[str, StartCamera] = {
    "images": start_images,
    "fake": start_fake,
    "rendered": start_rendered,
    "v4l2": start_v4l2,
}


@pytest.fixture(params=sorted(CAMERAS))
def start(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Callable[[float], Camera]]:
    with ExitStack() as stack:

        def camera_at(fps: float) -> Camera:
            camera = CAMERAS[request.param](tmp_path, fps, stack)
            stack.callback(camera.close)
            return camera

        yield camera_at


def next_frame(camera: Camera) -> Frame:
    """Read on until a frame comes."""
    deadline_s = time.monotonic() + 5.0
    while time.monotonic() < deadline_s:
        if (frame := camera.read(0.5)) is not None:
            return frame
    raise AssertionError("no frame within 5 s")


class TestEveryCamera:
    def test_frames_are_raw_grey_pictures_of_the_lens_size(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        camera.open()
        frame = next_frame(camera)
        assert frame.camera_id == "cam"
        assert frame.image.shape == (SIZE_PX[1], SIZE_PX[0])
        assert frame.image.dtype == np.uint8
        assert frame.image.flags.c_contiguous

    def test_stamps_are_of_the_monotonic_clock_and_never_ahead_of_it(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        opened_s = time.monotonic()
        camera.open()
        for _ in range(4):
            frame = next_frame(camera)
            assert opened_s - 1.0 < frame.stamp_s <= time.monotonic()

    def test_stamps_and_sequence_numbers_ascend(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        camera.open()
        frames = [next_frame(camera) for _ in range(6)]
        assert all(np.diff([frame.stamp_s for frame in frames]) > 0.0)
        assert all(np.diff([frame.sequence for frame in frames]) >= 1)

    @pytest.mark.realtime
    def test_read_returns_none_when_its_time_is_up(self, start: Callable[[float], Camera]) -> None:
        camera = start(SLOW_FPS)
        camera.open()
        camera.read(0.1)  # the first frame may be there at once
        begun_s = time.monotonic()
        assert camera.read(0.1) is None
        assert 0.05 < time.monotonic() - begun_s < 2.0

    @pytest.mark.realtime
    def test_wake_ends_a_read_that_blocks(self, start: Callable[[float], Camera]) -> None:
        camera = start(SLOW_FPS)
        camera.open()
        camera.read(0.1)
        waker = threading.Timer(0.1, camera.wake)
        waker.start()
        begun_s = time.monotonic()
        assert camera.read(30.0) is None
        assert time.monotonic() - begun_s < 5.0
        waker.join()

    @pytest.mark.realtime
    def test_a_wake_before_the_read_is_not_lost(self, start: Callable[[float], Camera]) -> None:
        camera = start(SLOW_FPS)
        camera.open()
        camera.read(0.1)
        camera.wake()
        begun_s = time.monotonic()
        assert camera.read(30.0) is None
        assert time.monotonic() - begun_s < 5.0

    def test_close_may_be_called_twice_and_before_open(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        camera.close()
        camera.open()
        camera.close()
        camera.close()

    def test_a_closed_camera_can_be_opened_again(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        camera.open()
        first = next_frame(camera)
        camera.close()
        camera.open()
        assert next_frame(camera).stamp_s > first.stamp_s

    def test_wake_is_harmless_when_closed(self, start: Callable[[float], Camera]) -> None:
        camera = start(FAST_FPS)
        camera.wake()
        camera.open()
        next_frame(camera)
        camera.close()
        camera.wake()
