"""The Pelco-D driver over a paced pty against emulated heads: stamps, stop, sharing a line, and trouble on it."""

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest

from camrig.errors import LinkLost
from camrig.geometry.pan_tilt import PanTilt
from camrig.interfaces import Head
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import driver
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

PAN_LIMITS_RAD = (math.radians(-170.0), math.radians(170.0))
TILT_LIMITS_RAD = (math.radians(-90.0), math.radians(10.0))
STOP_1 = bytes.fromhex("ff010000000001")

pytestmark = pytest.mark.realtime


class EmulatedHeads:
    """Heads of one line at addresses 1, 2, …, open; ``settings`` are the emulator's, ``keys`` the driver's."""

    def __init__(self, count: int, baud: int, settings: dict[str, Any], keys: dict[str, Any]) -> None:
        self.names = [f"pt{k + 1}" for k in range(count)]
        self.line = PelcoDLine(
            [
                PelcoDHeadSettings.model_validate({"id": name, "address": k + 1, "baud": baud, **settings})
                for k, name in enumerate(self.names)
            ],
            seed=1,
        )
        port = self.line.start()
        self.heads: list[Head] = list(
            driver.make(
                {
                    name: (
                        HeadSpec(name, PanTilt(np.eye(4)), PAN_LIMITS_RAD, TILT_LIMITS_RAD, math.radians(40.0)),
                        driver.section.model_validate({"port": port, "baud": baud, "address": k + 1, **keys}),
                    )
                    for k, name in enumerate(self.names)
                }
            ).values()
        )

    @property
    def head(self) -> Head:
        return self.heads[0]

    def truth_rad(self, reading: AxisReading) -> float:
        return self.line.true_angles_rad(reading.head_id, reading.stamp_s)[reading.axis == "tilt"]

    def received(self) -> list[bytes]:
        return [frame for _, frame in self.line.received]

    def stop(self) -> None:
        for head in self.heads:
            head.close()
        self.line.stop()


@contextmanager
def emulated(
    count: int = 1, baud: int = 9600, keys: dict[str, Any] | None = None, **settings: Any
) -> Iterator[EmulatedHeads]:
    heads = EmulatedHeads(count, baud, settings, keys or {})
    try:
        for head in heads.heads:
            head.open()
        yield heads
    finally:
        heads.stop()


@contextmanager
def polling(head: Head) -> Iterator[list[AxisReading]]:
    """Poll a head in a thread of its own, as its worker does."""
    readings: list[AxisReading] = []
    ending = threading.Event()

    def poll() -> None:
        while not ending.is_set():
            readings.extend(head.read(1.0))

    thread = threading.Thread(target=poll, name="poll")
    thread.start()
    try:
        yield readings
    finally:
        ending.set()
        thread.join()


def move(head: Head, pan_deg: float, tilt_deg: float) -> None:
    head.move_to(math.radians(pan_deg), math.radians(tilt_deg))


def read_deg(head: Head) -> list[float]:
    return [round(math.degrees(reading.angle_rad), 3) for reading in head.read(1.0)]


def read_until_lost(head: Head) -> None:
    for _ in range(100):
        head.read(1.0)


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 3.0
    while not condition():
        assert time.monotonic() < deadline_s, "waited for 3 s"
        time.sleep(0.005)


# --- stamps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [2400, 9600])
def test_readings_of_a_moving_head_are_right_at_their_stamps(baud: int) -> None:
    with emulated(baud=baud, reply_latency_s=0.02) as rig:  # longer than usual, so that stamps matter
        rig.head.enable()
        move(rig.head, 120.0, -80.0)
        readings = [reading for _ in range(8) for reading in rig.head.read(1.0)]
        speed_rad_s = math.radians(40.0)
        travelled = math.degrees(readings[-2].angle_rad - readings[0].angle_rad)
        assert len(readings) == 16
        assert travelled > 20.0, "it was moving"
        for reading in readings:
            sigma_rad = math.hypot(reading.sigma_rad, speed_rad_s * reading.stamp_sigma_s)
            assert abs(reading.angle_rad - rig.truth_rad(reading)) <= 3.0 * sigma_rad


# --- stop -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("baud", "allowed_s"), [(9600, 0.06), (2400, 0.12)])
def test_stop_is_on_the_wire_at_once_while_others_poll(baud: int, allowed_s: float) -> None:
    """Allowed: a question already in the port's buffer, the stop itself, and some time for the machine."""
    with emulated(2, baud) as rig, polling(rig.heads[0]), polling(rig.heads[1]):
        took_s = []
        for k in range(10):
            time.sleep(0.017 * (k % 7))
            took_s.append(_stop(rig))
        assert max(took_s) < allowed_s


def _stop(rig: EmulatedHeads) -> float:
    """Stop the first head; return how long after the call it had heard all of the stop."""
    begun_s = time.monotonic()
    rig.head.stop()
    until(lambda: _heard_stop_s(rig.line, begun_s) < math.inf)
    return _heard_stop_s(rig.line, begun_s) - begun_s


