"""A camera that comes back: under another number, as another camera, with what it had forgotten, or not at all."""

from __future__ import annotations

import errno
from collections.abc import Callable

import pytest

from camrig.clock import ManualClock
from camrig.errors import HardwareError, LinkLoss, LinkLost
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.camera import START_S
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import DQBUF, ERROR, MONOTONIC, QBUF, FakeKernel, Habits
from tests.wire.test_v4l2_camera import NOW_S, SPEC, frame_of, luma, picture

NODE, OTHER = "/dev/video0", "/dev/video1"


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(NOW_S)


@pytest.fixture
def kernel(clock: ManualClock) -> FakeKernel:
    return plugged(NODE, "usb-1", clock)


def plugged(node: str, bus_info: str, clock: ManualClock) -> FakeKernel:
    kernel = camera_at(node, bus_info)
    kernel.clock, kernel.first = clock, picture(0)
    return kernel


def camera_on(port: Hub, clock: ManualClock, device: str = NODE, **section: object) -> V4l2Camera:
    return V4l2Camera(SPEC, V4l2Section.model_validate({"device": device, **section}), clock, port)


def lost(act: Callable[[], object]) -> LinkLost:
    with pytest.raises(LinkLost) as caught:
        act()
    return caught.value


def unplugged(camera: V4l2Camera, kernel: FakeKernel) -> None:
    kernel.unplug()
    assert lost(lambda: camera.read(0.0)).loss is LinkLoss.ABSENT
    camera.close()
    assert lost(camera.open).loss is LinkLoss.ABSENT


class TestIdentity:
    @pytest.mark.parametrize(
        ("device", "serial"), [(NODE, "A1"), (NODE, ""), ("serial=A1", "A1"), ("bus=usb-1", ""), ("bus=usb-1", "A1")]
    )
    def test_the_camera_is_found_again_under_another_number(
        self, clock: ManualClock, kernel: FakeKernel, device: str, serial: str
    ) -> None:
        kernel.serial = serial
        camera = camera_on(Hub([kernel]), clock, device)
        camera.open()
        unplugged(camera, kernel)
        kernel.path = OTHER
        kernel.replug()
        camera.open()
        kernel.expose(picture(5), clock.now_s())
        assert frame_of(camera).image.tobytes() == luma(5)
        camera.close()
        assert kernel.free

    def test_by_serial_it_is_found_in_another_socket(self, clock: ManualClock, kernel: FakeKernel) -> None:
        kernel.serial = "A1"
        camera = camera_on(Hub([kernel]), clock)
        camera.open()
        unplugged(camera, kernel)
        kernel.path, kernel.bus_info = OTHER, b"usb-7"
        kernel.replug()
        camera.open()
        camera.close()

    def test_another_camera_under_its_number_is_not_taken_for_it(self, clock: ManualClock, kernel: FakeKernel) -> None:
        stranger = plugged(NODE, "usb-2", clock)
        stranger.unplug()
        camera = camera_on(Hub([kernel, stranger]), clock)
        camera.open()
        unplugged(camera, kernel)
        stranger.replug()
        error = lost(camera.open)
        assert error.loss is LinkLoss.ABSENT
        assert "is now another camera (Test Camera at usb-2), and Test Camera at usb-1 is not plugged in" in str(error)
        kernel.path = OTHER
        kernel.replug()
        camera.open()
        assert kernel.streaming
        assert not stranger.streaming
        camera.close()
        assert stranger.free

    def test_who_is_not_there_is_told_who_is(self, clock: ManualClock, kernel: FakeKernel) -> None:
        assert "serial=B2 is not plugged in; those that are: none" in str(
            lost(camera_on(Hub([kernel]), clock, "serial=B2").open)
        )
        kernel.serial = "A1"
        assert "those that are: A1" in str(lost(camera_on(Hub([kernel]), clock, "serial=B2").open))
        assert "those that are: usb-1" in str(lost(camera_on(Hub([kernel]), clock, "bus=usb-9").open))
        assert kernel.free

    def test_a_camera_that_may_hide_behind_a_refusal_is_not_said_to_be_absent(
        self, clock: ManualClock, kernel: FakeKernel
    ) -> None:
        error = lost(camera_on(Hub([kernel], denied={NODE}), clock, "bus=usb-1").open)
        assert error.loss is LinkLoss.DENIED
        assert f"{NODE} may not be opened by this user; add the user to the group" in str(error)

    def test_what_comes_back_with_another_format_is_waited_out(self, clock: ManualClock, kernel: FakeKernel) -> None:
        """The rig goes on without it: at the first start it would have been refused."""
        camera = camera_on(Hub([kernel]), clock)
        camera.open()
        unplugged(camera, kernel)
        usual, kernel.habits = kernel.habits, Habits(formats={"YUYV": ((32, 24),)})
        kernel.replug()
        error = lost(camera.open)
        assert error.loss is LinkLoss.CHANGED
        assert "was asked for 64x48 YUYV and gives 32x24 YUYV" in str(error)
        kernel.habits = usual
        camera.open()
        camera.close()
        kernel.habits = Habits(formats={"YUYV": ((32, 24),)})
        with pytest.raises(HardwareError) as caught:
            camera_on(Hub([kernel]), clock).open()
        assert not isinstance(caught.value, LinkLost)

    def test_what_is_first_plugged_in_late_and_is_wrong_does_not_end_a_rig_at_work(
        self, clock: ManualClock, kernel: FakeKernel
    ) -> None:
        kernel.unplug()
        camera = camera_on(Hub([kernel]), clock)
        assert lost(camera.open).loss is LinkLoss.ABSENT
        kernel.habits = Habits(formats={"YUYV": ((32, 24),)})
        kernel.replug()
        assert lost(camera.open).loss is LinkLoss.CHANGED


