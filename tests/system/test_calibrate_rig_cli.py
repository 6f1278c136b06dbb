"""``camrig calibrate extrinsics``, ``body`` and ``check`` on drawn pictures: what is written and said, exit codes."""

from __future__ import annotations

import json
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camrig.calibrate.body import Layout, layout
from camrig.cli.calibrate_body import body
from camrig.cli.calibrate_check import check
from camrig.cli.calibrate_extrinsics import extrinsics
from camrig.config.kept_file import former
from camrig.config.rig_file import load_rig
from camrig.errors import InputError, PartialError
from camrig.geometry.arrays import Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.pose import difference, invert, perturb, transform
from camrig.geometry.rotation import rotation_exp, rotation_z
from camrig.rig import FixedMount
from tests.drawn_rig import drawn

pytestmark = pytest.mark.usefixtures("picture_fonts")

LENS = BrownLens((640, 480), (560.0, 560.0), (319.5, 239.5))
ANCHOR_M, TAG_M = 0.2, 0.12
RIG = """\
rig: lab   # the one upstairs
space: {floor_m: [[-1, -1], [1, 1]]}
lenses:
  plain: {size_px: [640, 480], fx: 560, fy: 560, cx: 319.5, cy: 239.5}
cameras:
  # looks at the door
  - {id: west, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [-0.9, 0, 2.0], pan_deg: 0, tilt_deg: -70}}}
  - {id: east, lens: plain, source: {driver: fake}, mount: {fixed: {position_m: [0.9, 0, 2.0], pan_deg: 180, tilt_deg: -70}}}
  - {id: north, lens: plain, source: {driver: fake}, mount: {head: pt1}}
heads:
  - {id: pt1, driver: fake, position_m: [0, 0.5, 2.0], bias_deg: 0.2}
targets:
  - id: robot
    tags:
      - {id: 7, size_m: 0.12, T_body_tag: {position_m: [0, 0, 0.1]}}
      - {id: 8, size_m: 0.12}   # nobody measured that
      - {id: 9, size_m: 0.12}
anchors:
  - {id: 100, size_m: 0.2, T_world_tag: {position_m: [-0.3, -0.25, 0]}}
  - {id: 101, size_m: 0.2, T_world_tag: {position_m: [0.35, -0.25, 0]}}
"""  # noqa: E501 - as people write it
ANCHORS = {100: [-0.3, -0.25, 0.0], 101: [0.35, -0.25, 0.0]}
FREE = {110: [-0.35, 0.25, 0.0], 111: [0.3, 0.3, 0.0]}
ON_ROBOT: dict[int, Transform] = {
    7: transform(np.eye(3), np.array([0.0, 0.0, 0.1])),
    8: transform(rotation_exp(np.array([0.5, 0.0, 0.0])), np.array([0.0, -0.17, 0.08])),
    9: transform(rotation_exp(np.array([0.0, 0.5, 0.3])), np.array([0.17, 0.0, 0.07])),
}


def looking(position_m: list[float], pan_deg: float, tilt_deg: float, roll_deg: float) -> Transform:
    R = aim_rotation(np.radians(pan_deg), np.radians(tilt_deg)) @ R_MOUNT_OPTICAL
    return transform(R @ rotation_z(np.radians(roll_deg)), np.array(position_m))


TRUE = {"west": looking([-0.95, 0.04, 2.03], 3.0, -66.0, 5.0), "east": looking([0.88, 0.02, 1.96], 178.0, -68.0, -4.0)}
HEAD = PanTilt(transform(rotation_z(0.3), np.array([0.04, 0.55, 1.97])))
MOUNT = transform(R_MOUNT_OPTICAL, np.zeros(3))
AIMS_DEG = [(-110, -70), (-70, -75), (-100, -85), (-130, -80)]