def _heard_stop_s(line: PelcoDLine, since_s: float) -> float:
    """Return when the first stop ended whose first bit was sent after ``since_s``; inf before it is there."""
    air_s = 70.0 / line.baud
    heard_s = (stamp_s for stamp_s, frame in line.received if frame == STOP_1 and stamp_s - air_s >= since_s)
    return next(heard_s, math.inf)


def test_a_stop_that_came_too_soon_for_the_head_is_heard_the_second_time() -> None:
    with emulated(min_gap_s=0.04) as rig:
        rig.head.enable()
        move(rig.head, 150.0, -80.0)
        rig.head.stop()
        rig.head.read(1.0)
        assert rig.received().count(STOP_1) == 2
        time.sleep(0.3)
        at_rest = rig.line.true_angles_rad("pt1", time.monotonic())
        assert at_rest == pytest.approx((0.0, 0.0), abs=math.radians(15.0))


def test_a_guards_bytes_stop_a_head_even_after_half_a_frame() -> None:
    with emulated() as rig:
        rig.head.enable()
        move(rig.head, 150.0, -80.0)
        guard = rig.head.guard()
        os.write(guard.fd, bytes.fromhex("ff01004b") + guard.stop_bytes)
        until(lambda: rig.received().count(STOP_1) >= 2)


# --- one line, several heads ----------------------------------------------------------------------------------


def test_four_heads_that_poll_are_served_in_turn() -> None:
    with ExitStack() as stack:
        rig = stack.enter_context(emulated(4, 115200, {"gap_s": 0.005}))
        polls = [stack.enter_context(polling(head)) for head in rig.heads]
        until(lambda: min(map(len, polls)) >= 20)
        asked = [frame[1] for frame in rig.received()][-64:]
        assert all(asked.count(address) in range(13, 20) for address in (1, 2, 3, 4))
        assert {reading.head_id for reading in polls[2]} == {"pt3"}


def test_a_silent_head_does_not_silence_its_line() -> None:
    with emulated(2) as rig:
        rig.line.head_faults["pt1"].silent = True
        assert rig.heads[0].read(1.0) == ()
        assert len(rig.heads[1].read(1.0)) == 2
        rig.heads[0].close()
        assert len(rig.heads[1].read(1.0)) == 2


# --- trouble --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("echo", ["auto", "yes"])
def test_positions_are_right_through_an_echo_and_general_replies(echo: str) -> None:
    rig = EmulatedHeads(1, 9600, {"answers": "full"}, {"echo": echo})
    rig.line.faults.echo = True
    try:
        rig.head.open()
        rig.head.enable()
        move(rig.head, 5.0, -5.0)
        until(lambda: read_deg(rig.head) == [5.0, -5.0])
    finally:
        rig.stop()


@pytest.mark.parametrize(("resync_tail", "readings"), [(False, 0), (True, 2)])
def test_replies_cut_at_the_turn_around_count_on_request(resync_tail: bool, readings: int) -> None:
    with emulated(keys={"resync_tail": resync_tail}) as rig:
        rig.line.faults.truncate_reply(0, first=2)
        assert len(rig.head.read(1.0)) == readings


def test_late_replies_are_no_readings_and_the_line_recovers() -> None:
    with emulated() as rig:
        rig.head.enable()
        move(rig.head, 150.0, -80.0)
        rig.line.faults.latency_s = 0.18
        late = [reading for _ in range(2) for reading in rig.head.read(1.0)]
        rig.line.faults.latency_s = 0.0
        time.sleep(0.2)
        readings = [reading for _ in range(2) for reading in rig.head.read(1.0)]
        assert late == []
        assert len(readings) == 4
        for reading in readings:
            assert abs(reading.angle_rad - rig.truth_rad(reading)) < math.radians(0.5)


def test_a_head_that_was_moving_when_its_port_went_is_stopped_first_when_it_is_back() -> None:
    with emulated() as rig:
        rig.head.enable()
        move(rig.head, 150.0, -80.0)
        rig.line.faults.unplug()
        with pytest.raises(LinkLost):
            read_until_lost(rig.head)
        rig.head.close()
        before = len(rig.received())
        rig.line.faults.replug()
        until(lambda: _opens(rig.head))
        assert rig.received()[before] == STOP_1
        assert all(frame == STOP_1 or frame[3] in (0x51, 0x53) for frame in rig.received()[before:])


def _opens(head: Head) -> bool:
    try:
        head.open()
    except LinkLost:
        return False
    return True


def test_a_wrong_baud_is_a_lost_link() -> None:
    rig = EmulatedHeads(1, 9600, {}, {"baud": 19200})
    try:
        with pytest.raises(LinkLost, match="19200 baud"):
            rig.head.open()
    finally:
        rig.stop()
