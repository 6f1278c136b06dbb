"""``camrig calibrate intrinsics`` on real and drawn pictures: answers, files, exit codes, sentences."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from camrig.calibrate.boards import parse_board
from camrig.cli.main import build
from camrig.config.kept_file import former
from camrig.config.lenses import ZoomLensModel
from camrig.config.rig_file import load_rig
from camrig.errors import CamrigError, InputError, PartialError
from camrig.geometry.lens import BrownLens, FisheyeLens
from tests.drawn_boards import BoardCamera

LENS = BrownLens((480, 360), (420.0, 420.5), (243.0, 176.0), (-0.2, 0.05, 0.0, 0.0))
BOARD = "charuco:7x5:40:30:4x4_1000"
RIG = """\
rig: ceiling  # by the door
space: {floor_m: [[-1, -1], [1, 1]]}
lenses:
  plain: {size_px: [480, 360], fx: 400, fy: 400, cx: 239.5, cy: 179.5, readout_s: 0.01}  # from the data sheet
cameras:
  - {id: north, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [0, 0, 1.6], pan_deg: 90}}}
  - {id: south, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [0, 0, 1.6], pan_deg: 90}}}
"""


def answer(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """Run the command here and return its last line of JSON."""
    capsys.readouterr()
    command = ["calibrate", "intrinsics", *map(str, arguments), "--json"]
    build(("calibrate",))(command, standalone_mode=False)
    found: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return found


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve pictures of a ChArUco board, and the rig whose camera took them."""
    folder = tmp_path_factory.mktemp("drawn")
    (folder / "shots").mkdir()
    camera = BoardCamera(LENS, parse_board(BOARD))
    for index, T in enumerate(camera.poses(12)):
        cv2.imwrite(str(folder / "shots" / f"{index:02d}.png"), camera.draw(T))
    (folder / "rig.yaml").write_text(RIG)
    return folder


@pytest.mark.parametrize(
    ("pictures", "sheet", "reference"),
    [
        ("swatbotics_chessboard_calib", "swatbotics_chessboard_calib/expected_intrinsics.json", "camera"),
        ("opencv_stereo_chessboard/left*.jpg", "opencv_stereo_chessboard/expected_intrinsics.json", "left"),
        ("opencv_stereo_chessboard/right*.jpg", "opencv_stereo_chessboard/expected_intrinsics.json", "right"),
    ],
)
def test_real_chessboards_are_as_good_as_the_reference_with_no_more_numbers(
    shared_data: Path, capsys: pytest.CaptureFixture[str], pictures: str, sheet: str, reference: str
) -> None:
    images = shared_data / "images"
    expected = json.loads((images / sheet).read_text())[reference]
    columns, rows = expected["inner_corners"]
    board = f"chessboard:{columns}x{rows}:{1000 * expected['square_m']:g}"
    found = answer(capsys, "--from-images", images / pictures, "--board", board, "--kind", "brown")
    assert found["board"] == board
    assert found["views"] == expected["used"]
    assert found["rms_px"] <= 1.02 * expected["rms_px"]
    assert found["heldout_rms_px"] <= 1.15 * found["rms_px"]
    assert len(found["distortion"]) <= 5
    for key, allowed in (("fx", "fx_fy_abs"), ("fy", "fx_fy_abs"), ("cx", "cx_cy_abs"), ("cy", "cx_cy_abs")):
        assert found[key] == pytest.approx(expected[key], abs=expected["tolerance"][allowed])
    assert found["verdict"] in {"green", "amber"}


def test_a_real_board_inverted_and_seen_from_behind_is_recognised_and_says_not_enough_data(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = shared_data / "images" / "caliscope_4cam_charuco" / "cam_1.mp4"
    found = answer(capsys, "--from-video", video, "--square-mm", "54")
    assert found["board"].startswith("charuco:4x5:54:")
    assert found["board"].endswith(":4x4_1000:inverted")
    assert found["fx"] == pytest.approx(704.0, rel=0.06)
    assert any("not enough data" in warning for warning in found["warnings"])


def test_drawn_pictures_give_the_lens_that_drew_them_and_the_rig_gets_it(
    drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], picture_fonts: None
) -> None:
    rig, page, lens = tmp_path / "rig.yaml", tmp_path / "lens.html", tmp_path / "lens.yaml"
    rig.write_text(RIG)
    found = answer(
        capsys, rig, "north", "--from-images", drawn / "shots", "--square-mm", 40,
        "--write", "--out", lens, "--report", page,
    )  # fmt: skip
    assert found["fx"] == pytest.approx(420.0, abs=4.0 * found["sigma"]["fx"])
    assert found["cx"] == pytest.approx(243.0, abs=4.0 * found["sigma"]["cx"])
    assert found["change_px"]["worst"] > 1.0
    assert found["written"] == [str(rig), str(lens), str(page)]
    written = load_rig(rig).rig
    assert written.cameras["north"].lens.focal_px[0] == pytest.approx(found["fx"], abs=1e-3)
    assert written.cameras["north"].readout_s == 0.01
    assert written.cameras["north"].lens_sigma[0] == pytest.approx(found["sigma"]["fx"] / found["fx"], rel=0.01)
    assert written.cameras["south"].lens.focal_px == (400.0, 400.0)
    assert "# by the door" in rig.read_text()
    assert former(rig).read_text() == RIG
    assert "<svg" in page.read_text()
    assert yaml.safe_load(lens.read_text())["lenses"]["north"]["fx"] == pytest.approx(found["fx"], abs=1e-3)


