"""The V4L2 driver on the real kernel's API: every fault that vivid can be told to make, busy, forbidden, unplugged."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import pytest

from camrig.errors import LinkLoss
from tests.vm.vivid import (
    DEVICE,
    DISCONNECT,
    DRIVER,
    DROPPED,
    ERROR_FLAG,
    FATAL,
    INSTANCES,
    PLUGGED_IN,
    QBUF,
    REQBUFS,
    STREAMON,
    bus,
    camera,
    frame_of,
    held,
    lost,
    lost_while_reading,
    opened,
    path_of,
    tell,
)

pytestmark = [
    pytest.mark.vm,
    pytest.mark.v4l2,
    pytest.mark.skipif(not PLUGGED_IN, reason="no vivid device: these run in the VM"),
]


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
        assert made.counters.flagged == 1


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

    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.read(1), "it tells every frame by a sign, and told none"
            error = lost(made.open)
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
