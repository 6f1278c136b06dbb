"""What a head's driver writes, byte for byte, and what it makes of every way a line may answer.

The far end is a script of (what must come, what is answered); anything else, before or after, fails.
"""

import math
import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from camrig.clock import RealClock
from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.geometry.pan_tilt import PanTilt
from camrig.interfaces import Head
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import driver
from camrig_drivers.pelco_d.bus import Bus, LineSettings, Link
from camrig_drivers.pelco_d.codec import Axis
from camrig_drivers.pelco_d.commands import query_position, set_position
from camrig_drivers.pelco_d.timing import Answer, Miss

BAUD = 115200
GAP_S = 0.005
TIMEOUT_S = 0.1
THINK_S = 0.003
"""Longer than both frames take at this baud, as for any real head."""

PAN_LIMITS_RAD = (math.radians(-170.0), math.radians(170.0))
TILT_LIMITS_RAD = (math.radians(-90.0), math.radians(10.0))

ASK_PAN, ASK_TILT = "ff010051000052", "ff010053000054"
PAN_0, TILT_0 = "ff01005900005a", "ff01005b00005c"
PAN_20, TILT_30 = "ff01005984d0ae", "ff01005b0bb81f"  # raw 340.00: 20 deg; raw 30.00: -30 deg
STOP = "ff010000000001"
OPENED = [(ASK_PAN, PAN_20), (ASK_TILT, TILT_30)]
STOPPED = [(STOP, ""), (STOP, "")]


@dataclass(slots=True)
class Step:
    """Bytes that must come next, and what is sent back, so long after."""

    expected: bytes
    answer: bytes
    think_s: float = THINK_S


@dataclass
class Peer:
    """The far end of a pty that follows a script; ``path`` is the near end's name."""

    script: list[Step] = field(default_factory=list)
    heard: bytearray = field(default_factory=bytearray)
    wrong: str = ""

    def __post_init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self._wake_r, self._wake_w = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="pelco-d peer")
        self._thread.start()

    def then(self, *steps: tuple[str, str] | Step) -> None:
        """Append to the script."""
        for step in steps:
            self.script.append(step if isinstance(step, Step) else Step(bytes.fromhex(step[0]), bytes.fromhex(step[1])))

    def unplug(self) -> None:
        self._end_thread()
        os.close(self.slave)
        os.close(self.master)
        self.master = -1

    def verify(self) -> None:
        """Wait for the script's end; fail on anything left over on either side."""
        deadline_s = time.monotonic() + 2.0
        while self.script and not self.wrong and time.monotonic() < deadline_s:
            time.sleep(0.002)
        time.sleep(0.01)
        assert not self.wrong, self.wrong
        assert not self.script, f"never came: {[step.expected.hex() for step in self.script]}"
        assert not self.heard, f"came unexpected: {self.heard.hex()}"

    def close(self) -> None:
        if self.master >= 0:
            self.unplug()

    def _end_thread(self) -> None:
        os.write(self._wake_w, b"!")
        self._thread.join()
        os.close(self._wake_r)
        os.close(self._wake_w)

    def _serve(self) -> None:
        while True:
            readable, _, _ = select.select([self.master, self._wake_r], [], [])
            if self._wake_r in readable:
                return
            self.heard += os.read(self.master, 100)
            while self.script and len(self.heard) >= len(self.script[0].expected):
                step = self.script.pop(0)
                got = bytes(self.heard[: len(step.expected)])
                del self.heard[: len(step.expected)]
                if got != step.expected:
                    self.wrong = f"expected {step.expected.hex()}, got {got.hex()}"
                    return
                if step.answer:
                    time.sleep(step.think_s)
                    os.write(self.master, step.answer)


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


def make_heads(port: str, *addresses: int, **keys: Any) -> list[Head]:
    common = {"port": port, "baud": BAUD, "gap_s": GAP_S, "reply_timeout_s": TIMEOUT_S}
    heads = driver.make(
        {
            f"pt{address}": (
                HeadSpec(f"pt{address}", PanTilt(np.eye(4)), PAN_LIMITS_RAD, TILT_LIMITS_RAD, 0.7),
                driver.section.model_validate({**common, "address": address, **keys}),
            )
            for address in addresses
        }
    )
    return list(heads.values())


