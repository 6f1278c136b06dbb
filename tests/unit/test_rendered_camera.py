"""The rendered camera and its server over a real Unix socket: a grid of stamps, wake, and every fault."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.clock import RealClock
from camrig.errors import HardwareError, LinkLost
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import BrownLens
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_emulators.frame_server import FrameGrid, FrameServer
from camrig_emulators.frame_wire import ASK, HEADER
from camrig_emulators.rendered_camera import RenderedCamera, RenderedSection, driver

PERIOD_S = 0.01
EXPOSURE_S = 0.002


def picture(_stamp_s: float, sequence: int) -> GreyImage:
    """Return 64 x 48 pixels of which the first says the frame's number."""
    image = np.full((48, 64), 100, dtype=np.uint8)
    image[0, 0] = sequence % 256
    return image


def spec(width: int = 64) -> CameraSpec:
    return CameraSpec("north", BrownLens((width, 48), (50.0, 50.0), (32.0, 24.0)), FreeMount())


def camera_of(server: FrameServer, width: int = 64) -> RenderedCamera:
    return RenderedCamera(spec(width), RenderedSection(url=server.url))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[FrameServer]:
    grid = FrameGrid(time.monotonic(), PERIOD_S, EXPOSURE_S)
    server = FrameServer("north", tmp_path / "camera0", grid, picture, RealClock())
    server.start()
    yield server
    server.stop()
    assert not (tmp_path / "camera0").exists()


@pytest.fixture
def camera(server: FrameServer) -> Iterator[RenderedCamera]:
    with closing(camera_of(server)) as camera:
        camera.open()
        yield camera


def read(camera: RenderedCamera) -> Frame:
    frame = camera.read(1.0)
    assert frame is not None
    return frame


def test_grid_counts_the_exposures_that_have_ended() -> None:
    grid = FrameGrid(first_s=10.0, period_s=0.1, exposure_s=0.02)
    assert [grid.newest(now_s) for now_s in (0.0, 10.0, 10.0099, 10.0101, 10.1099, 10.2101)] == [-1, -1, -1, 0, 0, 2]
    assert grid.stamp_s(3) == pytest.approx(10.3)
    assert grid.ready_s(3) == pytest.approx(10.31)


def test_stamps_are_mid_exposure_on_the_grid_and_never_in_the_future(camera: RenderedCamera) -> None:
    frames = []
    for _ in range(8):
        frame = read(camera)
        assert frame.camera_id == "north"
        assert frame.stamp_known
        assert frame.image.shape == (48, 64)
        assert frame.image[0, 0] == frame.sequence % 256
        assert frame.stamp_s + EXPOSURE_S / 2.0 <= time.monotonic()
        frames.append((frame.sequence, frame.stamp_s))
    sequences = np.array([sequence for sequence, _ in frames])
    stamps = np.array([stamp_s for _, stamp_s in frames])
    assert np.all(np.diff(sequences) >= 1)
    np.testing.assert_allclose(stamps - stamps[0], (sequences - sequences[0]) * PERIOD_S, atol=1e-9)


def test_a_slow_reader_gets_the_newest_frame_and_sees_the_gap(camera: RenderedCamera) -> None:
    first = read(camera)
    time.sleep(5.5 * PERIOD_S)
    second = read(camera)
    assert second.sequence >= first.sequence + 5
    assert time.monotonic() - second.stamp_s < 4 * PERIOD_S


def test_only_frames_that_are_asked_for_are_drawn(tmp_path: Path) -> None:
    drawn = []

    def draw(stamp_s: float, sequence: int) -> GreyImage:
        drawn.append(sequence)
        return picture(stamp_s, sequence)

    grid = FrameGrid(time.monotonic(), PERIOD_S, EXPOSURE_S)
    server = FrameServer("north", tmp_path / "camera0", grid, draw, RealClock())
    server.start()
    with closing(camera_of(server)) as camera:
        camera.open()
        got = [read(camera).sequence for _ in range(2)]
        time.sleep(4 * PERIOD_S)
        got.append(read(camera).sequence)
    server.stop()
    assert drawn == got


def test_read_times_out_and_the_frame_asked_for_comes_with_the_next_read(
    server: FrameServer, camera: RenderedCamera
) -> None:
    server.faults.silent = True
    assert camera.read(0.03) is None
    assert camera.read(0.0) is None
    server.faults.silent = False
    assert read(camera).sequence >= 0


