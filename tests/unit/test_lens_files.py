"""Lenses from and for other programs: round trips, real files, and what a format cannot say is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from camrig.cli.main import build
from camrig.config.lens_files import LensFormat, read_lenses, write_lens
from camrig.config.lenses import LensModel
from camrig.config.rig_file import load_rig
from camrig.errors import ConfigError, InputError
from camrig.geometry.lens.errors import TYPICAL_SIGMA

FX = 894.5288733178912


def lens_of(model: Literal["brown", "fisheye"], *distortion: float) -> LensModel:
    return LensModel(model=model, size_px=(1280, 720), fx=FX, fy=896.8778, cx=624.01, cy=361.28, distortion=distortion)


LENSES = {
    "plain": lens_of("brown", -0.3, 0.1, 1e-4, -2e-4),
    "k3": lens_of("brown", -0.3, 0.1, 1e-4, -2e-4, 0.01),
    "rational": lens_of("brown", 0.3, 0.1, 1e-4, -2e-4, 0.01, 0.5, 0.05, 0.01),
    "prism": lens_of("brown", 0.3, 0.1, 0.0, 0.0, 0.01, 0.5, 0.05, 0.01, 1e-4, 0.0, 1e-4, 0.0),
    "fisheye": lens_of("fisheye", 0.02, -0.005, 0.001, 0.0),
}
UNSPEAKABLE = {(LensFormat.ROS, "prism"), (LensFormat.KALIBR, "k3"), (LensFormat.KALIBR, "rational"),
               (LensFormat.KALIBR, "prism")}  # fmt: skip
RIG = """\
rig: lab
space: {floor_m: [[0, 0], [1, 1]]}
lenses: {own: {size_px: [640, 480], fx: 500, fy: 500, cx: 320, cy: 240}}
cameras: [{id: north, lens: own, source: {driver: fake}, mount: {fixed: {position_m: [0, 0, 2]}}}]
"""


@pytest.mark.parametrize("how", LensFormat)
@pytest.mark.parametrize("name", LENSES)
def test_a_lens_comes_back_as_it_went_or_is_refused(how: LensFormat, name: str) -> None:
    lens = LENSES[name]
    if (how, name) in UNSPEAKABLE:
        with pytest.raises(InputError, match=r"alone|no words"):
            write_lens(lens, name, how)
        return
    found_how, found = read_lenses(write_lens(lens, name, how), "file")
    assert found_how is how
    (back,) = found.values()
    assert back.size_px == lens.size_px
    assert back.model == lens.model
    assert (back.fx, back.fy, back.cx, back.cy) == (lens.fx, lens.fy, lens.cx, lens.cy)
    assert back.build().distortion == pytest.approx(lens.build().distortion, abs=0.0)


def test_opencv_reads_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "lens.yml"
    path.write_text(write_lens(LENSES["k3"], "north", LensFormat.OPENCV))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat()[0], [FX, 0.0, 624.01])
    assert storage.getNode("distortion_coefficients").mat().shape == (5, 1)
    storage.release()


def test_opencvs_own_sample_is_read(shared_data: Path) -> None:
    text = (shared_data / "images" / "opencv_stereo_chessboard" / "left_intrinsics.yml").read_text()
    how, lenses = read_lenses(text, "left")
    assert how is LensFormat.OPENCV
    assert lenses["left"].fx == pytest.approx(535.91573396163199)
    assert lenses["left"].size_px == (640, 480)
    assert lenses["left"].distortion[4] == pytest.approx(0.23839153)


def test_every_camera_of_a_camchain_is_read() -> None:
    one = write_lens(LENSES["plain"], "north", LensFormat.KALIBR)
    other = write_lens(LENSES["fisheye"], "south", LensFormat.KALIBR).replace("cam0", "cam1")
    _, lenses = read_lenses(one + other, "file")
    assert {name: lens.model for name, lens in lenses.items()} == {"cam0": "brown", "cam1": "fisheye"}


def test_a_file_without_a_size_asks_for_it() -> None:
    lines = write_lens(LENSES["plain"], "north", LensFormat.OPENCV).splitlines()
    text = "\n".join(line for line in lines if not line.startswith("image_"))
    with pytest.raises(InputError, match="--size-px WIDTHxHEIGHT"):
        read_lenses(text, "north")
    assert read_lenses(text, "north", (1280, 720))[1]["north"].size_px == (1280, 720)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is neither"),
        ("rig: lab", "is neither"),
        ("a: [", "is no YAML"),
        ("%YAML:1.0\n---\na: [", "FileStorage"),
        ("%YAML:1.0\n---\na: 1\n", "has no 3x3 matrix"),
        ("camera_matrix: {data: [1, 2]}\ndistortion_model: plumb_bob", "lacks or spoils"),
        ("camera_matrix: {}\ndistortion_model: double_sphere", "distortion_model is one of"),
        (
            (
                "image_width: .inf\nimage_height: 480\ncamera_matrix: {data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n"
                "distortion_coefficients: {data: [0]}\ndistortion_model: plumb_bob"
            ),
            "lacks or spoils",
        ),
        (
            "cam0: {camera_model: pinhole, intrinsics: [1, 1, 1, 1], distortion_model: radtan, resolution: [.inf, 1]}",
            "lacks or spoils",
        ),
        (
            (
                "%YAML:1.0\n---\nimage_width: .Inf\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"
                "   cols: 3\n   dt: d\n   data: [500., 0., 320., 0., 500., 240., 0., 0., 1.]\n"
            ),
            "width and height are whole numbers, not inf",
        ),
        ("cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4, 5], distortion_model: radtan}", "pinhole-radtan"),
    ],
)
def test_what_is_no_lens_is_one_sentence(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as error:
        read_lenses(text, "file")
    assert "\n" not in str(error.value)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(st.text(max_size=200) | st.binary(max_size=200).map(lambda data: "%YAML:1.0\n---\n" + data.decode("latin-1")))
def test_any_text_is_a_lens_or_one_sentence(text: str) -> None:
    try:
        read_lenses(text, "file")
    except InputError:
        return


def test_import_and_export_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, file = tmp_path / "rig.yaml", tmp_path / "north.yaml"
    rig.write_text(RIG)

    def run(*arguments: object) -> str:
        build(("calibrate",))(["calibrate", *map(str, arguments)], standalone_mode=False)
        return capsys.readouterr().out

    run("export", rig, "own", "--format", "kalibr", "--out", file)
    file.write_text(file.read_text().replace("500.0", "512.5", 1))
    told = json.loads(run("import", file, "--json"))
    assert told["format"] == "kalibr"
    assert told["lenses"]["cam0"]["fx"] == 512.5
    assert rig.read_text() == RIG
    run("import", file, rig, "north", "--write")
    assert load_rig(rig).rig.cameras["north"].lens.focal_px == (512.5, 500.0)
    assert "fx: 512.5" in run("import", file)
    with pytest.raises(InputError, match="has no lens 'other'; it has own"):
        run("export", rig, "other")
    with pytest.raises(InputError, match="cannot be read: No such file"):
        run("import", tmp_path / "nowhere.yaml")


def command(*arguments: object) -> None:
    build(("calibrate",))(["calibrate", *map(str, arguments)], standalone_mode=False)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A lens of ROS's, and a rig."""
    lens, rig = tmp_path / "lens.yml", tmp_path / "rig.yaml"
    lens.write_text(write_lens(LENSES["plain"], "cam", LensFormat.ROS))
    rig.write_text(RIG)
    return lens, rig


def test_no_file_that_is_read_is_overwritten(files: tuple[Path, Path]) -> None:
    lens, rig = files
    for asked in (("import", lens, rig, "north", "--out", rig), ("import", lens, "--out", lens),
                  ("export", rig, "own", "--out", rig), ("export", rig, "own", "--out", f"{rig}~")):  # fmt: skip
        with pytest.raises(InputError, match="would overwrite"):
            command(*asked)
    assert rig.read_text() == RIG


def test_an_imported_lens_does_not_keep_the_sigma_of_the_former(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    lens, rig = files
    rig.write_text(RIG.replace("lens: own,", "lens: own, lens_sigma: {f_percent: 0.001},"))
    command("import", lens, rig, "north", "--write")
    assert load_rig(rig).rig.cameras["north"].lens_sigma == TYPICAL_SIGMA
    assert "lens_sigma was of its former lens" in capsys.readouterr().err


def test_a_rig_that_is_given_is_looked_at_though_nothing_is_written(files: tuple[Path, Path]) -> None:
    lens, rig = files
    with pytest.raises(InputError, match="has no camera 'south'; it has north"):
        command("import", lens, rig, "south")
    rig.write_text("rig: 3\n")
    with pytest.raises(ConfigError):
        command("import", lens, rig)
