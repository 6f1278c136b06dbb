"""An operator and a running daemon, in real time: what is typed is seen on the head's wire."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from camrig.errors import HardwareError
from camrig.runtime.operator_client import ask, find_socket
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

pytestmark = pytest.mark.realtime

RIG = """\
rig: operated
space: {{floor_m: [[0, 0], [5, 3]]}}
lenses:
  lab: {{size_px: [640, 360], fx: 450, fy: 450, cx: 320, cy: 180}}
cameras:
  - {{id: north, lens: lab, source: {{driver: fake, fps: 10}}, mount: {{head: pt1}}}}
heads:
  - {{id: pt1, driver: pelco_d, port: {port}, baud: 9600, enable: auto, position_m: [2.5, 1.5, 2.8]}}
targets:
  - {{id: robot1, tags: [{{id: 1, size_m: 0.2}}]}}
"""
SLOW_HEAD = PelcoDHeadSettings(id="pt1", start_pan_deg=170.0, start_tilt_deg=0.0, max_speed_deg_s=15.0)
"""It starts where no scan looks, and takes ten seconds to get there."""

STOP = bytes.fromhex("ff010000000001")
SET_PAN, SET_TILT = 0x4B, 0x4D
MOVING_RAD_S = 0.1
ON_THE_WIRE_S = 0.2
"""The daemon answers when it has written the stop; at 9600 baud its last byte is there a little later."""
STOPPING_S = 0.5
"""The head's own deceleration, and the window in which ``moving`` looks."""

STILL_S = 2.2
"""Longer than the driver waits before it says a position again."""


@pytest.fixture
def line() -> Iterator[PelcoDLine]:
    line = PelcoDLine([SLOW_HEAD])
    line.start()
    yield line
    line.stop()


@pytest.fixture
def daemon(line: PelcoDLine, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Run the daemon; the test ends it, or it is killed."""
    config = tmp_path / "rig.yaml"
    config.write_text(RIG.format(port=line.port))
    with run(config) as process:
        yield process
        process.kill()


def run(config: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "camrig", "run", str(config)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


def moving(line: PelcoDLine) -> bool:
    now_s = time.monotonic()
    before, after = (line.true_angles_rad("pt1", now_s - ago_s)[0] for ago_s in (0.15, 0.05))
    return abs(after - before) / 0.1 > MOVING_RAD_S


def stops(line: PelcoDLine) -> list[float]:
    return [stamp_s for stamp_s, frame in line.received if frame == STOP]


def running() -> bool:
    try:
        find_socket("operated")
    except HardwareError:
        return False
    return True


def head() -> Mapping[str, object]:
    heads = ask(find_socket(None), {"command": "status"})["heads"]
    assert isinstance(heads, dict)
    found = heads["pt1"]
    assert isinstance(found, dict)
    return found


def is_refused_beside_the_first(config: Path, first: int) -> None:
    with run(config) as second:
        _, said = second.communicate(timeout=30.0)
    assert second.returncode == 3
    assert f"rig 'operated' is already run on this host by process {first}" in said


def test_an_operator_holds_a_moving_head_and_lets_it_go_on(
    line: PelcoDLine, daemon: subprocess.Popen[str], tmp_path: Path
) -> None:
    assert until(running, 30.0), "the daemon did not come up"
    assert until(lambda: moving(line), 10.0), "the head never moved"
    assert (head()["link"], head()["enabled"]) == ("up", True)

    held_s = time.monotonic()
    assert ask(find_socket(None), {"command": "hold"})["heads"] == ["pt1"]
    assert until(lambda: any(stop_s > held_s for stop_s in stops(line)), ON_THE_WIRE_S)
    stopped_s = next(stop_s for stop_s in stops(line) if stop_s > held_s)
    assert until(lambda: not moving(line), STOPPING_S)
    is_refused_beside_the_first(tmp_path / "rig.yaml", daemon.pid)
    assert until(lambda: time.monotonic() > stopped_s + STILL_S, STILL_S)
    rest = line.true_angles_rad("pt1", stopped_s + STOPPING_S)
    assert line.true_angles_rad("pt1", time.monotonic()) == pytest.approx(rest, abs=1e-6)
    assert not [frame for stamp_s, frame in line.received if stamp_s > stopped_s and frame[3] in {SET_PAN, SET_TILT}]
    assert (head()["link"], head()["enabled"]) == ("up", False)

    assert ask(find_socket(None), {"command": "resume"})["heads"] == ["pt1"]
    assert until(lambda: moving(line), 3.0), "the head did not go on"

    daemon.send_signal(signal.SIGTERM)
    _, log = daemon.communicate(timeout=20.0)
    assert daemon.returncode == 0, log
    assert not running()
    assert '{"command":"hold"}: done' in log
    assert "Traceback" not in log
