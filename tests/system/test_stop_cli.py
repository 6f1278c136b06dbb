"""`camrig stop`: every head that can be reached is stopped, and every one that cannot is named."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import serial

from camrig.config.rig_file import load_rig
from camrig.runtime import last_run
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

pytestmark = pytest.mark.realtime

RIG = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}
cameras:
"""
LEFT_1, LEFT_2 = bytes.fromhex("ff0100043f0044"), bytes.fromhex("ff0200043f0045")
STOP_1, STOP_2 = bytes.fromhex("ff010000000001"), bytes.fromhex("ff020000000002")
QUERIES = (0x51, 0x53)
HEADS = [PelcoDHeadSettings(id=f"pt{k}", address=k, start_pan_deg=-170.0) for k in (1, 2)]


def write_rig(folder: Path, heads: Sequence[tuple[str, str, int]]) -> Path:
    """Write a rig of heads (id, port, address), each with a camera."""
    cameras = [
        f"  - {{id: c{name}, lens: lab, source: {{driver: fake}}, mount: {{head: {name}}}}}" for name, _, _ in heads
    ]
    rows = [
        f"  - {{id: {name}, driver: pelco_d, port: {port}, address: {address}, position_m: [1, 1, 2.8]}}"
        for name, port, address in heads
    ]
    path = folder / "rig.yaml"
    path.write_text(RIG + "\n".join([*cameras, "heads:", *rows]) + "\n")
    return path


def stop(config: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "camrig", "stop", str(config)]
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(config.parent)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done


def set_moving(line: PelcoDLine) -> None:
    """Leave both heads turning at full speed, as a daemon that died does."""
    with serial.Serial(line.port, 9600) as port:
        port.write(LEFT_1 + LEFT_2)
        time.sleep(0.2)


def stands(line: PelcoDLine, name: str) -> bool:
    now_s = time.monotonic()
    return line.true_angles_rad(name, now_s) == line.true_angles_rad(name, now_s - 0.1)


def motions(line: PelcoDLine) -> list[bytes]:
    return [frame for _, frame in line.received if frame[3] not in QUERIES]


def test_every_head_is_stopped(pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path) -> None:
    line = pelco_d_emulator(*HEADS)
    config = write_rig(tmp_path, [("pt1", line.port, 1), ("pt2", line.port, 2)])
    set_moving(line)
    assert not stands(line, "pt1")
    assert not stands(line, "pt2")
    done = stop(config)
    assert done.returncode == 0, done.stderr
    time.sleep(0.4)  # a ramp down takes 0.25 s
    assert stands(line, "pt1")
    assert stands(line, "pt2")
    assert motions(line)[:2] == [LEFT_1, LEFT_2]
    assert set(motions(line)[2:]) == {STOP_1, STOP_2}


def test_a_silent_head_is_told_to_stop_all_the_same_and_is_named(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path
) -> None:
    line = pelco_d_emulator(*HEADS)
    line.head_faults["pt1"].silent = True  # it hears, but its answers do not get through
    config = write_rig(tmp_path, [("pt1", line.port, 1), ("pt2", line.port, 2)])
    set_moving(line)
    done = stop(config)
    assert done.returncode == 4
    assert "pt1: head pt1 at address 1" in done.stderr
    assert "error: no stop could be written to pt1" in done.stderr
    order = [frame for frame in motions(line) if frame in {STOP_1, STOP_2}]
    assert order[0] == STOP_2  # its time-outs delayed nobody else's stop
    assert STOP_1 in order
    time.sleep(0.4)
    assert stands(line, "pt1")
    assert stands(line, "pt2")


def test_a_missing_port_is_named_and_keeps_no_other_head_from_its_stop(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path
) -> None:
    line = pelco_d_emulator(*HEADS)
    absent = tmp_path / "ttyABSENT"
    config = write_rig(tmp_path, [("pt0", str(absent), 1), ("pt1", line.port, 1), ("pt2", line.port, 2)])
    set_moving(line)
    done = stop(config)
    assert done.returncode == 4
    assert f"cannot open serial port {absent}: it does not exist" in done.stderr
    assert "no stop could be written to pt0" in done.stderr
    time.sleep(0.4)
    assert stands(line, "pt1")
    assert stands(line, "pt2")


def test_a_file_that_has_faults_since_it_was_run_keeps_no_head_from_its_stop(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path
) -> None:
    """As after a refused reload: the daemon ran on by what it had read before, and died."""
    line = pelco_d_emulator(*HEADS)
    config = write_rig(tmp_path, [("pt1", line.port, 1), ("pt2", line.port, 2)])
    last_run.keep(load_rig(config), tmp_path)
    config.write_text(config.read_text().replace("address: 1", "address: one"))
    set_moving(line)
    done = stop(config)
    assert done.returncode == 4
    assert "the heads were stopped as the daemon last knew them, for the file has faults now" in done.stderr
    assert "heads[pt1].address" in done.stderr
    assert set(motions(line)[2:]) == {STOP_1, STOP_2}


def test_heads_of_the_daemon_and_of_the_changed_file_are_stopped(
    pelco_d_emulator: Callable[..., PelcoDLine], tmp_path: Path
) -> None:
    line = pelco_d_emulator(*HEADS)
    last_run.keep(load_rig(write_rig(tmp_path, [("pt1", line.port, 1)])), tmp_path)
    config = write_rig(tmp_path, [("pt2", line.port, 2)])
    set_moving(line)
    assert stop(config).returncode == 0
    stops = motions(line)[2:]
    assert stops[0] == STOP_1  # the one that may be moving
    assert set(stops) == {STOP_1, STOP_2}


def test_a_file_with_faults_is_refused_as_everywhere(tmp_path: Path) -> None:
    done = stop(tmp_path / "absent.yaml")
    assert done.returncode == 2
    assert f"{tmp_path / 'absent.yaml'}: cannot be read" in done.stderr
