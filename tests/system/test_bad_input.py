"""Bad input on the real command line: refused with exit code 2, each fault with file, line and key, nothing moved."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

GOOD = """\
rig: lab
space: {{floor_m: [[0, 0], [5, 3]]}}
lenses:
  lab: {{size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}}
  small: {{size_px: [64, 48], fx: 50, fy: 50, cx: 32, cy: 24}}
cameras:
  - {{id: north, lens: lab, source: {{driver: fake}}, mount: {{head: pt1}}}}
  - {{id: south, lens: lab, source: {{driver: fake}}, mount: {{head: pt2}}}}
  - {{id: east, lens: small, source: {{driver: images, path: {pictures}, fps: 5}}, mount: {{free: true}}}}
heads:
  - {{id: pt1, driver: pelco_d, port: {port}, address: 1, enable: auto, position_m: [1, 1, 2.8]}}
  - {{id: pt2, driver: pelco_d, port: {port}, address: 2, enable: auto, position_m: [4, 1, 2.8]}}
targets:
  - {{id: robot1, tags: [{{id: 7, size_m: 0.12}}]}}
anchors:
  - {{id: 100, size_m: 0.2, T_world_tag: {{position_m: [0, 0, 0]}}}}
"""

Edit = tuple[str, str]
UNKNOWN_KEY: Edit = ("port: {port}, address: 2", "port: {port}, adress: 2")
WRONG_UNIT: Edit = ("position_m: [4, 1, 2.8]", "position_m: [4000, 1000, 2800]")
ONE_ADDRESS: Edit = ("address: 2", "address: 1")
OTHER_SIZE: Edit = ("size_px: [64, 48]", "size_px: [640, 480]")
NO_MOUNT: Edit = (", mount: {{head: pt2}}", "")
TAG_TWICE: Edit = ("id: 100", "id: 7")


@pytest.fixture
def line(pelco_d_emulator: Callable[..., PelcoDLine]) -> PelcoDLine:
    return pelco_d_emulator(*(PelcoDHeadSettings(id=f"pt{k}", address=k) for k in (1, 2)))


@pytest.fixture
def write(line: PelcoDLine, tmp_path: Path) -> Callable[..., Path]:
    """Return ``write(*edits)``: the good rig's file, on the emulated line, with these edits."""
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    cv2.imwrite(str(pictures / "a.png"), np.full((48, 64), 90, np.uint8))

    def write_file(*edits: Edit) -> Path:
        text = GOOD
        for old, new in edits:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path = tmp_path / "rig.yaml"
        path.write_text(text.format(port=line.port, pictures=pictures))
        return path

    return write_file


def camrig(command: str, config: Path) -> subprocess.CompletedProcess[str]:
    arguments = [sys.executable, "-m", "camrig", command, str(config)]
    return subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=False)


def refused(command: str, config: Path, line: PelcoDLine) -> list[tuple[int, str, str]]:
    """Run a command that must refuse the file; return (line, key, message) of every fault, in order."""
    done = camrig(command, config)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert list(line.received) == []
    faults = []
    for row in done.stderr.removeprefix("error: ").splitlines():
        found = re.fullmatch(rf"{re.escape(str(config))}:(\d+): ([\w.\[\]]+): (.+)", row)
        assert found, f"no file:line: key: message in {row!r}"
        faults.append((int(found[1]), found[2], found[3]))
    return faults


def test_a_good_file_is_consistent_and_checking_it_says_nothing_to_a_head(
    write: Callable[..., Path], line: PelcoDLine, tmp_path: Path
) -> None:
    done = camrig("check", write())
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(f"{tmp_path / 'rig.yaml'}: rig 'lab' is consistent.\n")
    assert list(line.received) == []


FAULTS = [
    pytest.param(UNKNOWN_KEY, 12, "heads[pt2].adress", "unknown key, did you mean 'address'?", id="unknown key"),
    pytest.param(WRONG_UNIT, 12, "heads[pt2].position_m[0]", "less than or equal to 1000; got 4000", id="wrong unit"),
    pytest.param(ONE_ADDRESS, 12, "heads[pt2].address", "address 1 is taken by head pt1", id="one address"),
    pytest.param(OTHER_SIZE, 9, "cameras[east].source.path", "64x48 px, .* lens is for 640x480", id="other size"),
    pytest.param(NO_MOUNT, 8, "cameras[south].mount", "is missing", id="no mount"),
    pytest.param(TAG_TWICE, 16, "anchors[7].id", r"tag36h11:7 is already listed at targets\[0\]", id="tag twice"),
]


@pytest.mark.parametrize(("edit", "at", "key", "says"), FAULTS)
def test_a_fault_is_named_with_its_file_line_and_key(
    write: Callable[..., Path], line: PelcoDLine, edit: Edit, at: int, key: str, says: str
) -> None:
    faults = refused("check", write(edit), line)
    assert any((where, what) == (at, key) and re.search(says, message) for where, what, message in faults), faults
    assert {where for where, _, _ in faults} == {at}


def test_a_rig_with_faults_does_not_start_and_all_of_them_are_told(
    write: Callable[..., Path], line: PelcoDLine
) -> None:
    faults = refused("run", write(UNKNOWN_KEY, NO_MOUNT, TAG_TWICE), line)
    assert [(at, key) for at, key, _ in faults] == [
        (8, "cameras[south].mount"),
        (12, "heads[pt2].adress"),
        (16, "anchors[7].id"),
    ]
    faults = refused("run", write(ONE_ADDRESS, OTHER_SIZE), line)
    assert [(at, key) for at, key, _ in faults] == [(9, "cameras[east].source.path"), (12, "heads[pt2].address")]


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_missing_file_is_named(command: str, tmp_path: Path) -> None:
    done = camrig(command, tmp_path / "absent.yaml")
    assert done.returncode == 2
    assert done.stderr == f"error: {tmp_path / 'absent.yaml'}: cannot be read: No such file or directory\n"


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "camrig", "run", "rig.yaml", "--seconds", "soon"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "Invalid value for '--seconds'" in done.stderr
    assert "Traceback" not in done.stderr


def test_all_faults_of_a_file_come_at_once_and_no_false_ones_with_them(
    write: Callable[..., Path], line: PelcoDLine
) -> None:
    unknown: Edit = ("anchors:", "anchers: []\nanchors:")
    misspelt: Edit = ("size_m: 0.12", "size_mm: 120")
    config = write(unknown, misspelt, ONE_ADDRESS, OTHER_SIZE, NO_MOUNT)
    faults = refused("check", config, line)
    assert [(at, key) for at, key, _ in faults] == [
        (8, "cameras[south].mount"),
        (9, "cameras[east].source.path"),
        (12, "heads[pt2].address"),
        (14, "targets[robot1].tags[7].size_m"),
        (14, "targets[robot1].tags[7].size_mm"),
        (15, "anchers"),
    ]
