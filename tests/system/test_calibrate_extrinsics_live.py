"""``camrig calibrate extrinsics --live`` on an emulated head: asked first, within limits, back where it was."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from camrig.calibrate.stops import MARGIN_RAD, MOST, stops_over
from camrig.cli.calibrate_extrinsics import extrinsics
from camrig.errors import InputError
from camrig.geometry.lens import BrownLens

RIG = """\
rig: live
space: {floor_m: [[0, 0], [5, 4]]}
lenses:
  lab: {model: brown, size_px: [640, 480], fx: 420, fy: 420, cx: 320, cy: 240}
cameras:
  - {id: eye, lens: lab, source: {driver: rendered, fps: 10}, mount: {head: pt1}}
  - id: wall
    lens: lab
    source: {driver: rendered, fps: 10}
    mount: {fixed: {position_m: [0.2, 2, 2.5], tilt_deg: -45}}
heads:
  - id: pt1
    driver: pelco_d
    baud: 9600
    gap_s: 0.02
    position_m: [2.5, 2, 2.8]
    pan_deg: [-25, 45]
    tilt_deg: [-70, -40]
anchors:
  - {id: 100, size_m: 0.2, T_world_tag: {position_m: [3.5, 2.0, 0]}}
  - {id: 101, size_m: 0.2, T_world_tag: {position_m: [4.2, 2.9, 0]}}
  - {id: 104, size_m: 0.2, T_world_tag: {position_m: [1.6, 2.4, 0]}}
  - {id: 106, size_m: 0.2, T_world_tag: {position_m: [1.4, 1.4, 0]}}
detector: {driver: pyapriltags, decimate: 2.0, families: [tag36h11]}
world:
  driver: emulated
  seed: 1
  heads: {pt1: {start_pan_deg: 20, start_tilt_deg: -50, backlash_deg: 0.1, start_latency_s: 0.05}}
"""


def test_a_rig_looks_round_and_finds_where_it_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig_yaml = tmp_path / "rig.yaml"
    rig_yaml.write_text(RIG)
    extrinsics(rig_yaml, live=True, yes=True, as_json=True)
    captured = capsys.readouterr()
    assert re.search(r"pt1 will go to \d aims, pan -25 to 45 deg, tilt -70 to -40 deg", captured.err)
    found = json.loads(captured.out)
    assert found["verdict"] == "green", found["reasons"]
    head, wall = found["heads"]["pt1"], found["cameras"]["wall"]
    assert head["off_file_mm"] < 3.0
    assert head["off_file_deg"] < 0.15
    assert wall["off_file_mm"] < 5.0
    assert len(head["aims_off_deg"]) >= 3
    assert np.abs(head["aims_off_deg"]).max() < 0.2


def test_nothing_moves_without_a_word(tmp_path: Path) -> None:
    rig_yaml = tmp_path / "rig.yaml"
    rig_yaml.write_text(RIG)
    with pytest.raises(InputError, match="this moves head pt1: say --yes where nobody can be asked"):
        extrinsics(rig_yaml, live=True)
    with pytest.raises(InputError, match="--from-images CAMERA=PICTURES, or --live"):
        extrinsics(rig_yaml)
    with pytest.raises(InputError, match="--from-images CAMERA=PICTURES, or --live"):
        extrinsics(rig_yaml, ["eye=x"], live=True)


@pytest.mark.parametrize("size_px", [(1280, 720), (320, 240)])
def test_stops_are_within_limits_few_and_leave_no_gap(size_px: tuple[int, int]) -> None:
    lens = BrownLens(size_px, (800.0, 800.0), (0.5 * size_px[0], 0.5 * size_px[1]))
    pan, tilt = (-2.0, 2.5), (-1.4, -0.2)
    aims = np.array(stops_over(pan, tilt, lens))
    assert len(aims) <= MOST
    for at, (low, high) in zip(aims.T, (pan, tilt), strict=True):
        assert at.min() == pytest.approx(low + MARGIN_RAD)
        assert at.max() == pytest.approx(high - MARGIN_RAD)
    turns = np.abs(np.diff(aims, axis=0))
    assert ((turns > 1e-9).sum(axis=1) == 1).all()
    assert np.array(stops_over((0.1, 0.11), tilt, lens))[:, 0] == pytest.approx(0.105)
