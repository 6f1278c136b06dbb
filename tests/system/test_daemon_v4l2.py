"""A daemon whose camera is a V4L2 device: it stalls, is unplugged, is busy; the rig names it and goes on without."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig
from camrig.config.settings import settings_of
from camrig.errors import LinkLoss
from camrig.interfaces import Camera, Driver
from camrig.messages import LinkReport, LinkStatus
from camrig.rig import CameraSpec
from camrig.runtime.daemon import Daemon
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from tests.daemon_on_fakes import Log, load, log
from tests.runtime_parts import until
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import MONOTONIC, START_OF_EXPOSURE, FakeKernel, Habits

SIZE_PX = (320, 240)
FPS = 50.0
PATIENCE_S = 20.0
NODE, OTHER = "/dev/video0", "/dev/video1"


class Shutter:
    """Lets a fake camera expose at its rate while it is open."""

    def __init__(self, kernel: FakeKernel) -> None:
        self.open = threading.Event()
        self.open.set()
        self._kernel = kernel
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="shutter")
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        clock, grey = RealClock(), bytes(SIZE_PX[0] * SIZE_PX[1])
        while not self._ended.wait(1.0 / FPS):
            if self.open.is_set():
                self._kernel.expose(grey, clock.now_s() - 0.005, MONOTONIC | START_OF_EXPOSURE)


@pytest.fixture
def kernel() -> FakeKernel:
    kernel = camera_at(NODE, "usb-1", habits=Habits(formats={"GREY": (SIZE_PX,)}))
    kernel.serial = "A1"
    return kernel


@pytest.fixture
def shutter(kernel: FakeKernel) -> Iterator[Shutter]:
    shutter = Shutter(kernel)
    yield shutter
    shutter.end()


@pytest.fixture
def rig(tmp_path: Path, kernel: FakeKernel, shutter: Shutter) -> RigConfig:
    """Two fake heads; what sits on the first is a V4L2 camera."""
    assert shutter.open.is_set()
    hub = Hub([kernel])

    def make(sections: Mapping[str, tuple[CameraSpec, V4l2Section]]) -> dict[str, Camera]:
        return {name: V4l2Camera(spec, section, RealClock(), hub) for name, (spec, section) in sections.items()}

    config = load(tmp_path)
    section = V4l2Section(device="serial=A1", format="GREY", stall_s=0.3, controls={"brightness": 17})
    driver: Driver[CameraSpec, Camera] = Driver(section=V4l2Section, make=make)
    cameras = dict(config.devices["cameras"])
    cameras["north"] = replace(cameras["north"], driver_name="v4l2", driver=driver, section=section)
    return replace(config, devices={**config.devices, "cameras": cameras})


@pytest.fixture
def daemon(rig: RigConfig) -> Iterator[Daemon]:
    with ExitStack() as stack:
        daemon = Daemon(rig, settings_of(rig), extra_sinks=[Log()])
        daemon.start()
        stack.callback(daemon.stop)
        is_up(daemon)
        yield daemon


def link(daemon: Daemon) -> LinkReport:
    return daemon.view().link("north")


def frames_come(daemon: Daemon) -> bool:
    return daemon.view().delivered["north"] > 0


def is_up(daemon: Daemon, camera: str = "north") -> None:
    until(lambda: daemon.view().link(camera).status is LinkStatus.UP, PATIENCE_S)


def lost_as(daemon: Daemon, loss: LinkLoss) -> None:
    until(lambda: link(daemon).status is LinkStatus.LOST and link(daemon).loss is loss, PATIENCE_S)
    told = "north: link lost: camera north: serial=A1"
    until(lambda: any(said.startswith(told) for said in log(daemon).said()), PATIENCE_S)
    assert "lost: north" in daemon.status_line()
    daemon.supervise(daemon.clock.now_s())  # and nothing failed: the other camera and both heads work on
    is_up(daemon, "south")


def test_a_stalled_camera_is_named_and_is_back_with_its_pictures(daemon: Daemon, shutter: Shutter) -> None:
    until(lambda: frames_come(daemon), PATIENCE_S)
    shutter.open.clear()
    lost_as(daemon, LinkLoss.STALLED)
    shutter.open.set()
    is_up(daemon)


def test_an_unplugged_camera_is_back_under_another_number_with_its_settings(daemon: Daemon, kernel: FakeKernel) -> None:
    until(lambda: frames_come(daemon), PATIENCE_S)
    kernel.unplug()
    lost_as(daemon, LinkLoss.ABSENT)
    kernel.path, kernel.holder = OTHER, True
    kernel.replug()
    lost_as(daemon, LinkLoss.BUSY)
    assert kernel.controls.held("Brightness") == 0
    kernel.holder = False
    is_up(daemon)
    assert kernel.controls.held("Brightness") == 17