@pytest.fixture
def head(peer: Peer) -> Iterator[Head]:
    """A head at address 1, open."""
    peer.then(*OPENED)
    (head,) = make_heads(peer.path, 1)
    head.open()
    yield head
    head.close()


def move(head: Head, pan_deg: float, tilt_deg: float) -> None:
    head.move_to(math.radians(pan_deg), math.radians(tilt_deg))


def read_deg(head: Head) -> list[tuple[str, float]]:
    return [(reading.axis, round(math.degrees(reading.angle_rad), 3)) for reading in head.read(1.0)]


# --- golden transcripts ---------------------------------------------------------------------------------------


def test_opening_and_closing_only_asks(peer: Peer) -> None:
    peer.then(*OPENED)
    (head,) = make_heads(peer.path, 1)
    head.open()
    head.open()
    head.close()
    head.close()
    peer.verify()


def test_a_move_is_two_frames_and_a_close_is_a_stop_said_twice(peer: Peer, head: Head) -> None:
    peer.then(("ff01004b84d0a0", ""), ("ff01004d0bb811", ""), *STOPPED)
    head.enable()
    move(head, 20.0, -30.0)
    head.close()
    peer.verify()


def test_only_the_axis_that_changes_is_sent(peer: Peer, head: Head) -> None:
    peer.then(("ff01004b84d0a0", ""), ("ff01004d0bb811", ""), ("ff01004d1194f3", ""), *STOPPED)
    head.enable()
    move(head, 20.0, -30.0)
    move(head, 20.0, -30.0)
    move(head, 20.0, -45.0)
    head.close()
    peer.verify()


def test_after_a_stop_both_axes_are_sent_again(peer: Peer, head: Head) -> None:
    both = [("ff01004b84d0a0", ""), ("ff01004d0bb811", "")]
    peer.then(*both, *STOPPED, *both, *STOPPED)
    head.enable()
    move(head, 20.0, -30.0)
    head.stop()
    head.enable()
    move(head, 20.0, -30.0)
    head.close()
    peer.verify()


def test_readings_carry_stamp_and_sigmas(peer: Peer, head: Head) -> None:
    peer.then((ASK_PAN, PAN_20), (ASK_TILT, TILT_30))
    before_s = time.monotonic()
    pan, tilt = head.read(1.0)
    after_s = time.monotonic()
    assert (pan.head_id, pan.axis, tilt.axis) == ("pt1", "pan", "tilt")
    assert math.degrees(pan.angle_rad) == pytest.approx(20.0)
    assert math.degrees(tilt.angle_rad) == pytest.approx(-30.0)
    assert before_s < pan.stamp_s < tilt.stamp_s < after_s
    assert 0.0 < pan.stamp_sigma_s < THINK_S
    assert math.degrees(pan.sigma_rad) == pytest.approx(math.hypot(0.01, 0.01 / math.sqrt(12.0)))


def test_signs_scale_and_offset_are_the_sections(peer: Peer) -> None:
    peer.then(*OPENED, ("ff01004b7530f1", ""), ("ff01004d7530f3", ""), *STOPPED)
    axes = {"pan": {"offset_deg": 150.0}, "tilt": {"sign": 1, "offset_deg": 30.0}}
    (head,) = make_heads(peer.path, 1, axes=axes)
    head.open()
    head.enable()
    move(head, -150.0, -30.0)  # raw 300.00 both
    head.close()
    peer.verify()


def test_heads_of_one_line_are_addressed_and_heard_one_by_one(peer: Peer) -> None:
    ask_2 = [("ff020051000053", "ff0200590fa00a"), ("ff020053000055", "ff02005b00005d")]
    peer.then(*OPENED, *ask_2, (ASK_PAN, PAN_20), (ASK_TILT, TILT_30), *ask_2)
    one, two = make_heads(peer.path, 1, 2)
    one.open()
    two.open()
    assert read_deg(one) == [("pan", 20.0), ("tilt", -30.0)]
    assert read_deg(two) == [("pan", -40.0), ("tilt", 0.0)]
    one.close()
    two.close()
    peer.verify()


