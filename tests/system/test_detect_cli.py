"""``camrig detect`` as its users meet it: lines, exit codes, sentences."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camrig.cli.detect import detect
from camrig.errors import CamrigError, InputError, PartialError
from camrig.geometry.lens import BrownLens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, difference, transform
from camrig.geometry.rotation import rotation_exp
from camrig.rig import TagKey
from camrig_emulators.tag_pictures import WHITE, tag_texture

LENS = BrownLens((320, 240), (300.0, 300.0), (159.5, 119.5))
LENS_KEYS = "size_px: [320, 240]\nfx: 300\nfy: 300\ncx: 159.5\ncy: 119.5\n"
T_CAMERA_TAG = transform(
    rotation_exp(np.array([0.4, -0.5, 0.1])) @ rotation_exp(np.array([np.pi, 0.0, 0.0])), np.array([0.05, -0.02, 0.6])
)
SIZE_M = 0.15


@pytest.fixture
def tag_picture(tmp_path: Path) -> Path:
    """A tag at a known pose before a known lens, drawn eight times too large and averaged."""
    texture = tag_texture(TagKey("tag36h11", 42), 16)
    edge, far = 15.5, len(texture) - 16.5
    corners = LENS.project(apply(T_CAMERA_TAG, SIZE_M * TAG_CORNERS))
    T_image_texture = cv2.getPerspectiveTransform(
        np.array([[edge, far], [far, far], [far, edge], [edge, edge]], np.float32),
        ((corners + 0.5) * 8.0 - 0.5).astype(np.float32),
    )
    large = cv2.warpPerspective(texture, T_image_texture, (2560, 1920), borderValue=WHITE)
    path = tmp_path / "tag.png"
    cv2.imwrite(str(path), cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA))
    return path


@pytest.fixture
def bad_files(tmp_path: Path, tag_picture: Path) -> Path:
    """A folder of what is called a picture and is none."""
    folder = tmp_path / "bad"
    folder.mkdir()
    good = tag_picture.read_bytes()
    (folder / "cut.png").write_bytes(good[: len(good) // 2])
    (folder / "empty.png").write_bytes(b"")
    (folder / "huge.pgm").write_bytes(b"P5 100000 100000 255\n" + bytes(1000))
    (folder / "noise.jpg").write_bytes(np.random.default_rng(0).bytes(3_000_000))
    (folder / "noise.mp4").write_bytes(np.random.default_rng(1).bytes(100_000))
    (folder / "text.tif").write_text("no picture")
    cv2.imwrite(str(folder / "tiny.png"), np.zeros((15, 400), np.uint8))
    return folder


def lines(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "camrig", "detect", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_line_has_exactly_the_documented_keys(tag_picture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    detect([str(tag_picture)], as_json=True)
    (line,) = lines(capsys.readouterr().out)
    assert list(line) == ["image", "frame", "size_px", "tags", "detect_s"]
    assert (line["image"], line["frame"], line["size_px"]) == (str(tag_picture), 0, [320, 240])
    assert 0.0 < line["detect_s"] < 10.0
    (tag,) = line["tags"]
    assert list(tag) == ["family", "id", "hamming", "margin", "center_px", "corners_px", "pose", "refined"]
    assert (tag["family"], tag["id"], tag["hamming"], tag["pose"]) == ("tag36h11", 42, 0, None)
    expected = LENS.project(apply(T_CAMERA_TAG, SIZE_M * TAG_CORNERS))
    np.testing.assert_allclose(tag["corners_px"], expected, atol=0.1)
    np.testing.assert_allclose(tag["center_px"], LENS.project(T_CAMERA_TAG[:3, 3]), atol=0.1)
    np.testing.assert_array_equal(np.round(tag["corners_px"], 3), tag["corners_px"])


@pytest.mark.parametrize("text", [LENS_KEYS, f"lenses: {{lab: {{{LENS_KEYS.strip().replace(chr(10), ', ')}}}}}"])
def test_a_lens_gives_the_tags_pose(
    tag_picture: Path, tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    detect([str(tag_picture)], lens=tmp_path / "lens.yaml", tag_size_m=SIZE_M, as_json=True)
    pose = lines(capsys.readouterr().out)[0]["tags"][0]["pose"]
    assert list(pose) == ["T_camera_tag", "sigma_m", "alternatives"]
    error = difference(T_CAMERA_TAG, np.array(pose["T_camera_tag"]))
    assert np.all(np.abs(error[:3]) < 4.0 * np.array(pose["sigma_m"]))
    assert np.all(np.array(pose["sigma_m"]) < 0.005)
    assert pose["alternatives"] == 0


def test_corners_are_refined_through_the_lens_unless_told_not_to(
    tag_picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lens.yaml").write_text(LENS_KEYS)
    found = {}
    for refine in (None, False):
        detect([str(tag_picture)], lens=tmp_path / "lens.yaml", refine=refine, as_json=True)
        (found[refine],) = lines(capsys.readouterr().out)[0]["tags"]
    assert (found[None]["refined"], found[False]["refined"]) == ([True] * 4, [False] * 4)
    assert found[None]["pose"] is None
    expected = LENS.project(apply(T_CAMERA_TAG, SIZE_M * TAG_CORNERS))
    off_px = {refine: np.abs(np.array(tag["corners_px"]) - expected).max() for refine, tag in found.items()}
    assert off_px[None] < min(0.03, off_px[False])


def test_every_bad_file_has_a_line_and_the_good_ones_are_still_done(
    tag_picture: Path, bad_files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(PartialError, match="8 of 9 pictures could not be used") as raised:
        detect([str(bad_files), str(bad_files / "noise.mp4"), str(tag_picture), f"{bad_files}/*.gif"], as_json=True)
    told = {Path(line["image"]).name: line for line in lines(capsys.readouterr().out)}
    assert [tag["id"] for tag in told.pop("tag.png")["tags"]] == [42]
    assert {name: line["error"] for name, line in told.items()} == {
        "*.gif": "no such file or folder",
        "cut.png": "is damaged or ends early",
        "empty.png": "is empty",
        "huge.pgm": "is no picture that can be decoded: pixels <= CV_IO_MAX_IMAGE_PIXELS",
        "noise.jpg": "is no picture",
        "noise.mp4": "is no video that can be decoded",
        "text.tif": "is no picture",
        "tiny.png": "a picture of 400x15 px is too small to search; a side needs 16 px",
    }
    assert all(name in str(raised.value) for name in told)


def test_where_nothing_could_be_read_it_is_bad_input(bad_files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="1 of 1 pictures could not be used"):
        detect([str(bad_files / "text.tif")], as_json=True)
    assert len(lines(capsys.readouterr().out)) == 1


def test_the_program_ends_with_the_documented_code_and_no_traceback(tag_picture: Path, bad_files: Path) -> None:
    for arguments, code in [((tag_picture,), 0), ((tag_picture, bad_files), 4), ((bad_files, "--json"), 2)]:
        ended = run(*arguments)
        assert ended.returncode == code, ended.stderr
        assert "Traceback" not in ended.stderr
        assert bool(ended.stderr) == (code != 0)


def test_people_read_a_table(tag_picture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    detect([str(tag_picture)])
    out = capsys.readouterr().out
    assert "42" in out
    assert "320x240" in out


def test_annotated_pictures_are_written(tag_picture: Path, tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").write_text(LENS_KEYS)
    drawn = tmp_path / "new" / "drawn"
    detect([str(tag_picture)], lens=tmp_path / "lens.yaml", tag_size_m=SIZE_M, draw=drawn, as_json=True)
    (path,) = drawn.iterdir()
    picture = cv2.imread(str(path))
    assert picture is not None
    assert picture.shape == (240, 320, 3)
    bottom = LENS.project(apply(T_CAMERA_TAG, SIZE_M * TAG_CORNERS))[:2].mean(axis=0).round().astype(int)
    blue, green, red = picture[bottom[1], bottom[0]].tolist()
    assert red > 200 > green > blue  # the bottom side


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"detector": "nope"}, r"no driver 'nope'.*installed: opencv, pupil, pyapriltags"),
        ({"families": "tag36h11,tag36h12"}, r"--families: unknown family 'tag36h12'; this detector has tag16h5"),
        ({"families": "tag36h11,tag25h9", "detector": "pupil"}, r"--families: .*give one, or use pyapriltags"),
        ({"families": "tagStandard52h13"}, r"needs 3 GB"),
        ({"decimate": 2.5}, r"--decimate: must be one of 1, 1\.5, 2, 3, 4"),
        ({"border_bits": 2}, r"detector pyapriltags has no --border-bits"),
        ({"border_bits": 3, "detector": "opencv"}, r"--border-bits: Input should be 1 or 2"),
        ({"tag_size_m": 0.1}, r"--tag-size-m gives a pose only with --lens"),
        ({"refine": True}, r"--refine needs --lens"),
        ({"lens": Path("gone.yaml")}, r"gone.yaml: cannot be read"),
        ({"lens": Path("gone.yaml"), "tag_size_m": 0.1}, r"gone.yaml: cannot be read"),
        ({"lens": Path("gone.yaml"), "tag_size_m": -1.0}, r"--tag-size-m is metres above 0"),
        ({"draw": Path("/proc/nowhere")}, r"--draw: folder /proc/nowhere cannot be made"),
    ],
)
def test_a_wrong_option_is_one_sentence(tag_picture: Path, options: dict[str, Any], why: str) -> None:
    with pytest.raises(CamrigError, match=why) as raised:
        detect([str(tag_picture)], **options)
    assert raised.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("size_px: [320, 240]\n", r"fx: is missing"),
        (LENS_KEYS + "fz: 1\n", r"lens.yaml:6: fz: "),
        (f"lenses: {{a: {{{LENS_KEYS.strip().replace(chr(10), ', ')}}}, b: {{}}}}", r"must hold exactly one lens"),
        ("lenses: 3", r"must hold exactly one lens"),
        (": [", r"is not valid YAML"),
    ],
)
def test_a_wrong_lens_file_is_named_with_line_and_key(tag_picture: Path, tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    with pytest.raises(InputError, match=why):
        detect([str(tag_picture)], lens=tmp_path / "lens.yaml", tag_size_m=SIZE_M)


def test_a_lens_of_another_size_is_refused_for_each_picture(
    tag_picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lens.yaml").write_text(LENS_KEYS.replace("320, 240", "640, 480"))
    with pytest.raises(InputError):
        detect([str(tag_picture)], lens=tmp_path / "lens.yaml", tag_size_m=SIZE_M, as_json=True)
    assert lines(capsys.readouterr().out)[0]["error"] == "is 320x240 px, the lens 640x480 px"