def test_a_table_of_zoom_is_filled_row_by_row(drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lens = tmp_path / "zoom.yaml"
    known = ("--from-images", drawn / "shots", "--board", BOARD, "--kind", "fisheye", "--out", lens)
    for position in (200, 0):
        answer(capsys, *known, "--zoom-position", position)
    table = yaml.safe_load(lens.read_text())["lenses"]["lens"]
    assert [row["position"] for row in table["zoom"]] == [0, 200]
    assert ZoomLensModel.model_validate(table).build()[0][1].focal_px[0] == table["zoom"][0]["fx"]


def test_a_fisheye_and_an_aprilgrid_of_unknown_gap_are_recognised_and_corners_follow_the_bend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lens = FisheyeLens((480, 360), (160.0, 160.4), (242.0, 178.0), (0.02, -0.005, 0.001, 0.0))
    camera = BoardCamera(lens, parse_board("aprilgrid:5x4:60:18"))
    for index, T in enumerate(camera.poses(10)):
        cv2.imwrite(str(tmp_path / f"{index:02d}.png"), camera.draw(T))
    found = answer(capsys, "--from-images", tmp_path, "--square-mm", 60)
    assert found["lens"] == "fisheye"
    assert found["board"].startswith("aprilgrid:5x4:60:")
    assert float(found["board"].split(":")[3]) == pytest.approx(18.0, abs=0.4)
    assert found["fx"] == pytest.approx(160.0, rel=0.004)
    assert found["cx"] == pytest.approx(242.0, abs=0.5)


def spoil(folder: Path, source: Path, kind: str) -> None:
    """Lay out pictures that are wrong in one way."""
    names = sorted(source.glob("*.png"))
    for name in names[:3] if kind == "few" else names:
        (folder / name.name).write_bytes(name.read_bytes())
    if kind == "sizes":
        cv2.imwrite(str(folder / "odd.png"), np.zeros((200, 300), np.uint8))
    if kind == "empty":
        for name in folder.glob("*.png"):
            cv2.imwrite(str(name), np.full((360, 480), 90, np.uint8))


@pytest.mark.parametrize(
    ("kind", "more", "says"),
    [
        ("sizes", (), r"odd\.png \(300x200 px\)"),
        ("few", (), "too few: take 10 or more"),
        ("empty", (), "no board is recognised"),
        ("wrong", ("--board", "charuco:9x8:40:30:6x6"), "they show what looks like --board charuco:7x5"),
    ],
)
def test_bad_pictures_are_one_sentence_and_no_file_is_touched(
    drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, more: tuple[str, ...], says: str
) -> None:
    folder, rig = tmp_path / "shots", tmp_path / "rig.yaml"
    folder.mkdir()
    rig.write_text(RIG)
    spoil(folder, drawn / "shots", kind)
    with pytest.raises(InputError, match=says):
        answer(capsys, rig, "north", "--from-images", folder, *more, "--write")
    assert rig.read_text() == RIG
    assert not former(rig).exists()


def test_a_damaged_picture_is_named_and_the_rest_is_done(
    drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(tmp_path, drawn / "shots", "")
    (tmp_path / "cut.png").write_bytes((tmp_path / "00.png").read_bytes()[:900])
    with pytest.raises(PartialError, match=r"cut\.png: is damaged"):
        answer(capsys, "--from-images", tmp_path, "--board", BOARD, "--kind", "fisheye")
    assert json.loads(capsys.readouterr().out)["views"] == 12


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "give pictures of the board"),
        (("--from-images", "nowhere"), "nowhere: no such file"),
        (("RIG", "--from-images", "SHOTS"), "whose lens is it"),
        (("RIG", "east", "--from-images", "SHOTS"), "has no camera 'east'; it has north, south"),
        (("--from-images", "SHOTS", "--write"), "--write needs the rig's file"),
        (("--from-images", "SHOTS", "--board", "chess:3"), "write chessboard:"),
        (("--from-images", "SHOTS", "--square-mm", "-1"), "--square-mm is above 0"),
        (("--from-images", "SHOTS", "--zoom-position", "3"), "give it, --out LENS.yaml"),
        (("RIG", "north", "--from-images", "SHOTS", "--out", "RIG"), "--out .* would overwrite .*rig.yaml, which is"),
        (("--from-images", "SHOTS", "--out", "a.yaml", "--report", "a.yaml"), "--report a.yaml is the file of --out"),
        (("--from-images", "SHOTS", "--report", "none/page.html"), "--report: none/page.html cannot be written"),
    ],
)
def test_wrong_arguments_are_one_sentence(
    drawn: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], says: str
) -> None:
    places = {"SHOTS": str(drawn / "shots"), "RIG": str(drawn / "rig.yaml")}
    with pytest.raises(CamrigError, match=says):
        answer(capsys, *(places.get(argument, argument) for argument in arguments))


def test_as_a_program_it_tells_people_and_ends_with_the_right_code(drawn: Path) -> None:
    command = [sys.executable, "-m", "camrig", "calibrate", "intrinsics", str(drawn / "rig.yaml"), "north"]
    done = subprocess.run(
        [*command, "--from-images", str(drawn / "shots"), "--board", BOARD, "--kind", "brown"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "at 3 m" in done.stdout
    assert "lens: {model: brown" in done.stdout
    assert "nothing is written" in done.stderr