# --- refusals -------------------------------------------------------------------------------------------------


def test_nothing_moves_before_enable_or_after_stop(peer: Peer, head: Head) -> None:
    with pytest.raises(NotEnabledError, match="pt1"):
        move(head, 20.0, -30.0)
    head.enable()
    head.stop()
    with pytest.raises(NotEnabledError, match="pt1"):
        move(head, 20.0, -30.0)
    peer.then(*STOPPED)
    head.close()
    peer.verify()


@pytest.mark.parametrize(("pan_deg", "tilt_deg"), [(171.0, 0.0), (0.0, 11.0), (math.nan, 0.0), (0.0, -90.1)])
def test_outside_the_limits_neither_axis_is_sent(peer: Peer, head: Head, pan_deg: float, tilt_deg: float) -> None:
    head.enable()
    with pytest.raises(InputError, match="head pt1 is not moved"):
        move(head, pan_deg, tilt_deg)
    peer.then(*STOPPED)
    head.close()
    peer.verify()


# --- a line that misbehaves -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("answer", "miss"),
    [
        ("", Miss.SILENT),
        ("00ff00ff00ff00ff", Miss.GARBLED),
        ("ff010059", Miss.GARBLED),
        ("ff01005984d0af", Miss.GARBLED),
        ("ff02005984d0af", Miss.GARBLED),
        (ASK_PAN, Miss.GARBLED),
    ],
    ids=["silence", "garbage", "half a frame", "wrong checksum", "another head", "echo alone"],
)
def test_what_is_no_answer_is_none(peer: Peer, answer: str, miss: Miss) -> None:
    peer.then((ASK_PAN, answer))
    link = Bus(LineSettings(peer.path, BAUD, GAP_S, TIMEOUT_S), RealClock()).attach(1)
    assert link.ask(query_position(Axis.PAN)) is miss
    link.close()
    peer.verify()


def test_a_head_that_does_not_answer_is_stopped_and_said_so_at_open(peer: Peer) -> None:
    peer.then(*[(ASK_PAN, "")] * 3, *STOPPED)
    (head,) = make_heads(peer.path, 1)
    where = rf"head pt1 at address 1 on /dev/pts/\d+, {BAUD} baud, does not answer a pan query \(nothing came back\)"
    with pytest.raises(LinkLost, match=f"{where}; check its power"):
        head.open()
    head.close()
    peer.verify()


def test_an_answer_faster_than_the_baud_rate_is_not_believed(peer: Peer) -> None:
    peer.then(Step(bytes.fromhex(ASK_PAN), bytes.fromhex(PAN_0), 0.0))
    link = Bus(LineSettings(peer.path, 2400, GAP_S, TIMEOUT_S), RealClock()).attach(1)
    assert link.ask(query_position(Axis.PAN)) is Miss.TOO_SOON
    link.close()
    peer.verify()


def test_a_head_that_falls_silent_is_lost_after_six_questions(peer: Peer, head: Head) -> None:
    peer.then(*[(ASK_PAN, ""), (ASK_TILT, "")] * 3)
    assert head.read(1.0) == ()
    assert head.read(1.0) == ()
    with pytest.raises(LinkLost, match="left 6 queries in a row unanswered"):
        head.read(1.0)
    peer.verify()


def test_a_lost_answer_costs_one_reading(peer: Peer, head: Head) -> None:
    peer.then((ASK_PAN, "ff0100"), (ASK_TILT, TILT_30), (ASK_PAN, PAN_20), (ASK_TILT, TILT_30))
    assert read_deg(head) == [("tilt", -30.0)]
    assert read_deg(head) == [("pan", 20.0), ("tilt", -30.0)]
    peer.verify()


@pytest.mark.parametrize("late_s", [0.12, 0.2, 0.35])
def test_a_late_answer_is_never_taken_for_the_new_one(peer: Peer, head: Head, late_s: float) -> None:
    late = Step(bytes.fromhex(ASK_PAN), bytes.fromhex(PAN_20), late_s)
    peer.then(late, (ASK_TILT, TILT_30), (ASK_PAN, PAN_0), (ASK_TILT, TILT_30))
    assert ("pan", 20.0) not in read_deg(head)
    assert ("pan", 20.0) not in read_deg(head)
    peer.verify()


