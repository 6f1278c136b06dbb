"""The V4L2 driver on the real kernel's API: vivid's virtual cameras, with every fault that they can be told to make.

CAMRIG_VIVID_S is how long the run without a gap lasts: 60 s where it is not set.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.clock import RealClock
from camrig.errors import HardwareError, LinkLoss, LinkLost
from camrig.geometry.lens import BrownLens
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.controls import find_controls
from camrig_drivers.v4l2.discovery import discover
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.node import Node
from camrig_drivers.v4l2.offers import pixel_formats
from camrig_drivers.v4l2.port import KernelPort

DRIVER = Path("/sys/bus/platform/drivers/vivid")
DEVICE = "vivid.0"

pytestmark = [
    pytest.mark.vm,
    pytest.mark.v4l2,
    pytest.mark.skipif(not (DRIVER / DEVICE).exists(), reason="no vivid device: these run in the VM"),
]

PORT = KernelPort()
INSTANCES = 3
FULL_RATE_FPS = 25
RUN_S = float(os.environ.get("CAMRIG_VIVID_S", "60"))
FULL_RANGE = ("GREY", "Y10", "Y12", "Y16", "Y16-BE")
"""All others are of studio range: black is 16, white 235."""
PATTERN, GRAY_RAMP, COLOUR_BARS = 0xF0F000, 20, 0
OSD, NO_OSD = 0xF0F001, 2
STAMPS, END_OF_FRAME, START_OF_EXPOSURE = 0xF0F018, 0, 1
DROPPED, DISCONNECT, ERROR_FLAG, REQBUFS, QBUF, STREAMON, FATAL = 0xF0F040, *range(0xF0F041, 0xF0F047)


def bus(instance: int) -> str:
    return f"platform:vivid-{instance:03d}"


def path_of(instance: int) -> str:
    """Return the node that an instance has now."""
    for path in PORT.nodes():
        node = Node(PORT, path)
        identity = node.identity()
        node.close()
        if identity.bus_info == bus(instance):
            return path
    raise AssertionError(f"no node of {bus(instance)}")


def tell(instance: int, control_id: int, value: int = 1) -> None:
    """Set a control of the device, as an operator beside the driver would."""
    node = Node(PORT, path_of(instance))
    node.set_value(node.control(control_id), value)
    node.close()


def held(instance: int, name: str) -> int:
    node = Node(PORT, path_of(instance))
    value = node.value(find_controls(node)[name])
    node.close()
    return value


def camera(
    instance: int = 0, size_px: tuple[int, int] = (320, 180), readout_s: float = 0.0, /, **section: object
) -> V4l2Camera:
    lens = BrownLens(size_px, (300.0, 300.0), (160.0, 90.0))
    wanted: dict[str, object] = {"device": f"bus={bus(instance)}", "fps": FULL_RATE_FPS, **section}
    spec = CameraSpec(f"vivid{instance}", lens, FreeMount(), readout_s)
    return V4l2Camera(spec, V4l2Section.model_validate(wanted), RealClock(), PORT)


@contextmanager
def opened(made: V4l2Camera) -> Iterator[V4l2Camera]:
    made.open()
    try:
        yield made
    finally:
        made.close()


def frame_of(made: V4l2Camera) -> Frame:
    frame = made.read(5.0)
    assert frame is not None
    return frame


def lost(act: Callable[[], object]) -> LinkLost:
    with pytest.raises(LinkLost) as caught:
        act()
    return caught.value


def lost_while_reading(made: V4l2Camera) -> LinkLost:
    def read_on() -> None:
        until_s = time.monotonic() + 10.0
        while time.monotonic() < until_s:
            made.read(1.0)

    return lost(read_on)


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


def test_full_rate_goes_on_without_a_gap() -> None:
    stamps_s, sequences = [], []
    with opened(camera(0, (640, 480))) as made:
        until_s = time.monotonic() + RUN_S
        while time.monotonic() < until_s:
            frame = frame_of(made)
            stamps_s.append(frame.stamp_s)
            sequences.append(frame.sequence)
        counters = made.counters
    assert (counters.missed, counters.flagged, counters.broken) == (0, 0, 0), counters
    assert len(sequences) + counters.skipped == pytest.approx(RUN_S * FULL_RATE_FPS, abs=FULL_RATE_FPS / 2)
    assert counters.skipped <= 0.01 * len(sequences), counters
    assert np.median(np.diff(stamps_s)) == pytest.approx(1.0 / FULL_RATE_FPS, abs=1e-3)
    print(f"{RUN_S:.0f} s: {counters}")


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_both_kinds_of_stamp_mean_the_middle_of_the_exposure(readout_s: float) -> None:
    """vivid begins frame n at the start of the stream plus n periods, and ends it nine tenths of a period later.

    A stamp of its end is made before that end has come. Frames are therefore taken late: all buffers have filled, and
    the newest of them has ended.
    """
    period_s = 1.0 / FULL_RATE_FPS
    exposed_s = 0.9 * period_s
    claims_s: dict[int, float] = {}
    before_s = time.monotonic()
    with opened(camera(1, (320, 180), readout_s, exposure_s=exposed_s - readout_s)) as made:
        after_s = time.monotonic()
        for source in (START_OF_EXPOSURE, END_OF_FRAME):
            tell(1, STAMPS, source)
            frame_of(made)
            for _ in range(2):  # the first may still hold frames of the other kind
                time.sleep(8.0 * period_s)
                frame = frame_of(made)
            assert frame.stamp_known, source
            claims_s[source] = frame.stamp_s - frame.sequence * period_s - exposed_s / 2.0
    began_s, ended_s = claims_s[START_OF_EXPOSURE], claims_s[END_OF_FRAME]
    print(f"start of the stream by stamps of start and end: {1e6 * (ended_s - began_s):.0f} us apart")
    assert before_s < began_s < after_s + period_s
    assert ended_s == pytest.approx(began_s, abs=1e-3)


def test_dropped_buffers_are_counted_as_missed_and_nothing_else_happens() -> None:
    with opened(camera()) as made:
        tell(0, DROPPED, 40)
        for _ in range(25):
            frame_of(made)
        tell(0, DROPPED, 0)
        assert made.counters.missed >= 3
        assert made.counters.read == 25


def test_a_frame_flagged_as_wrong_is_dropped_and_counted() -> None:
    with opened(camera()) as made:
        frame_of(made)
        tell(0, ERROR_FLAG)
        for _ in range(5):
            frame_of(made)
        assert (made.counters.flagged, made.counters.missed) == (1, 0)


@pytest.mark.parametrize(
    ("fault", "loss", "says"),
    [
        (QBUF, LinkLoss.FAILED, "failed with EINVAL .* at VIDIOC_QBUF"),
        (FATAL, LinkLoss.FAILED, "failed with EIO .* at VIDIOC_DQBUF|has stopped streaming"),
        (DISCONNECT, LinkLoss.ABSENT, "was unplugged"),
    ],
)
def test_faults_while_streaming_have_names_and_pass(fault: int, loss: LinkLoss, says: str) -> None:
    with opened(camera(controls={"brightness": 77})) as made:
        frame_of(made)
        tell(0, fault)
        error = lost_while_reading(made)
        assert error.loss is loss, error
        assert re.search(says, str(error)), error
        made.close()
        made.open()
        frame_of(made)
        assert held(0, "brightness") == 77


@pytest.mark.parametrize(("fault", "call"), [(REQBUFS, "VIDIOC_REQBUFS"), (STREAMON, "VIDIOC_STREAMON")])
def test_faults_while_opening_have_names_and_pass(fault: int, call: str) -> None:
    made = camera()
    tell(0, fault)
    error = lost(made.open)
    assert f"failed with EINVAL (Invalid argument) at {call}" in str(error)
    with opened(made):
        frame_of(made)


def test_a_device_that_delivers_nothing_has_stalled_until_it_delivers() -> None:
    with opened(camera(stall_s=0.5)) as made:
        frame_of(made)
        tell(0, DROPPED, 100)
        began_s = time.monotonic()
        assert lost_while_reading(made).loss is LinkLoss.STALLED
        assert time.monotonic() - began_s < 2.0
        made.close()
        assert lost(made.open).loss is LinkLoss.STALLED
        tell(0, DROPPED, 0)
        made.open()
        frame_of(made)


def test_a_busy_device_names_who_holds_it() -> None:
    tool = shutil.which("v4l2-ctl")
    if tool is None:
        pytest.skip("v4l2-ctl is not installed")
    command = [tool, "-d", path_of(2), "--stream-mmap", "--stream-count=0"]
    made = camera(2)

    def open_and_close() -> None:
        until_s = time.monotonic() + 20.0
        while time.monotonic() < until_s:  # the other has yet to begin
            made.open()
            made.close()

    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as other:
        try:
            error = lost(open_and_close)
        finally:
            other.kill()
    assert error.loss is LinkLoss.BUSY
    assert f"is in use by v4l2-ctl (pid {other.pid})" in str(error)
    with opened(made):
        frame_of(made)


def test_without_permission_the_group_is_named() -> None:
    path = path_of(0)
    shutil.chown(path, group="video")
    Path(path).chmod(0o660)
    made = camera(device=path)
    os.seteuid(65534)
    try:
        error = lost(made.open)
    finally:
        os.seteuid(0)
    assert error.loss is LinkLoss.DENIED
    assert "add the user to the group video and log in again" in str(error)


def test_unplugged_together_all_come_back_under_their_names_with_their_controls() -> None:
    """One is known by its number alone: it is found by what it told of itself, whatever number it has now."""
    plain = path_of(1)
    sections: list[Mapping[str, object]] = [
        {"controls": {"brightness": 41}},
        {"controls": {"brightness": 42}, "device": plain},
        {"controls": {"brightness": 43}, "lock": ["gain"]},
    ]
    cameras = [camera(instance, (320, 180), 0.0, **section) for instance, section in enumerate(sections)]
    before = {instance: path_of(instance) for instance in range(INSTANCES)}
    for made in cameras:
        made.open()
        frame_of(made)
    gain = held(2, "gain")
    foreign = os.open(before[0], os.O_RDWR)  # keeps its number, so that others are given out
    try:
        (DRIVER / "unbind").write_text(DEVICE)
        for made in cameras:
            assert lost_while_reading(made).loss is LinkLoss.ABSENT
            made.close()
            assert lost(made.open).loss is LinkLoss.ABSENT
        (DRIVER / "bind").write_text(DEVICE)
        for instance, made in enumerate(cameras):
            made.open()
            frame_of(made)
            assert made.agreement is not None
            assert made.agreement.identity.bus_info == bus(instance)
            assert held(instance, "brightness") == 41 + instance
        assert {instance: path_of(instance) for instance in range(INSTANCES)} != before
        assert held(2, "gain_automatic") == 0
        assert held(2, "gain") == gain
    finally:
        os.close(foreign)
        with suppress(OSError):
            (DRIVER / "bind").write_text(DEVICE)
        for made in cameras:
            made.close()
