"""The V4L2 driver against a kernel of bytes: negotiation, streaming, counting, unplugging."""

import errno
import logging
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from camrig.clock import ManualClock, RealClock
from camrig.errors import HardwareError, LinkLost
from camrig.geometry.lens import BrownLens
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.port import KernelPort
from camrig_drivers.v4l2.stream import BUFFERS
from camrig_drivers.v4l2.trouble import explain, holders
from tests.v4l2_control_bank import Control
from tests.v4l2_kernel import (
    COPY,
    DQBUF,
    ERROR,
    MONOTONIC,
    PATH,
    QBUF,
    REQBUFS,
    S_FMT,
    START_OF_EXPOSURE,
    STREAMON,
    FakeKernel,
    Habits,
    yuyv,
)

SIZE_PX = (64, 48)
NOW_S = 1000.0
SPEC = CameraSpec("north", BrownLens(SIZE_PX, (60.0, 60.0), (31.5, 23.5)), FreeMount(), readout_s=0.02)
MANUAL: dict[str, bool | int | str] = {"auto_exposure": "manual", "exposure_time_absolute": 100}


def luma(number: int) -> bytes:
    """A picture of which every line differs."""
    return bytes((number + line) % 256 for line in range(48) for _ in range(64))


def picture(number: int) -> bytes:
    return yuyv(luma(number), 64)


def camera_on(kernel: FakeKernel, **section: object) -> V4l2Camera:
    model = V4l2Section.model_validate({"device": PATH, **section})
    kernel.clock = kernel.clock or ManualClock(NOW_S)
    return V4l2Camera(SPEC, model, kernel.clock, kernel)


def waiting_camera_on(kernel: FakeKernel) -> V4l2Camera:
    """A camera whose reads wait in real time."""
    return V4l2Camera(SPEC, V4l2Section(device=PATH), RealClock(), kernel)


@pytest.fixture
def kernel() -> FakeKernel:
    return FakeKernel()


@pytest.fixture
def camera(kernel: FakeKernel) -> Iterator[V4l2Camera]:
    camera = camera_on(kernel)
    camera.open()
    yield camera
    camera.close()
    assert kernel.free


def frame_of(camera: V4l2Camera) -> Frame:
    frame = camera.read(0.0)
    assert frame is not None
    return frame


def refused(kernel: FakeKernel, **section: object) -> str:
    """Open a camera in vain; return what the user is told."""
    camera = camera_on(kernel, **section)
    with pytest.raises(HardwareError) as caught:
        camera.open()
    assert kernel.free, "what was opened must be released"
    camera.close()
    assert caught.type is HardwareError, caught.value
    return str(caught.value)


class TestNegotiation:
    def test_size_format_and_rate_are_asked_and_told(self, caplog: pytest.LogCaptureFixture) -> None:
        kernel = FakeKernel()
        with caplog.at_level(logging.INFO, "camrig_drivers"):
            camera = camera_on(kernel, fps=15)
            camera.open()
        camera.close()
        assert caplog.messages[0] == (
            f"camera north: {PATH} is Test Camera at usb-1.2: 64x48 YUYV at 15 fps (asked: 15 fps)"
        )
        assert caplog.records[0].levelno == logging.INFO

    def test_another_rate_is_warned_of(self, kernel: FakeKernel, caplog: pytest.LogCaptureFixture) -> None:
        camera = camera_on(kernel, fps=60)
        camera.open()
        camera.close()
        assert "at 30 fps (asked: 60 fps)" in caplog.messages[0]
        assert caplog.records[0].levelno == logging.WARNING

    def test_a_device_without_rates_is_used_all_the_same(self, caplog: pytest.LogCaptureFixture) -> None:
        camera = camera_on(FakeKernel(Habits(knows_rates=False)), fps=30)
        camera.open()
        camera.close()
        assert "at a rate it does not tell (asked: 30 fps)" in caplog.messages[0]

    def test_another_size_is_refused_with_what_there_is(self) -> None:
        told = refused(FakeKernel(Habits(formats={"YUYV": ((640, 480), (320, 240)), "MJPG": ((640, 480),)})))
        assert "was asked for 64x48 YUYV and gives 640x480 YUYV" in told
        assert "it offers YUYV 640x480, 320x240; MJPG 640x480" in told

    def test_another_format_is_refused_with_what_there_is(self, kernel: FakeKernel) -> None:
        told = refused(kernel, format="GREY")
        assert "was asked for 64x48 GREY and gives 64x48 YUYV; it offers YUYV 64x48, 32x24; MJPG 64x48" in told

    def test_metadata_nodes_are_no_cameras(self) -> None:
        assert "gives no pictures" in refused(FakeKernel(Habits(device_capabilities=0x04A00000)))

    def test_interlaced_pictures_are_refused(self) -> None:
        assert "interlaced" in refused(FakeKernel(Habits(picture_field=4)))

    def test_buffers_too_small_for_the_picture_are_refused(self) -> None:
        assert "buffers of 6143 bytes" in refused(FakeKernel(Habits(lost_bytes=1)))