def test_wake_ends_a_blocked_read_at_once(server: FrameServer, camera: RenderedCamera) -> None:
    server.faults.silent = True
    woken = threading.Timer(0.05, camera.wake)
    woken.start()
    begin_s = time.monotonic()
    assert camera.read(5.0) is None
    assert time.monotonic() - begin_s < 1.0
    woken.join()
    server.faults.silent = False
    assert read(camera) is not None


def test_faults_drop_freeze_and_delay(server: FrameServer, camera: RenderedCamera) -> None:
    before = read(camera)
    server.faults.drop_next(3)
    after = read(camera)
    assert after.sequence >= before.sequence + 4

    shown = int(after.image[0, 0])
    server.faults.freeze = True
    frozen = read(camera)
    assert int(frozen.image[0, 0]) == shown
    assert frozen.sequence > after.sequence
    server.faults.freeze = False

    server.faults.latency_s = 0.05
    late = read(camera)
    assert time.monotonic() - late.stamp_s >= 0.05


def test_unplugging_loses_the_link_and_replugging_brings_it_back(server: FrameServer, camera: RenderedCamera) -> None:
    read(camera)
    server.faults.unplug()
    with pytest.raises(LinkLost, match="camera north"):
        camera.read(1.0)
    deadline_s = time.monotonic() + 2.0
    while Path(server.url.removeprefix("unix:")).exists() and time.monotonic() < deadline_s:
        time.sleep(0.001)
    with pytest.raises(LinkLost, match="no emulated world answers"):
        camera.open()
    server.faults.replug()
    while time.monotonic() < deadline_s:
        try:
            camera.open()
            break
        except LinkLost:
            time.sleep(0.001)
    assert read(camera).sequence > 0


def test_a_stopped_server_is_a_lost_link(tmp_path: Path) -> None:
    server = FrameServer("north", tmp_path / "camera0", FrameGrid(time.monotonic(), 0.01, 0.002), picture, RealClock())
    server.start()
    with closing(camera_of(server)) as camera:
        camera.open()
        read(camera)
        server.stop()
        with pytest.raises(LinkLost):
            camera.read(1.0)


def test_the_server_serves_again_after_a_client_that_hung_up_in_the_middle(server: FrameServer) -> None:
    for _ in range(3):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as rude:
            rude.connect(server.url.removeprefix("unix:"))
            rude.send(ASK)
    with closing(camera_of(server)) as camera:
        camera.open()
        assert read(camera).sequence >= 0


def test_a_server_stuck_on_a_client_that_does_not_read_still_stops(tmp_path: Path) -> None:
    def large(_stamp_s: float, _sequence: int) -> GreyImage:
        return np.zeros((2000, 2000), dtype=np.uint8)

    server = FrameServer("north", tmp_path / "camera0", FrameGrid(time.monotonic(), 0.01, 0.002), large, RealClock())
    server.start()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as deaf:
        deaf.connect(server.url.removeprefix("unix:"))
        deaf.send(ASK)
        assert deaf.recv(HEADER.size, socket.MSG_PEEK)
        begin_s = time.monotonic()
        server.stop()
        assert time.monotonic() - begin_s < 1.0


def test_pictures_of_another_size_than_the_lens_are_refused(server: FrameServer) -> None:
    with closing(camera_of(server, width=80)) as camera:
        camera.open()
        with pytest.raises(HardwareError, match=r"\(64, 48\) pixels, its lens is of \(80, 48\)"):
            camera.read(1.0)


def test_closed_twice_and_unread_after(server: FrameServer) -> None:
    camera = camera_of(server)
    camera.open()
    camera.close()
    camera.close()
    camera.wake()
    with pytest.raises(LinkLost, match="is not open"):
        camera.read(0.1)


def test_the_driver_builds_every_camera_and_refuses_unknown_keys() -> None:
    made = driver.make({"north": (spec(), RenderedSection(url="unix:/nowhere"))})
    assert list(made) == ["north"]
    with pytest.raises(LinkLost, match="/nowhere"):
        made["north"].open()
    with pytest.raises(ValidationError, match="fpss"):
        RenderedSection.model_validate({"url": "unix:/nowhere", "fpss": 8})
