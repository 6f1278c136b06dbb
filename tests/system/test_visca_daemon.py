"""A daemon with VISCA heads, in real time: an operator's aim, and what a killed daemon leaves behind."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from camrig.errors import HardwareError
from camrig.runtime.operator_client import ask, find_socket
from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine, ViscaUdpHead

pytestmark = pytest.mark.realtime

RIG = """\
rig: visca
space: {{floor_m: [[0, 0], [5, 3]]}}
lenses:
  lab: {{size_px: [640, 360], fx: 450, fy: 450, cx: 320, cy: 180}}
cameras:
  - {{id: north, lens: lab, source: {{driver: fake, fps: 10}}, mount: {{head: pt1}}}}
heads:
  - id: pt1
    driver: visca
    port: {port}
    enable: auto
    position_m: [2.5, 1.5, 2.8]
    axes: {{pan: {{deg_per_count: 0.075, sign: -1}}, tilt: {{deg_per_count: 0.075, sign: 1}}}}
targets:
  - {{id: robot1, tags: [{{id: 1, size_m: 0.2}}]}}
"""
SLOW_HEAD = ViscaHeadSettings(id="pt1", start_pan_deg=170.0, max_speed_deg_s=30.0)
STOP = bytes.fromhex("81 01 06 01 18 14 03 03 FF")


@pytest.fixture(params=["serial", "udp"])
def emulated(request: pytest.FixtureRequest) -> Iterator[ViscaLine | ViscaUdpHead]:
    head = ViscaLine([SLOW_HEAD]) if request.param == "serial" else ViscaUdpHead(SLOW_HEAD)
    head.start()
    yield head
    head.stop()


@pytest.fixture
def daemon(emulated: ViscaLine | ViscaUdpHead, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    config = tmp_path / "rig.yaml"
    config.write_text(RIG.format(port=emulated.port))
    command = [sys.executable, "-m", "camrig", "run", str(config)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


def running() -> bool:
    try:
        return bool(ask(find_socket("visca"), {"command": "status"}))
    except HardwareError:
        return False


def moving(emulated: ViscaLine | ViscaUdpHead) -> bool:
    now_s = time.monotonic()
    before, after = (emulated.true_angles_rad("pt1", now_s - ago_s)[0] for ago_s in (0.15, 0.05))
    return abs(after - before) / 0.1 > math.radians(5.0)


def motions(emulated: ViscaLine | ViscaUdpHead, since_s: float) -> list[bytes]:
    """Return what was ordered since then, stops and inquiries left out."""
    heard = [message for stamp_s, message in emulated.received if stamp_s > since_s]
    return [message for message in heard if message[1:3] == b"\x01\x06" and message != STOP]


def test_an_aim_is_reached_and_kept_and_a_killed_daemon_leaves_nothing_moving(
    emulated: ViscaLine | ViscaUdpHead, daemon: subprocess.Popen[str]
) -> None:
    assert until(running, 30.0), "the daemon did not come up"
    command = [sys.executable, "-m", "camrig", "aim", "pt1", "--pan-deg", "120", "--tilt-deg", "-30", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=True)
    assert json.loads(done.stdout).items() >= {"arrived": True, "control": "operator"}.items()
    there_rad = (math.radians(120.0), math.radians(-30.0))
    assert emulated.true_angles_rad("pt1", time.monotonic()) == pytest.approx(there_rad, abs=0.002)
    assert until(lambda: not motions(emulated, time.monotonic() - 1.2), 2.0), "it is moved where it is to stay"

    ask(find_socket("visca"), {"command": "aim", "head": "pt1", "pan_deg": -150.0})
    assert until(lambda: moving(emulated), 3.0), "the head never moved"
    killed_s = time.monotonic()
    os.kill(daemon.pid, signal.SIGKILL)
    assert until(lambda: any(stamp_s > killed_s and message == STOP for stamp_s, message in emulated.received), 2.0)
    stopped_s = next(stamp_s for stamp_s, message in emulated.received if stamp_s > killed_s and message == STOP)
    assert stopped_s - killed_s < 0.5
    assert until(lambda: not moving(emulated), 1.0)
    assert motions(emulated, stopped_s) == []
