"""`camrig run` on an emulated head, ended from outside: exit code 0, soon, and the last motion on the wire a stop."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine
from tests.runtime_parts import until

pytestmark = pytest.mark.realtime

RIG = """\
rig: signals
space: {{floor_m: [[0, 0], [5, 3]]}}
lenses:
  lab: {{size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}}
cameras:
  - {{id: north, lens: lab, source: {{driver: fake}}, mount: {{head: pt1}}}}
heads:
  - {{id: pt1, driver: pelco_d, port: {port}, enable: auto, position_m: [2.5, 1.5, 2.8], pan_deg: [-170, 170]}}
targets:
  - {{id: robot1, tags: [{{id: 1, size_m: 0.2}}]}}
"""

STOP = bytes.fromhex("ff010000000001")
QUERIES, SET_PAN = (0x51, 0x53), 0x4B
EXIT_S = 3.0
READY_S = 5.0
SLOW = PelcoDHeadSettings(id="pt1", start_pan_deg=170.0, max_speed_deg_s=15.0)
"""It is under way for seconds: a stop that did not come would show."""


def motions(line: PelcoDLine) -> list[bytes]:
    return [frame for _, frame in line.received if frame[3] not in QUERIES]


def ended(line: PelcoDLine, config: Path, send: Callable[[subprocess.Popen[str]], None]) -> tuple[int, float, str]:
    """Run the rig, ``send`` it a signal once its head moves; return exit code, how long it took, and what it said."""
    config.write_text(RIG.format(port=line.port))
    command = [sys.executable, "-m", "camrig", "run", str(config)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(config.parent)}
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        until(lambda: any(frame[3] == SET_PAN for frame in motions(line)) or daemon.poll() is not None, 30.0)
        began_s = time.monotonic()
        send(daemon)
        _, said = daemon.communicate(timeout=30.0)
        return daemon.returncode, time.monotonic() - began_s, said
    finally:
        daemon.kill()
        daemon.wait()


def _terminate(daemon: subprocess.Popen[str]) -> None:
    """Do as systemd does."""
    daemon.send_signal(signal.SIGTERM)


def _interrupt(daemon: subprocess.Popen[str]) -> None:
    """Press Ctrl-C again and again, as people do."""
    for _ in range(10):
        daemon.send_signal(signal.SIGINT)
        time.sleep(0.005)


@pytest.mark.parametrize("send", [_terminate, _interrupt], ids=["SIGTERM", "SIGINT"])
def test_a_signal_brings_the_rig_to_rest(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path, send: Callable[[subprocess.Popen[str]], None]
) -> None:
    line = pelco_d_emulator(SLOW)
    code, took_s, said = ended(line, tmp_path / "rig.yaml", send)
    assert code == 0, said
    assert took_s < EXIT_S
    assert "Traceback" not in said
    assert motions(line)[-1] == STOP
    time.sleep(0.3)
    now_s = time.monotonic()
    assert line.true_angles_rad("pt1", now_s) == line.true_angles_rad("pt1", now_s - 0.1)


def test_the_service_is_ready_within_five_seconds_and_a_reload_stops_its_heads(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path
) -> None:
    line = pelco_d_emulator(SLOW)
    config = tmp_path / "rig.yaml"
    config.write_text(RIG.format(port=line.port))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(30.0)
        environment = {"XDG_RUNTIME_DIR": str(tmp_path), "NOTIFY_SOCKET": str(tmp_path / "notify")}
        began_s = time.monotonic()
        daemon = subprocess.Popen(
            [sys.executable, "-m", "camrig", "run", str(config)], env={**os.environ, **environment}
        )
        try:
            _told(systemd, b"READY=1")
            ready_s = time.monotonic() - began_s
            print(f"ready after {ready_s:.2f} s")
            assert ready_s < READY_S
            until(lambda: any(frame[3] == SET_PAN for frame in motions(line)), 30.0)
            before = len(motions(line))
            daemon.send_signal(signal.SIGHUP)
            _told(systemd, b"RELOADING=1")
            _told(systemd, b"READY=1")
            assert STOP in motions(line)[before:]
            daemon.send_signal(signal.SIGTERM)
            _told(systemd, b"STOPPING=1")
            assert daemon.wait(30.0) == 0
        finally:
            daemon.kill()
            daemon.wait()
    assert motions(line)[-1] == STOP


def _told(systemd: socket.socket, message: bytes) -> None:
    while not systemd.recv(4096).startswith(message):
        pass
