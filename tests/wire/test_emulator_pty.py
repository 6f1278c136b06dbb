"""The emulated line as a driver meets it: a port with a name that stays, real time, and unplugging."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from camrig.clock import RealClock
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

STOP, LEFT_FULL = bytes.fromhex("ff010000000001"), bytes.fromhex("ff0100043f0044")
QUERY_PAN = bytes.fromhex("ff010051000052")
Start = Callable[..., PelcoDLine]


@contextmanager
def port(line: PelcoDLine, baud: int = 9600) -> Iterator[serial.Serial]:
    with serial.Serial(line.port, baud, timeout=2.0, exclusive=True) as opened:
        yield opened


def ask(opened: serial.Serial, query: bytes = QUERY_PAN) -> bytes:
    opened.write(query)
    return bytes(opened.read(7))


def eventually(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen"
        time.sleep(0.005)


def test_a_query_is_answered(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator(PelcoDHeadSettings(id="head", start_pan_deg=-82.13))
    with port(line) as opened:
        assert ask(opened) == bytes.fromhex("ff01005920158f")
    assert [frame for _, frame in line.received] == [QUERY_PAN]
    assert [reply.hex() for _, reply in line.sent] == ["ff01005920158f"]


@pytest.mark.realtime
@pytest.mark.parametrize("baud", [2400, 9600])
def test_an_exchange_never_takes_less_than_the_wire_and_rarely_much_more(pelco_d_emulator: Start, baud: int) -> None:
    line = pelco_d_emulator(PelcoDHeadSettings.model_validate({"id": "head", "baud": baud, "reply_latency_s": 0.01}))
    least_s = 140 / baud + 0.01
    taken_s = []
    with port(line, baud) as opened:
        for _ in range(20):
            start_s = time.monotonic()
            assert len(ask(opened)) == 7
            taken_s.append(time.monotonic() - start_s)
    assert min(taken_s) >= least_s
    assert sorted(taken_s)[10] < least_s + 0.02


@pytest.mark.realtime
def test_the_truth_explains_every_read_back_of_a_moving_head(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator(PelcoDHeadSettings(id="head", pan_limits_deg=None))
    with port(line) as opened:
        opened.write(LEFT_FULL)
        time.sleep(0.4)
        for _ in range(20):
            reply = ask(opened)
            sent_s, raw = line.sent[-1][0], reply[4] << 8 | reply[5]
            reply_start_s = sent_s - 70 / 9600
            earliest, latest = (
                math.degrees(line.true_angles_rad("head", stamp_s)[0])
                for stamp_s in (reply_start_s - 0.01, reply_start_s)
            )
            assert earliest - 0.006 <= -math.remainder(raw / 100.0, 360.0) <= latest + 0.006
        opened.write(STOP)


def test_motion_goes_on_while_nobody_has_the_port_open(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator()
    with port(line) as opened:
        opened.write(LEFT_FULL)
    eventually(lambda: line.true_angles_rad("head", RealClock().now_s())[0] > 0.01)
    with port(line) as opened:
        opened.write(STOP)
        eventually(lambda: line.received[-1][1] == STOP)
    rest = line.true_angles_rad("head", line.received[-1][0] + 1.0)
    assert line.true_angles_rad("head", line.received[-1][0] + 9.0) == rest


def test_unplugging_kills_the_open_port_and_takes_the_name_away(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator()
    with port(line) as opened:
        line.faults.unplug()
        eventually(lambda: not os.path.lexists(line.port))
        with pytest.raises(OSError, match=r"disconnected|Input/output"):
            opened.read(1)
        with pytest.raises(OSError, match="Input/output"):
            opened.write(STOP)
    with pytest.raises(OSError, match="No such file"):
        serial.Serial(line.port)


def test_replugging_brings_the_name_back_and_nothing_old_with_it(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator()
    name = line.port
    with port(line) as opened:
        opened.write(LEFT_FULL)
        eventually(lambda: line.received != [])
        line.faults.unplug()
        eventually(lambda: not os.path.lexists(name))
    line.faults.replug()
    eventually(lambda: os.path.exists(name))
    assert line.port == name
    with port(line) as opened:
        assert len(ask(opened)) == 7
        opened.write(STOP)
        eventually(lambda: line.received[-1][1] == STOP)
    assert [frame for _, frame in line.received] == [LEFT_FULL, QUERY_PAN, STOP]


def test_a_port_at_another_baud_gets_nowhere(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator()
    with port(line, baud=2400) as opened:
        opened.timeout = 0.2
        assert ask(opened) == b""
    assert line.received == []


def test_answers_that_nobody_reads_do_not_stop_the_line(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator(PelcoDHeadSettings(id="head", baud=115200, reply_latency_s=0.0, answers="full"))
    with port(line, 115200) as opened:
        for _ in range(60):
            opened.write(QUERY_PAN * 20)
            time.sleep(0.001)
        eventually(lambda: len(line.received) == 1200)
        opened.reset_input_buffer()
        assert len(ask(opened)) == 7


def test_the_line_can_be_stopped_twice_and_started_again_and_leaves_nothing() -> None:
    line = PelcoDLine([PelcoDHeadSettings(id="head")])
    with pytest.raises(RuntimeError, match="before it is started"):
        _ = line.port
    folders = []
    for _ in range(2):
        folder = Path(line.start()).parent
        assert line.start() == line.port
        folders.append(folder)
        with port(line) as opened:
            assert len(ask(opened)) == 7
        line.stop()
        line.stop()
        assert not folder.exists()
    assert folders[0] != folders[1]


def test_a_line_that_is_stopped_while_unplugged_leaves_nothing() -> None:
    line = PelcoDLine([PelcoDHeadSettings(id="head")])
    folder = Path(line.start()).parent
    line.faults.unplug()
    eventually(lambda: not os.path.lexists(line.port))
    line.stop()
    assert not folder.exists()


def test_many_heads_on_one_port_describe_themselves(pelco_d_emulator: Start) -> None:
    line = pelco_d_emulator(*(PelcoDHeadSettings(id=f"h{k}", address=k) for k in (1, 2)))
    with port(line) as opened:
        assert len(ask(opened)) == 7
    assert line.describe() == (
        "h1 (address 1): pan +0.00 deg, tilt +0.00 deg, still; 1 heard, 1 answered; "
        "h2 (address 2): pan +0.00 deg, tilt +0.00 deg, still; 0 heard, 0 answered"
    )