@pytest.mark.parametrize("echo", ["auto", "yes"])
def test_an_adapter_may_echo(peer: Peer, echo: str) -> None:
    echoed = [(asked, asked + answer) for asked, answer in OPENED]
    moved = [("ff01004b84d0a0", "ff01004b84d0a0"), ("ff01004d0bb811", "ff01004d0bb811"), (STOP, STOP), (STOP, STOP)]
    peer.then(*echoed, *moved[:2], (ASK_PAN, ASK_PAN + PAN_20), (ASK_TILT, ASK_TILT + TILT_30), *moved[2:])
    (head,) = make_heads(peer.path, 1, echo=echo)
    head.open()
    head.enable()
    move(head, 20.0, -30.0)
    assert read_deg(head) == [("pan", 20.0), ("tilt", -30.0)]
    head.close()
    peer.verify()


@pytest.mark.parametrize("before", ["00", "ff", "ff01", "ff02005984d0af", "ff01005b0bb81f", "ff010001"])
def test_what_comes_before_an_answer_does_not_hide_it(peer: Peer, head: Head, before: str) -> None:
    peer.then((ASK_PAN, before + PAN_20), (ASK_TILT, TILT_30))
    assert read_deg(head) == [("pan", 20.0), ("tilt", -30.0)]


def test_a_reply_without_its_first_bytes_counts_only_on_request(peer: Peer) -> None:
    cut = [(ASK_PAN, PAN_20[4:]), (ASK_TILT, TILT_30[4:])]
    peer.then(*OPENED, *cut)
    (head,) = make_heads(peer.path, 1)
    head.open()
    assert read_deg(head) == []
    head.close()
    peer.then(*cut, *cut)
    (head,) = make_heads(peer.path, 1, resync_tail=True)
    head.open()
    assert read_deg(head) == [("pan", 20.0), ("tilt", -30.0)]
    head.close()
    peer.verify()


# --- ports that are not there, or go --------------------------------------------------------------------------


def test_a_missing_port_says_so() -> None:
    (head,) = make_heads("/dev/does-not-exist", 1)
    with pytest.raises(LinkLost, match="/dev/does-not-exist: it does not exist; check the cable"):
        head.open()
    head.stop()
    head.close()


def test_what_is_no_serial_port_says_so() -> None:
    (head,) = make_heads("/dev/null", 1)
    with pytest.raises(LinkLost, match="cannot open serial port /dev/null: it is no serial port"):
        head.open()


def test_a_port_that_another_program_holds_says_so(peer: Peer, head: Head) -> None:
    (other,) = make_heads(peer.path, 2)
    with pytest.raises(LinkLost, match="another program holds it"):
        other.open()


def test_a_guardians_copy_of_the_descriptor_does_not_keep_us_out(peer: Peer, head: Head) -> None:
    copy = os.dup(head.guard().fd)
    try:
        head.close()
        peer.then(*OPENED)
        head.open()
    finally:
        os.close(copy)


def test_the_guard_is_three_stops_and_ends_with_the_link(peer: Peer, head: Head) -> None:
    assert head.guard().stop_bytes.hex() == STOP * 3
    peer.then((STOP, ""), (STOP, ""), (STOP, ""))
    os.write(head.guard().fd, head.guard().stop_bytes)
    peer.verify()
    head.close()
    with pytest.raises(LinkLost):
        head.guard()


def test_an_unplugged_port_is_a_lost_link_for_every_call(peer: Peer, head: Head) -> None:
    head.enable()
    peer.unplug()
    for use in (lambda: head.read(1.0), lambda: move(head, 20.0, -30.0), head.guard):
        with pytest.raises(LinkLost):
            use()
    head.stop()
    head.close()
    with pytest.raises(LinkLost):
        head.open()