class TestStreaming:
    @pytest.mark.parametrize("padding_bytes", [0, 64])
    def test_the_luma_of_yuyv_arrives(self, padding_bytes: int) -> None:
        kernel = FakeKernel(Habits(padding_bytes=padding_bytes))
        camera = camera_on(kernel)
        camera.open()
        kernel.expose(yuyv(luma(7), 64, padding_bytes), NOW_S - 0.1)
        assert frame_of(camera).image.tobytes() == luma(7)
        camera.close()

    @pytest.mark.parametrize(("pixels", "more"), [("GREY", b""), ("NV12", bytes(64 * 24))])
    def test_grey_and_nv12_arrive(self, pixels: str, more: bytes) -> None:
        kernel = FakeKernel(Habits(formats={pixels: (SIZE_PX,)}))
        camera = camera_on(kernel, format=pixels)
        camera.open()
        kernel.expose(luma(9) + more, NOW_S - 0.1)
        assert frame_of(camera).image.tobytes() == luma(9)
        camera.close()

    def test_jpegs_arrive_and_broken_ones_are_dropped_and_counted(self, kernel: FakeKernel) -> None:
        smooth = np.tile(np.arange(64, dtype=np.uint8), (48, 1))
        data = bytes(cv2.imencode(".jpg", smooth)[1])
        camera = camera_on(kernel, format="MJPG")
        camera.open()
        kernel.expose(data[: len(data) // 2], NOW_S - 0.2)
        assert camera.read(0.0) is None
        kernel.expose(data, NOW_S - 0.1)
        assert np.abs(frame_of(camera).image.astype(int) - smooth).max() <= 4
        assert (camera.counters.broken, camera.counters.read) == (1, 1)
        assert kernel.queued == BUFFERS
        camera.close()

    def test_the_newest_frame_wins_and_every_buffer_goes_back(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        for number in range(3):
            kernel.expose(picture(number), NOW_S - 1.0 + 0.1 * number)
        frame = frame_of(camera)
        assert (frame.sequence, frame.image.tobytes()) == (2, luma(2))
        assert camera.counters.skipped == 2
        assert kernel.queued == BUFFERS
        assert camera.read(0.0) is None

    def test_frames_flagged_as_wrong_are_dropped_and_counted(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        kernel.expose(picture(1), NOW_S - 0.3)
        kernel.expose(picture(2), NOW_S - 0.2, MONOTONIC | ERROR)
        assert frame_of(camera).sequence == 0
        kernel.expose(picture(3), NOW_S - 0.1, MONOTONIC | ERROR)
        assert camera.read(0.0) is None
        assert (camera.counters.flagged, camera.counters.missed) == (2, 0)
        assert kernel.queued == BUFFERS

    def test_a_frame_that_is_too_short_is_dropped(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        kernel.expose(picture(1)[:-2], NOW_S - 0.2)
        assert camera.read(0.0) is None
        assert camera.counters.broken == 1
        assert kernel.queued == BUFFERS

    def test_gaps_in_the_sequence_are_counted(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        for lost in (0, 3, 0, 1):
            kernel.expose(picture(0), NOW_S - 0.1, lost=lost)
            frame_of(camera)
        assert camera.counters.missed == 4

    def test_a_full_queue_loses_frames_and_the_gap_shows_it(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        accepted = [kernel.expose(picture(number), NOW_S - 0.1) for number in range(BUFFERS + 3)]
        assert accepted == [True] * BUFFERS + [False] * 3
        frame_of(camera)
        kernel.expose(picture(9), NOW_S - 0.05)
        assert frame_of(camera).sequence == BUFFERS + 3
        assert (camera.counters.missed, camera.counters.skipped) == (3, BUFFERS - 1)

    def test_a_sequence_that_wraps_is_no_gap(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        kernel.count_from(2**32 - 1)
        for _ in range(3):
            kernel.expose(picture(0), NOW_S - 0.1)
            frame_of(camera)
        assert camera.counters.missed == 0

    @pytest.mark.parametrize("first", [7, 6])
    def test_a_device_that_counts_anew_or_not_at_all_shows_no_gap(
        self, kernel: FakeKernel, camera: V4l2Camera, first: int
    ) -> None:
        kernel.count_from(7)
        kernel.expose(picture(0), NOW_S - 0.2)
        frame_of(camera)
        kernel.count_from(first)
        kernel.expose(picture(1), NOW_S - 0.1)
        assert frame_of(camera).sequence == first
        assert camera.counters.missed == 0

    def test_a_device_that_makes_another_number_of_buffers_streams(self) -> None:
        kernel = FakeKernel(Habits(buffers=2))
        camera = camera_on(kernel)
        camera.open()
        for number in range(5):
            kernel.expose(picture(number), NOW_S - 0.1)
            assert frame_of(camera).image.tobytes() == luma(number)
        camera.close()


class TestStamps:
    def stamp(self, flags: int, buffer_s: float = NOW_S - 0.1, **section: object) -> tuple[float, bool]:
        kernel = FakeKernel()
        camera = camera_on(kernel, **section)
        camera.open()
        kernel.expose(picture(0), buffer_s, flags)
        frame = frame_of(camera)
        camera.close()
        return round(frame.stamp_s, 6), frame.stamp_known

    def test_start_of_exposure(self) -> None:
        flags = MONOTONIC | START_OF_EXPOSURE
        assert self.stamp(flags, controls=MANUAL) == (NOW_S - 0.1 + 0.010 + 0.005, True)

    def test_end_of_frame(self) -> None:
        assert self.stamp(MONOTONIC, controls=MANUAL) == (NOW_S - 0.1 - 0.010 - 0.005, True)

    def test_an_exposure_that_the_device_chooses_is_unknown(self) -> None:
        assert self.stamp(MONOTONIC) == (NOW_S - 0.1 - 0.010, False)

    def test_the_exposure_of_the_section_counts_where_the_device_tells_none(self) -> None:
        assert self.stamp(MONOTONIC, exposure_s=0.004) == (NOW_S - 0.1 - 0.012, True)

    def test_what_the_device_holds_goes_before_the_section(self) -> None:
        assert self.stamp(MONOTONIC, controls=MANUAL, exposure_s=0.004) == (NOW_S - 0.1 - 0.015, True)

    def test_a_stamp_of_another_clock_is_replaced_and_said(self) -> None:
        assert self.stamp(COPY, buffer_s=1.7e9, controls=MANUAL) == (NOW_S - 0.015, False)

    def test_a_device_with_an_exposure_but_no_mode_tells_it(self) -> None:
        kernel = FakeKernel(Habits(controls=(Control(0x9A0902, "Exposure", 1, 1, 5000, value=40),)))
        camera = camera_on(kernel)
        camera.open()
        kernel.expose(picture(0), NOW_S - 0.1)
        frame = frame_of(camera)
        camera.close()
        assert (round(frame.stamp_s, 6), frame.stamp_known) == (NOW_S - 0.1 - 0.012, True)


class TestWaiting:
    def test_read_gives_up_when_its_time_is_up(self, kernel: FakeKernel) -> None:
        camera = waiting_camera_on(kernel)
        camera.open()
        begun_s = time.monotonic()
        assert camera.read(0.05) is None
        assert time.monotonic() - begun_s >= 0.05
        camera.close()

    def test_wake_ends_a_blocked_read(self, kernel: FakeKernel) -> None:
        camera = waiting_camera_on(kernel)
        camera.open()
        results: list[Frame | None] = []
        reader = threading.Thread(target=lambda: results.append(camera.read(60.0)))
        reader.start()
        camera.wake()
        reader.join(5.0)
        assert results == [None]
        camera.close()

    def test_a_wake_goes_before_a_frame_and_counts_once(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        kernel.expose(picture(1), NOW_S - 0.1)
        camera.wake()
        camera.wake()
        assert camera.read(0.0) is None
        assert frame_of(camera).sequence == 0

    def test_wake_and_close_from_two_threads_end_well(self, kernel: FakeKernel) -> None:
        """A late wake must not write into a descriptor that has been closed, or is another's by now."""
        camera = camera_on(kernel)
        stopping = threading.Event()

        def wake_on() -> None:
            while not stopping.is_set():
                camera.wake()

        waker = threading.Thread(target=wake_on)
        waker.start()
        try:
            for _ in range(500):
                camera.open()
                camera.close()
        finally:
            stopping.set()
            waker.join()


class TestTrouble:
    def lost(self, act: Callable[[], object]) -> str:
        with pytest.raises(LinkLost) as caught:
            act()
        return str(caught.value)

    def test_unplugged_while_a_read_blocks(self, kernel: FakeKernel) -> None:
        camera = waiting_camera_on(kernel)
        camera.open()
        unplug = threading.Timer(0.05, kernel.unplug)
        unplug.start()
        assert "was unplugged" in self.lost(lambda: camera.read(60.0))
        unplug.join()
        camera.close()
        assert kernel.free

    def test_a_fault_without_an_error_is_a_lost_link_and_no_busy_loop(self, kernel: FakeKernel) -> None:
        camera = camera_on(kernel)
        camera.open()
        kernel.fail(errno.EAGAIN)
        assert "has stopped streaming" in self.lost(lambda: camera.read(0.0))
        camera.close()

    @pytest.mark.parametrize(("request_number", "error"), [(DQBUF, errno.EIO), (QBUF, errno.EINVAL)])
    def test_errors_while_streaming_are_lost_links(self, kernel: FakeKernel, request_number: int, error: int) -> None:
        camera = camera_on(kernel)
        camera.open()
        kernel.expose(picture(0), NOW_S - 0.1)
        kernel.faults[request_number] = error
        assert errno.errorcode[error] in self.lost(lambda: camera.read(0.0))
        camera.close()
        kernel.faults.clear()
        kernel.first = picture(4)
        camera.open()
        kernel.expose(picture(5), NOW_S - 0.1)
        assert frame_of(camera).image.tobytes() == luma(5)
        camera.close()

    @pytest.mark.parametrize("request_number", [S_FMT, REQBUFS, QBUF, STREAMON])
    def test_an_error_while_opening_releases_everything(self, kernel: FakeKernel, request_number: int) -> None:
        camera = camera_on(kernel)
        kernel.faults[request_number] = errno.EIO
        assert "EIO" in self.lost(camera.open)
        assert kernel.free
        assert "is not open" in self.lost(lambda: camera.read(0.0))
        kernel.faults.clear()
        camera.open()
        camera.close()

    def test_a_replugged_camera_gets_everything_set_again(self, kernel: FakeKernel) -> None:
        camera = camera_on(kernel, fps=15, controls={**MANUAL, "brightness": 12})
        camera.open()
        kernel.unplug()
        self.lost(lambda: camera.read(0.0))
        camera.close()
        assert "does not exist" in self.lost(camera.open)
        kernel.replug()
        assert kernel.controls.held("Brightness") == 0
        kernel.first = picture(2)
        camera.open()
        assert kernel.controls.held("Brightness") == 12
        assert kernel.controls.held("Exposure Time, Absolute") == 100
        assert kernel.fps == 15
        kernel.expose(picture(3), NOW_S - 0.1)
        assert frame_of(camera).sequence == 1
        camera.close()

    def test_counters_begin_anew_with_every_open(self, kernel: FakeKernel, camera: V4l2Camera) -> None:
        kernel.expose(picture(0), NOW_S - 0.1)
        frame_of(camera)
        camera.close()
        assert camera.counters.read == 1
        camera.open()
        assert camera.counters.read == 0

    def test_a_camera_in_use_is_said(self, kernel: FakeKernel) -> None:
        kernel.holder = True
        assert "is in use by another program; stop that first" in self.lost(camera_on(kernel).open)
        assert kernel.free

    def test_no_bandwidth_is_said(self, kernel: FakeKernel) -> None:
        kernel.faults[STREAMON] = errno.ENOSPC
        assert "no bandwidth left on its USB bus" in self.lost(camera_on(kernel).open)

    def test_closing_before_opening_and_twice(self, kernel: FakeKernel) -> None:
        camera = camera_on(kernel)
        camera.close()
        camera.wake()
        camera.open()
        camera.open()
        camera.close()
        camera.close()
        assert kernel.free


class TestRealPaths:
    """The real port, on paths that are no cameras."""

    def told(self, device: Path | str) -> str:
        camera = V4l2Camera(SPEC, V4l2Section(device=str(device)), RealClock(), KernelPort())
        with pytest.raises(HardwareError) as caught:
            camera.open()
        return str(caught.value)

    def test_no_such_device(self, tmp_path: Path) -> None:
        assert "does not exist; check the cable" in self.told(tmp_path / "video9")

    @pytest.mark.parametrize("device", ["/dev/null", "/tmp"])
    def test_what_is_no_camera(self, device: str) -> None:
        assert self.told(device).startswith(f"camera north: {device} is no V4L2 camera")

    def test_no_permission_names_the_group_that_has_it(self, tmp_path: Path) -> None:
        node = tmp_path / "video0"
        node.touch()
        told = explain("camera north: it", str(node), PermissionError(errno.EACCES, "Permission denied"))
        assert str(told).endswith(f"add the user to the group {node.group()} and log in again")
        nowhere = explain("camera north: it", "/no/such", PermissionError(errno.EACCES, "Permission denied"))
        assert "add the user to the group video" in str(nowhere)

    def test_the_program_that_holds_a_device_is_named(self, tmp_path: Path) -> None:
        node = tmp_path / "video0"
        node.touch()
        with node.open() as file, subprocess.Popen(["sleep", "60"], stdin=file) as other:
            assert holders(str(node)) == [f"sleep (pid {other.pid})"]
            other.kill()
        assert holders(str(node)) == []