class TestLocks:
    def test_automatic_modes_go_off_and_what_they_had_found_is_held_over_a_replug(
        self, clock: ManualClock, kernel: FakeKernel
    ) -> None:
        camera = camera_on(Hub([kernel]), clock, lock=["exposure", "focus", "gain", "white_balance"])
        kernel.controls.preset("Exposure Time, Absolute", 333)
        camera.open()
        assert kernel.controls.held("Auto Exposure") == 1
        assert kernel.controls.held("Focus, Automatic Continuous") == 0
        unplugged(camera, kernel)
        kernel.replug()
        assert kernel.controls.held("Exposure Time, Absolute") == 156
        camera.open()
        assert kernel.controls.held("Auto Exposure") == 1
        assert kernel.controls.held("Exposure Time, Absolute") == 333
        camera.close()

    def test_what_is_set_by_name_goes_before_what_was_found(self, clock: ManualClock, kernel: FakeKernel) -> None:
        camera = camera_on(Hub([kernel]), clock, lock=["exposure"], controls={"exposure_time_absolute": 50})
        camera.open()
        assert kernel.controls.values_set == [("Auto Exposure", 1), ("Exposure Time, Absolute", 50)]
        camera.close()

    def test_a_camera_without_automatic_modes_has_nothing_to_lock(self, clock: ManualClock) -> None:
        kernel = plugged(NODE, "usb-1", clock)
        kernel.controls.controls = ()
        camera = camera_on(Hub([kernel]), clock, lock=["exposure", "focus"])
        camera.open()
        camera.close()


class TestStalls:
    def test_a_camera_that_falls_silent_is_lost_within_its_time(self, clock: ManualClock, kernel: FakeKernel) -> None:
        camera = camera_on(Hub([kernel]), clock, stall_s=0.7)
        camera.open()
        frame_of(camera)
        assert camera.read(0.5) is None
        error = lost(lambda: camera.read(0.5))
        assert error.loss is LinkLoss.STALLED
        assert clock.now_s() == pytest.approx(NOW_S + 0.7)
        assert "has stalled: it is open and delivers no good picture (1 frames read" in str(error)
        camera.close()

    def test_a_slow_camera_gets_ten_of_its_periods(self, clock: ManualClock) -> None:
        kernel = plugged(NODE, "usb-1", clock)
        kernel.habits.rates_fps = (2,)
        kernel.replug()
        camera = camera_on(Hub([kernel]), clock, stall_s=0.7)
        camera.open()
        frame_of(camera)
        assert camera.read(4.9) is None
        assert lost(lambda: camera.read(0.2)).loss is LinkLoss.STALLED
        camera.close()

    def test_the_first_picture_may_take_longer(self, clock: ManualClock, kernel: FakeKernel) -> None:
        kernel.first = None
        camera = camera_on(Hub([kernel]), clock)
        camera.open()
        assert camera.read(START_S - 0.1) is None
        kernel.expose(picture(3), clock.now_s())
        frame_of(camera)
        camera.close()

    def test_pictures_that_are_all_wrong_are_none(self, clock: ManualClock, kernel: FakeKernel) -> None:
        camera = camera_on(Hub([kernel]), clock)
        camera.open()
        frame_of(camera)

        def read_wrong_ones() -> None:
            for _ in range(20):
                kernel.expose(picture(1), clock.now_s(), MONOTONIC | ERROR)
                camera.read(0.1)
                clock.advance(0.1)

        error = lost(read_wrong_ones)
        assert error.loss is LinkLoss.STALLED
        assert "0 missed, 6 flagged as wrong" in str(error)
        camera.close()

    def test_it_is_back_when_pictures_are(self, clock: ManualClock, kernel: FakeKernel) -> None:
        """A device that opens and stays silent would be lost and found once a second."""
        camera = camera_on(Hub([kernel]), clock)
        camera.open()
        frame_of(camera)
        assert lost(lambda: camera.read(9.0)).loss is LinkLoss.STALLED
        camera.close()
        kernel.first = None
        for _ in range(2):
            assert lost(camera.open).loss is LinkLoss.STALLED
            assert kernel.free
        kernel.first = picture(0)
        camera.open()
        kernel.expose(picture(1), clock.now_s())
        frame_of(camera)
        camera.close()


@pytest.mark.parametrize(
    ("request_number", "error", "loss", "says"),
    [
        (DQBUF, errno.EIO, LinkLoss.FAILED, "failed with EIO (Input/output error) at VIDIOC_DQBUF"),
        (QBUF, errno.EINVAL, LinkLoss.FAILED, "failed with EINVAL (Invalid argument) at VIDIOC_QBUF"),
        (DQBUF, errno.ENODEV, LinkLoss.ABSENT, "was unplugged"),
    ],
)
def test_errors_while_streaming_have_names(
    clock: ManualClock, kernel: FakeKernel, request_number: int, error: int, loss: LinkLoss, says: str
) -> None:
    camera = camera_on(Hub([kernel]), clock)
    camera.open()
    kernel.faults[request_number] = error
    told = lost(lambda: camera.read(0.0))
    assert told.loss is loss
    assert says in str(told)
    camera.close()


def test_a_busy_and_a_forbidden_device_have_names(clock: ManualClock, kernel: FakeKernel) -> None:
    kernel.holder = True
    assert lost(camera_on(Hub([kernel]), clock).open).loss is LinkLoss.BUSY
    denied = lost(camera_on(Hub([kernel], denied={NODE}), clock).open)
    assert denied.loss is LinkLoss.DENIED
    assert "add the user to the group" in str(denied)