def test_an_unplugged_port_ends_a_wait_for_an_answer(peer: Peer) -> None:
    peer.then(*OPENED, (ASK_PAN, ""))
    (head,) = make_heads(peer.path, 1, reply_timeout_s=5.0)
    head.open()
    with ThreadPoolExecutor(1) as pool:
        reading = pool.submit(head.read, 5.0)
        peer.verify()
        peer.unplug()
        with pytest.raises(LinkLost):
            reading.result(timeout=1.0)
    head.close()


# --- stop -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SlowLine:
    """A line whose answers may take 5 s, and a thread that asks head 1 for its pan."""

    peer: Peer
    bus: Bus
    one: Link
    two: Link
    pool: ThreadPoolExecutor

    def ask(self) -> "Future[Answer | Miss]":
        """Ask in the thread; return once the question is on the wire."""
        self.peer.then((ASK_PAN, ""))
        asked = self.pool.submit(self.one.ask, query_position(Axis.PAN))
        self.peer.verify()
        return asked


@pytest.fixture
def slow(peer: Peer) -> Iterator[SlowLine]:
    bus = Bus(LineSettings(peer.path, BAUD, GAP_S, 5.0), RealClock())
    one, two = bus.attach(1), bus.attach(2)
    with ThreadPoolExecutor(3) as pool:
        yield SlowLine(peer, bus, one, two, pool)
    one.close()
    two.close()


def test_stop_cuts_an_exchange_short_and_is_said_again(slow: SlowLine) -> None:
    asked = slow.ask()
    slow.peer.then((STOP, ""))
    begun_s = time.monotonic()
    slow.one.stop()
    assert time.monotonic() - begun_s < 0.1
    assert asked.result(0.1) is Miss.CUT
    slow.peer.verify()
    slow.peer.then((STOP, ""))
    slow.one.close()
    slow.peer.verify()


def test_a_stop_cuts_another_heads_exchange_short_too(slow: SlowLine) -> None:
    asked = slow.ask()
    slow.peer.then(("ff020000000002", ""))
    slow.two.stop()
    assert asked.result(0.1) is Miss.CUT
    slow.peer.verify()
    slow.peer.then(("ff020000000002", ""))
    slow.two.close()
    slow.one.close()
    slow.peer.verify()


def test_a_motion_that_waited_when_stop_came_is_never_sent(slow: SlowLine) -> None:
    asked = slow.ask()
    moved = slow.pool.submit(slow.one.move, set_position(Axis.PAN, 3000), slow.one.permit)
    time.sleep(0.02)  # so that it waits in the queue; it is refused as well if it comes later
    slow.peer.then((STOP, ""), (STOP, ""))
    slow.one.stop()
    assert asked.result(0.1) is Miss.CUT
    assert moved.result(1.0) is False
    slow.one.close()
    slow.peer.verify()


def test_another_heads_motion_that_waited_is_sent_after_the_stops(slow: SlowLine) -> None:
    asked = slow.ask()
    moved = slow.pool.submit(slow.two.move, set_position(Axis.PAN, 0), slow.two.permit)
    time.sleep(0.02)
    slow.peer.then((STOP, ""), (STOP, ""), ("ff02004b00004d", ""))
    slow.one.stop()
    assert asked.result(0.1) is Miss.CUT
    assert moved.result(1.0) is True
    slow.peer.verify()


def test_a_stop_voids_the_permits_before_it_not_those_after(slow: SlowLine) -> None:
    permit = slow.one.permit
    slow.peer.then((STOP, ""), (STOP, ""), ("ff01004b00004c", ""))
    slow.pool.submit(slow.one.stop).result(1.0)
    assert slow.one.move(set_position(Axis.PAN, 0), permit) is False
    assert slow.one.move(set_position(Axis.PAN, 0), slow.one.permit) is True
    slow.peer.verify()


def test_stop_works_in_every_state(peer: Peer) -> None:
    (head,) = make_heads(peer.path, 1)
    head.stop()
    peer.then(*OPENED)
    head.open()
    peer.then((STOP, ""))
    head.stop()
    peer.verify()
    head.enable()
    peer.then((STOP, ""), (STOP, ""))  # two in a row are repeated once
    head.stop()
    head.close()
    peer.verify()
    head.stop()
