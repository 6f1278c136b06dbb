"""``camrig calibrate head``: what it refuses before anything moves."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from camrig.cli.calibrate_head import head
from camrig.errors import CamrigError, HardwareError, InputError

RIG = """\
rig: two-heads
space: {floor_m: [[0, 0], [5, 4]]}
lenses:
  lab: {model: brown, size_px: [1280, 720], fx: 1050.0, fy: 1050.0, cx: 640.0, cy: 360.0}
cameras:
  - {id: eye, lens: lab, source: {driver: fake}, mount: {head: pt1}}
  - {id: other, lens: lab, source: {driver: fake}, mount: {head: dummy}}
heads:
  - {id: pt1, driver: pelco_d, port: /dev/none, address: 1, position_m: [1, 1, 2.8], pan_deg: [-90, 90]}
  - {id: dummy, driver: fake, position_m: [1, 1, 2.8]}
detector: {refine: false}
"""
ANCHOR = "anchors: [{id: 100, size_m: 0.2, T_world_tag: {position_m: [1, 1, 0]}}]\n"
AXIS = '{speeds: {"1": 0.2, "63": 20}}'
BLIND = (RIG + ANCHOR).replace(
    "address: 1,",
    f"address: 1, grade: open_loop, axes: {{pan: {AXIS}, tilt: {AXIS}}}, open_loop: {{zero: {{by: anchors}}}},",
)


@pytest.mark.parametrize(
    ("text", "name", "options", "error", "said"),
    [
        (RIG + ANCHOR, "pt9", {}, InputError, "has no head 'pt9'; it has pt1, dummy"),
        (RIG, "pt1", {}, InputError, "lists no tag that stands still"),
        (RIG + ANCHOR, "pt1", {"yes": False}, InputError, "say --yes where nobody can be asked"),
        (
            RIG + ANCHOR,
            "pt1",
            {"pan_deg": (60.0, -60.0)},
            InputError,
            "give the lower first, within the file's -90 to 90",
        ),
        (RIG + ANCHOR, "pt1", {"pan_deg": (-120.0, 60.0)}, InputError, "within the file's -90 to 90"),
        (RIG + ANCHOR, "dummy", {}, InputError, "its driver fake cannot be calibrated"),
        (BLIND, "pt1", {"pan_deg": (-5.0, 5.0)}, InputError, "pt1 tells no angles, so --pan-deg and --tilt-deg cannot"),
        (RIG + ANCHOR, "pt1", {}, HardwareError, "/dev/none"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(
    tmp_path: Path, text: str, name: str, options: dict[str, Any], error: type[CamrigError], said: str
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(error, match=said):
        head(path, name, **{"yes": True, "write": True, **options})
    assert path.read_text() == text


@pytest.mark.parametrize(
    ("text", "report", "said"),
    [
        (RIG + ANCHOR, "rig.yaml", "--report .*rig.yaml would overwrite .*, which is read"),
        (RIG + ANCHOR, "none/page.html", "--report: .*page.html cannot be written: there is no folder"),
        (
            RIG.replace("address: 1", "address: 1, axes: &both {pan: {sign: 1}}").replace(
                "driver: fake, position", "driver: pelco_d, port: /dev/none, address: 2, axes: *both, position"
            )
            + ANCHOR,
            "page.html",
            "cannot take what --write would set: heads.pt1.axes.pan.sign: stands in what is shared",
        ),
    ],
)
def test_files_that_cannot_be_written_are_told_before_anything_moves(
    tmp_path: Path, text: str, report: str, said: str
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):  # and not that /dev/none cannot be opened
        head(path, "pt1", yes=True, write=True, report=tmp_path / report)
    assert path.read_text() == text


def test_who_is_asked_learns_how_far_a_head_that_tells_nothing_is_turned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(BLIND)
    with pytest.raises(InputError, match="this moves head pt1: say --yes"):
        head(path, "pt1")
    assert "14 deg to either side of where it stands, pan limits or not" in " ".join(capsys.readouterr().err.split())


def test_exit_code_and_no_traceback(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG + ANCHOR)
    command = [sys.executable, "-m", "camrig", "calibrate", "head", str(path), "pt1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, stdin=subprocess.DEVNULL)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "error: this moves head pt1" in done.stderr
