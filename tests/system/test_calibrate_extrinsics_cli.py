"""``camrig calibrate extrinsics`` on drawn pictures of a walked board: answers, exit codes, sentences."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camrig.cli.calibrate_extrinsics import extrinsics
from camrig.errors import InputError
from camrig.geometry.lens import BrownLens
from camrig.geometry.pose import difference, invert, perturb, transform
from camrig.geometry.rotation import rotation_x
from tests.drawn_rig import drawn

LENS = BrownLens((480, 360), (420.0, 420.0), (239.5, 179.5))
SIZE_M, ANCHOR_M = 0.12, 0.2
LOOKING_DOWN = transform(rotation_x(np.pi), np.array([0.0, 0.0, 1.6]))
CAMERAS = {"north": LOOKING_DOWN, "south": LOOKING_DOWN @ transform(rotation_x(0.1), np.array([0.25, 0.05, 0.0]))}
ANCHORS = {100 + k: transform(np.eye(3), np.array([0.65 * k - 0.3, -0.25, 0.0])) for k in range(2)}
BOARD = {k: transform(np.eye(3), np.array([0.16 * (k % 2), 0.16 * (k // 2), 0.0])) for k in range(4)}
RIG = """\
rig: ceiling
space: {floor_m: [[-1, -1], [1, 1]]}
lenses:
  plain: {size_px: [480, 360], fx: 420, fy: 420, cx: 239.5, cy: 179.5}
cameras:
  - {id: north, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [0, 0, 1.6], pan_deg: 90}}}
  - {id: south, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [0, 0, 1.6], pan_deg: 90}}}
anchors:
  - {id: 100, size_m: 0.2, T_world_tag: {position_m: [-0.3, -0.25, 0]}}
  - {id: 101, size_m: 0.2, T_world_tag: {position_m: [0.35, -0.25, 0]}}
"""


def camrig(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "camrig", "calibrate", "extrinsics", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of two cameras at eight instants, and the rig's file."""
    folder, rng = tmp_path_factory.mktemp("walk"), np.random.default_rng(2)
    (folder / "rig.yaml").write_text(RIG)
    for name in CAMERAS:
        (folder / name).mkdir()
    for instant in range(8):
        lift = transform(np.eye(3), np.array([0.0, 0.05, 0.3]))
        T_world_board = perturb(lift, rng.normal(size=6) * [0.08, 0.04, 0.05, 0.25, 0.25, 0.3])
        tags = {number: (T, ANCHOR_M) for number, T in ANCHORS.items()}
        tags |= {number: (T_world_board @ T, SIZE_M) for number, T in BOARD.items()}
        for name, T_world_camera in CAMERAS.items():
            cv2.imwrite(str(folder / name / f"{name}-{instant:03d}.png"), drawn(LENS, T_world_camera, tags))
    return folder


def answer(ended: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def pictures_of(walk: Path, *names: str) -> list[str]:
    return [part for name in names for part in ("--from-images", f"{name}={walk / name}")]


def test_cameras_are_placed_in_the_world_by_anchors_and_a_walked_board(walk: Path) -> None:
    ended = camrig(walk / "rig.yaml", *pictures_of(walk, "north", "south"), "--tag-size-m", SIZE_M, "--json")
    assert ended.returncode == 0, ended.stderr
    found = answer(ended)
    assert found["anchored"]
    assert found["median_px"] < 0.2
    assert found["links"] == [{"cameras": ["north", "south"], "shared": 10}]
    assert (found["missing_links"], found["unplaced"]) == ([], [])
    for name, T in CAMERAS.items():
        off = difference(T, np.array(found["cameras"][name]["T_world_camera"]))
        assert np.linalg.norm(off[:3]) < 0.01
        assert np.linalg.norm(off[3:]) < 0.01
    north, south = (found["cameras"][name] for name in CAMERAS)
    assert (north["pan_deg"], north["tilt_deg"], north["roll_deg"]) == pytest.approx((90.0, -90.0, 0.0), abs=0.6)
    assert (south["off_file_mm"], south["off_file_deg"]) == pytest.approx((255.0, 5.73), rel=0.1)
    for number, T in BOARD.items():
        board = invert(np.array(found["tags"]["tag36h11:0"]["T_board_tag"]))
        assert board @ np.array(found["tags"][f"tag36h11:{number}"]["T_board_tag"]) == pytest.approx(T, abs=0.01)


def test_people_get_a_table_and_each_camera_left_out_is_named(walk: Path, tmp_path: Path) -> None:
    """The other camera's pictures are black, one of them of another size."""
    for instant in range(3):
        size = (360, 480) if instant else (100, 100)
        cv2.imwrite(str(tmp_path / f"{instant}.png"), np.zeros(size, np.uint8))
    places = [*pictures_of(walk, "north"), "--from-images", f"south={tmp_path}"]
    ended = camrig(walk / "rig.yaml", *places, "--tag-size-m", SIZE_M)
    assert ended.returncode == 4
    assert "Cameras in the world" in ended.stdout
    assert "north" in ended.stdout
    assert "south shares no tag with the others" in " ".join(ended.stderr.split())
    assert "is 100x100 px" in ended.stderr


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("north", "write CAMERA=PICTURES"),
        ("west=x", "has no camera 'west'; it has north, south"),
        ("north=nowhere", "nowhere: no such file or folder"),
        ("north={walk}/north", "does not list tag36h11:0, tag36h11:1, tag36h11:2, tag36h11:3: give their size"),
    ],
)
def test_bad_input_is_one_sentence(walk: Path, place: str, says: str) -> None:
    with pytest.raises(InputError, match=re.escape(says)):
        extrinsics(walk / "rig.yaml", [place.format(walk=walk)])


def test_a_camera_is_named_once(walk: Path) -> None:
    with pytest.raises(InputError, match="'north' is there twice"):
        extrinsics(walk / "rig.yaml", ["north=a", "north=b"])