def standing() -> dict[int, tuple[Transform, float]]:
    tags = {number: (transform(np.eye(3), np.array(at)), ANCHOR_M) for number, at in ANCHORS.items()}
    return tags | {number: (transform(np.eye(3), np.array(at)), TAG_M) for number, at in FREE.items()}


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot carried past two fixed cameras, a camera on a head at four aims, pictures of the robot alone."""
    folder, rng = tmp_path_factory.mktemp("taken"), np.random.default_rng(3)
    (folder / "rig.yaml").write_text(RIG)
    for name in (*TRUE, "north", "robot"):
        (folder / name).mkdir()
    for k in range(6):
        lift = transform(np.eye(3), np.array([0.0, 0.0, 0.15]))
        T_robot = perturb(lift, rng.normal(size=6) * [0.12, 0.1, 0.05, 0.15, 0.15, 1.0])
        tags = standing() | {number: (T_robot @ T, TAG_M) for number, T in ON_ROBOT.items()}
        for name, T in TRUE.items():
            cv2.imwrite(str(folder / name / f"{name}-{k:03d}.png"), drawn(LENS, T, tags))
    for k, (pan, tilt) in enumerate(AIMS_DEG):
        T = HEAD.T_world_camera(np.radians(pan), np.radians(tilt), MOUNT)
        cv2.imwrite(str(folder / "north" / f"n-{k:03d}_pan{pan:+.1f}_tilt{tilt:+.1f}.png"), drawn(LENS, T, standing()))
    for k in range(8):
        near = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.9]))
        T_camera_robot = perturb(near, rng.normal(size=6) * [0.05, 0.05, 0.1, 0.35, 0.35, 1.0])
        tags = {number: (T, TAG_M) for number, T in ON_ROBOT.items()}
        cv2.imwrite(str(folder / "robot" / f"{k}.png"), drawn(LENS, invert(T_camera_robot), tags))
    return folder


@pytest.fixture
def rig_yaml(taken: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(taken / "rig.yaml", tmp_path))


def pictures(taken: Path, *names: str) -> list[str]:
    return [f"{name}={taken / name}" for name in names]


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_cameras_and_heads_go_into_the_file_and_the_rest_of_it_stays(
    taken: Path, rig_yaml: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, three = tmp_path / "page.html", pictures(taken, *TRUE, "north")
    extrinsics(rig_yaml, three, tag_size_m=TAG_M, report=page, as_json=True)
    found = said(capsys)
    assert found["verdict"] == "green", found["reasons"]
    assert set(found["tags"]) == {f"tag36h11:{k}" for k in (*ANCHORS, *FREE, *ON_ROBOT)}
    assert found["tags"]["tag36h11:8"]["board"] == "robot"
    assert np.abs(found["heads"]["pt1"]["aims_off_deg"]).max() < 0.3
    assert rig_yaml.read_text() == RIG
    assert found["changes"]["cameras.west.mount.fixed"]["roll_deg"] == pytest.approx(5.0, abs=0.3)
    assert "Who is tied to whom" in page.read_text()
    extrinsics(rig_yaml, three, tag_size_m=TAG_M, write=True, anchors=True, as_json=True)
    assert former(rig_yaml).read_text() == RIG
    assert "# the one upstairs" in rig_yaml.read_text()
    assert "# looks at the door" in rig_yaml.read_text()
    rig = load_rig(rig_yaml).rig
    for name, T in TRUE.items():
        mount = rig.cameras[name].mount
        assert isinstance(mount, FixedMount)
        off = difference(T, mount.T_world_camera)
        assert np.linalg.norm(off[:3]) < 0.01
        assert np.degrees(np.linalg.norm(off[3:])) < 0.3
        assert rig.cameras[name].calibrated == datetime.now(tz=UTC).date()
    off = difference(HEAD.T_world_base, rig.heads["pt1"].kinematics.T_world_base)
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.degrees(np.linalg.norm(off[3:])) < 0.3
    assert {str(anchor.key): anchor.size_m for anchor in rig.anchors}["tag36h11:111"] == TAG_M


def test_a_floor_tag_and_a_tape_measure_are_enough(
    taken: Path, rig_yaml: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file's anchors are free tags then, and all are taken for larger than they are."""
    rig_yaml.write_text(RIG.replace("size_m: 0.2", "size_m: 0.22").replace("size_m: 0.12", "size_m: 0.132"))
    length = ["tag36h11:100-tag36h11:101=0.65"]
    extrinsics(rig_yaml, pictures(taken, *TRUE), tag_size_m=0.132, length=length, origin="tag36h11:100", as_json=True)
    found = said(capsys)
    assert found["tag_size_factor"] == pytest.approx(1.0 / 1.1, rel=0.01)
    T_floor = transform(np.eye(3), np.array(ANCHORS[100]))
    for name, T in TRUE.items():
        assert np.array(found["cameras"][name]["T_world_camera"])[:3, 3] == pytest.approx(
            (invert(T_floor) @ T)[:3, 3], abs=0.02
        )


def test_a_head_that_says_no_aim_is_placed_as_it_stands_and_not_written(
    taken: Path, rig_yaml: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = tmp_path / "still"
    still.mkdir()
    shutil.copy(next((taken / "north").glob("n-000*")), still / "n-000.png")
    extrinsics(rig_yaml, [f"north={still}", *pictures(taken, "west")], tag_size_m=TAG_M, write=True, as_json=True)
    found = said(capsys)
    assert "north is not fixed, and its pictures do not say where its head pointed" in found["warnings"][-1]
    pan_rad, tilt_rad = np.radians(AIMS_DEG[0])
    T = HEAD.T_world_camera(pan_rad, tilt_rad, MOUNT)
    assert np.linalg.norm(np.array(found["cameras"]["north"]["T_world_camera"])[:3, 3] - T[:3, 3]) < 0.01
    assert not any("north" in place or "pt1" in place for place in found["changes"])


def test_what_does_not_fit_is_red_and_not_written(taken: Path, rig_yaml: Path) -> None:
    """Pictures that are not of one instant, as if they were."""
    places = [f"west={taken / 'west'}", f"east={taken / 'robot'}"]
    with pytest.raises(PartialError, match="this is not fit for use, nothing was written"):
        extrinsics(rig_yaml, places, tag_size_m=TAG_M, write=True)
    assert rig_yaml.read_text() == RIG


def test_nothing_is_written_where_nothing_says_where_the_world_is(taken: Path, rig_yaml: Path) -> None:
    rig_yaml.write_text(RIG[: RIG.index("anchors:")])
    with pytest.raises(InputError, match="nothing says where the world is, so nothing is written"):
        extrinsics(rig_yaml, pictures(taken, *TRUE), tag_size_m=TAG_M, write=True)
    assert not former(rig_yaml).exists()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"length": ["tag36h11:100=2"]}, "write TAG-TAG=METRES"),
        ({"board": ["checkers:3x3"]}, "board 'checkers:3x3'"),
        ({"keep": "east", "origin": "tag36h11:100"}, "--origin and --keep both say"),
        ({"origin": "tag36h11:5"}, "--origin tag36h11:5: no picture shows it whole"),
        ({"keep": "south"}, "--keep south: no pictures of it"),
        ({"tag_size_m": -1.0}, "must be above 0 and up to 5 m"),
        ({"stamps": Path("nowhere.csv")}, "nowhere.csv cannot be read"),
        ({}, "does not list tag36h11:110, tag36h11:111: give their size, --tag-size-m, or a --length"),
    ],
)
def test_bad_input_is_one_sentence(taken: Path, rig_yaml: Path, given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        extrinsics(rig_yaml, pictures(taken, "west"), **given)


@pytest.mark.parametrize(
    ("report", "says"),
    [("rig.yaml", "--report .* would overwrite .*, which is read"), ("none/page.html", "there is no folder")],
)
def test_a_page_that_cannot_be_written_is_told_before_pictures_are_looked_at(
    rig_yaml: Path, report: str, says: str
) -> None:
    page = rig_yaml.parent / report
    for command in (extrinsics, check):
        with pytest.raises(InputError, match=says):
            command(rig_yaml, ["west=nowhere"], report=page)
    with pytest.raises(InputError, match=says):
        body(rig_yaml, "robot", ["west=nowhere"], report=page)
    assert rig_yaml.read_text() == RIG


def test_what_fails_to_be_written_does_not_cost_the_answer(
    taken: Path, rig_yaml: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that goes away while the command works."""
    page = rig_yaml.parent / "pages" / "page.html"
    page.parent.mkdir()

    def slowly(*given: Any) -> Layout:
        page.parent.rmdir()
        return layout(*given)

    monkeypatch.setattr("camrig.cli.calibrate_body.layout", slowly)
    with pytest.raises(PartialError, match=r"page\.html cannot be written"):
        body(rig_yaml, "robot", [f"west={taken / 'robot'}"], write=True, report=page, as_json=True)
    assert said(capsys)["verdict"] == "green"
    assert former(rig_yaml).exists()


def test_pictures_that_cannot_be_read_are_blamed_and_not_lens_or_mount(taken: Path, rig_yaml: Path) -> None:
    broken, blank = rig_yaml.parent / "broken", rig_yaml.parent / "blank"
    for folder in (broken, blank):
        folder.mkdir()
        (folder / "west-000.png").write_bytes(b"no picture")
    cv2.imwrite(str(blank / "west-001.png"), np.full((480, 640), 90, np.uint8))
    for command in (extrinsics, check, lambda rig, places: body(rig, "robot", places)):
        with pytest.raises(InputError, match=r"^no picture can be used:\n.*west-000\.png: "):
            command(rig_yaml, [f"west={broken}"])
    with pytest.raises(InputError, match=r"\n1 could not be used:\n.*west-000\.png: "):
        body(rig_yaml, "robot", [f"west={blank}"])
    with pytest.raises(InputError, match=r"\n1 could not be used:\n.*west-000\.png: "):
        extrinsics(rig_yaml, [f"west={blank}"], keep="west")


def test_a_short_line_of_aims_is_told(taken: Path, rig_yaml: Path) -> None:
    (rig_yaml.parent / "aims.csv").write_text("picture,pan_deg,tilt_deg\nn-0.png\n")
    cv2.imwrite(str(rig_yaml.parent / "n-0.png"), np.full((480, 640), 90, np.uint8))
    with pytest.raises(InputError, match=r"aims\.csv: a line has no pan_deg"):
        check(rig_yaml, [f"north={rig_yaml.parent}"])


def test_tags_of_a_robot_are_placed_on_it(taken: Path, rig_yaml: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = rig_yaml.with_suffix(".html")
    body(rig_yaml, "robot", [f"west={taken / 'robot'}"], write=True, report=page, as_json=True)
    found = said(capsys)
    assert found["verdict"] == "green", found["reasons"]
    assert found["tags"]["tag36h11:7"]["off_file_mm"] == 0.0
    assert "The body" in page.read_text()
    tags = load_rig(rig_yaml).rig.targets["robot"].tags
    for tag in tags:
        off = difference(ON_ROBOT[tag.key.id], tag.T_body_tag)
        assert np.linalg.norm(off[:3]) < 0.004
        assert np.degrees(np.linalg.norm(off[3:])) < 1.0
    assert "# nobody measured that" in rig_yaml.read_text()


def test_tags_that_the_file_does_not_list_are_named_and_taken_if_asked(
    taken: Path, rig_yaml: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig_yaml.write_text(RIG.replace("      - {id: 9, size_m: 0.12}\n", ""))
    body(rig_yaml, "robot", [f"west={taken / 'robot'}"])
    assert "--write would set\n  targets.robot.calibrated" in capsys.readouterr().err
    body(rig_yaml, "robot", [f"west={taken / 'robot'}"], as_json=True)
    assert "tag36h11:9: seen, and not listed in the file; with --add" in said(capsys)["warnings"][0]
    body(rig_yaml, "robot", [f"west={taken / 'robot'}"], add=True, tag_size_m=TAG_M, write=True)
    assert [tag.key.id for tag in load_rig(rig_yaml).rig.targets["robot"].tags] == [7, 8, 9]


@pytest.mark.parametrize(
    ("target", "frame", "place", "says"),
    [
        ("truck", None, "robot", "has no target 'truck'; it has robot"),
        ("robot", "tag36h11:5", "robot", "has no such tag; it has tag36h11:7"),
        ("robot", None, "north", "tag36h11:7, on which the body's frame hangs, is in no picture"),
    ],
)
def test_bad_input_for_a_body_is_one_sentence(
    taken: Path, rig_yaml: Path, target: str, frame: str | None, place: str, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        body(rig_yaml, target, [f"west={taken / place}"], frame=frame)


def test_a_calibration_that_fits_is_green_and_one_that_does_not_is_red(
    taken: Path, rig_yaml: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    three = pictures(taken, *TRUE, "north")
    extrinsics(rig_yaml, three, tag_size_m=TAG_M, write=True, as_json=True)
    capsys.readouterr()
    check(rig_yaml, three, as_json=True)
    found = said(capsys)
    assert found["verdict"] == "green", found["reasons"]
    assert found["cameras"]["west"]["age_days"] == 0
    assert found["cameras"]["west"]["shared"] > 0
    assert found["cameras"]["north"]["anchors"] == 2
    rig_yaml.write_text(RIG)
    with pytest.raises(PartialError, match="the calibration does not fit: west, east, north"):
        check(rig_yaml, three, as_json=True)
    found = said(capsys)
    assert found["verdict"] == "red"
    assert re.search(r"anchors have it \d+ mm .* elsewhere: camrig calibrate extrinsics", found["reasons"][0])


def test_old_and_blind_cameras_are_amber(taken: Path, rig_yaml: Path, capsys: pytest.CaptureFixture[str]) -> None:
    west = "mount: {fixed: {position_m: [-0.95, 0.04, 2.03], pan_deg: 3, tilt_deg: -66, roll_deg: 5}}"
    lines = [
        line[: line.index("mount:")] + west + ", calibrated: 2020-01-01}" if "id: west" in line else line
        for line in RIG.splitlines()
    ]
    rig_yaml.write_text("\n".join(lines))
    cv2.imwrite(str(rig_yaml.parent / "blank-0.png"), np.full((480, 640), 90, np.uint8))
    check(rig_yaml, [*pictures(taken, "west"), f"east={rig_yaml.parent}"], as_json=True)
    found = said(capsys)
    assert found["verdict"] == "amber"
    assert "was calibrated" in found["cameras"]["west"]["reasons"][0]
    assert "nothing tells how it fits" in found["cameras"]["east"]["reasons"][0]
    assert found["not_checked"] == ["north"]


def test_a_running_rigs_own_cameras_are_looked_through_and_nothing_moves(capsys: pytest.CaptureFixture[str]) -> None:
    """The demo's emulated rig: three heads that say their angles, robots that move, a drone that is not asked."""
    check(Path("configs/demo.yaml"), as_json=True)
    found = said(capsys)
    assert found["verdict"] == "green", found["reasons"]
    assert set(found["cameras"]) == {"west", "east", "south"}
    assert found["not_checked"] == ["sky"]
    assert all(each["anchors"] >= 3 for each in found["cameras"].values())
