# ruff: noqa: E501 - a table of faults reads best unwrapped
"""The rig's YAML: every fault in one go, each with file, line and key; and what a good file becomes."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.config.document import load_document
from camrig.config.rig_file import load_rig
from camrig.config.settings import settings_of
from camrig.errors import ConfigError
from camrig.geometry.lens.errors import TYPICAL_SIGMA
from camrig.rig import DroneMount, HeadMount

CONFIGS = Path(__file__).parents[2] / "configs"

GOOD = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [1280, 800], fx: 827.7, fy: 827.9, cx: 640, cy: 400, distortion: [-0.336, 0.101, 0, 0, 0]}
cameras:
  - {id: north, lens: lab, source: {driver: fake}, mount: {head: pt1}}
  - {id: south, lens: lab, source: {driver: fake}, mount: {head: pt2}}
heads:
  - {id: pt1, driver: pelco_d, port: /dev/ttyUSB0, address: 1, position_m: [1, 1, 2.8], pan_deg: [-170, 170], tilt_deg: [-90, 10]}
  - {id: pt2, driver: pelco_d, port: /dev/ttyUSB0, address: 2, position_m: [4, 1, 2.8]}
targets:
  - {id: robot1, tags: [{id: 7, size_m: 0.12}]}
anchors:
  - {id: 100, size_m: 0.2, T_world_tag: {position_m: [0, 0, 0]}}
"""


def _write(folder: Path, text: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text)
    return path


def _faults(folder: Path, text: str) -> list[str]:
    path = _write(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    return [str(fault).removeprefix(f"{path}:") for fault in caught.value.faults]


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_shipped_configuration_is_consistent(path: Path) -> None:
    assert load_rig(path).rig.cameras


def test_a_good_file_becomes_a_rig_in_si_units(tmp_path: Path) -> None:
    config = load_rig(_write(tmp_path, GOOD))
    assert config.rig.heads["pt1"].pan_limits_rad == pytest.approx((-math.radians(170.0), math.radians(170.0)))
    mount = config.rig.cameras["north"].mount
    assert isinstance(mount, HeadMount)
    assert mount.T_mount_camera[:3, 2] == pytest.approx([1.0, 0.0, 0.0])
    assert config.planner.visibility == "image"
    assert config.devices["heads"]["pt2"].section.address == 2


@pytest.mark.parametrize(
    ("section", "estimator"),
    [("", "joint"), ("fusion: {}\n", "joint"), ("fusion: {estimator: quality}\n", "quality")],
)
def test_the_estimator_of_fusion_is_asked_for_in_the_file(tmp_path: Path, section: str, estimator: str) -> None:
    assert settings_of(load_rig(_write(tmp_path, GOOD + section))).fuse.estimator == estimator


def test_what_a_planner_is_not_told_stays_as_a_running_rig_has_it(tmp_path: Path) -> None:
    planner = settings_of(load_rig(_write(tmp_path, GOOD))).planner
    assert (planner.min_tag_px, planner.max_range_m, planner.motion_cost_per_s) == (16.0, math.inf, 0.0)
    assert planner.max_incidence_rad == pytest.approx(math.radians(75.0))
    coarse = settings_of(load_rig(_write(tmp_path, GOOD + "detector: {driver: pyapriltags, decimate: 2}\n"))).planner
    assert coarse.min_tag_px == 24.0


@pytest.mark.parametrize(
    ("section", "refined"), [("", True), ("{}", True), ("{refine: true}", True), ("{refine: false}", False)]
)
def test_corners_are_refined_and_planned_by_unless_the_file_says_no(
    tmp_path: Path, section: str, refined: bool
) -> None:
    config = load_rig(_write(tmp_path, GOOD + (f"detector: {section}\n" if section else "")))
    assert config.refine is refined
    assert settings_of(config).planner.refined_corners is refined


def test_a_lens_is_refined_where_its_camera_asks_for_it(tmp_path: Path) -> None:
    asked = "mount: {head: pt1}, refine_lens: true, lens_sigma: {f_percent: 0.2, centre_px: 1.5}}"
    cameras = load_rig(_write(tmp_path, GOOD.replace("mount: {head: pt1}}", asked))).rig.cameras
    assert cameras["north"].refine_lens
    assert cameras["north"].lens_sigma == pytest.approx((0.002, 1.5, 1.5, TYPICAL_SIGMA[3]))
    assert not cameras["south"].refine_lens
    assert cameras["south"].lens_sigma == pytest.approx(TYPICAL_SIGMA)


def test_every_key_of_the_planner_reaches_it(tmp_path: Path) -> None:
    section = (
        "planner: {quality: fisher, objective: worst, visibility: cone, max_range_m: 6, min_tag_px: 0, "
        "max_incidence_deg: 60, motion_cost_per_s: 0.001}\n"
    )
    planner = settings_of(load_rig(_write(tmp_path, GOOD + section))).planner
    assert (planner.quality, planner.objective, planner.visibility) == ("fisher", "worst", "cone")
    assert (planner.max_range_m, planner.min_tag_px, planner.motion_cost_per_s) == (6.0, 0.0, 0.001)
    assert planner.max_incidence_rad == pytest.approx(math.radians(60.0))


SKY = """\
drones:
  - {id: d1, driver: fake, box_m: [[0, 0, 1], [5, 3, 2.5]], yaw_deg: [-90, 90], needs_anchor: true}
"""


def _with_drone(text: str) -> str:
    camera = "  - {id: sky, lens: lab, source: {driver: fake}, mount: {drone: d1}}\nheads:\n"
    return text.replace("heads:\n", camera, 1) + SKY


def test_heads_and_drones_may_need_an_anchor_and_a_drones_yaw_may_be_planned(tmp_path: Path) -> None:
    text = _with_drone(GOOD.replace("pan_deg: [-170, 170]", "needs_anchor: true"))
    rig = load_rig(_write(tmp_path, text)).rig
    assert (rig.heads["pt1"].needs_anchor, rig.heads["pt2"].needs_anchor) == (True, False)
    assert rig.drones["d1"].needs_anchor
    assert rig.drones["d1"].yaw_limits_rad == pytest.approx((-math.pi / 2.0, math.pi / 2.0))
    bare = load_rig(_write(tmp_path, text.replace("yaw_deg: [-90, 90], ", ""))).rig
    assert bare.drones["d1"].yaw_limits_rad is None


def test_who_needs_an_anchor_is_refused_without_one(tmp_path: Path) -> None:
    text = _with_drone(GOOD.replace("pan_deg: [-170, 170]", "needs_anchor: true"))
    faults = _faults(tmp_path, text.replace(text[text.index("anchors:") : text.index("drones:")], ""))
    assert [fault.split(" must")[0] for fault in faults] == [
        "10: heads[pt1].needs_anchor: 'pt1'",
        "15: drones[d1].needs_anchor: 'd1'",
    ]


def test_a_running_rig_does_not_drive_a_zoom(tmp_path: Path) -> None:
    zoomed = (
        "  zoomed: {size_px: [1280, 720], zoom: [{position: 0, fx: 900, fy: 900}, {position: 9, fx: 999, fy: 999}]}\n"
    )
    text = GOOD.replace("cameras:\n", zoomed + "cameras:\n")
    assert load_rig(_write(tmp_path, text)).rig.cameras
    (fault,) = _faults(tmp_path, text.replace("id: south, lens: lab", "id: south, lens: zoomed"))
    assert fault.startswith("8: cameras[south].lens: 'zoomed' is a zoom lens")
    assert "camrig plan" in fault


def test_a_drones_camera_looks_down_with_image_right_along_its_nose() -> None:
    rig = load_rig(CONFIGS / "demo.yaml").rig
    mount = rig.cameras["sky"].mount
    assert isinstance(mount, DroneMount)
    assert mount.T_body_camera[:3, :3] == pytest.approx(np.diag([1.0, -1.0, -1.0]))


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("address: 2", "adress: 2", 10, "unknown key, did you mean 'address'?"),
        ("position_m: [4, 1, 2.8]", "position_mm: [4000, 1000, 2800]", 10, "position_m: is missing"),
        ("size_m: 0.12", "size_m: 120", 12, "less than or equal to 5"),
        ("address: 2", "address: 1", 10, "address"),
        ("mount: {head: pt2}", "mount: {head: pt3}", 7, "there is no head 'pt3'; this file defines: pt1, pt2"),
        (", mount: {head: pt2}", "", 7, "mount: is missing"),
        ("mount: {head: pt2}", "mount: {head: pt1}", 7, "'pt1' already carries camera 'north'"),
        ("lens: lab, source: {driver: fake}, mount: {head: pt2}", "lens: wide, source: {driver: fake}, mount: {head: pt2}", 7, "no lens 'wide'"),
        ("id: robot1", "id: robot1, motion: free, height_m: 0.1", 12, "height_m goes with motion: floor"),
        ("id: 100, size_m: 0.2", "id: 7, size_m: 0.2", 14, "tag tag36h11:7 is already listed"),
        ("id: south", "id: north", 7, "'north' is already the id of cameras[0]"),
        ("tilt_deg: [-90, 10]", "tilt_deg: [10, -90]", 9, "the first limit must be below the second"),
        ("floor_m: [[0, 0], [5, 3]]", "floor_m: [[0, 0], [0, 3]]", 2, "the floor is empty"),
        ("driver: pelco_d, port: /dev/ttyUSB0, address: 2", "driver: pelco_e, port: /dev/ttyUSB0, address: 2", 10, "no driver 'pelco_e'"),
        ("distortion: [-0.336, 0.101, 0, 0, 0]", "distortion: [-0.336, 0.101, 0]", 4, "distortion has 3 numbers"),
        ("cy: 400, distortion: [-0.336, 0.101, 0, 0, 0]", "cy: 400, r_max: 1.3, distortion: [-0.5, 0, 0, 0, 0]", 4, "stops being one-to-one"),
        ("fx: 827.7", "fx: .nan", 4, "finite number"),
        ("anchors:", "planner: {min_tag_px: -1}\nanchors:", 13, "planner.min_tag_px: input should be greater"),
        ("anchors:", "planner: {quality: magic}\nanchors:", 13, "'pixel', 'fisher' or 'perspective'"),
        ("rig: lab", "rgi: lab", 1, "unknown key"),
        ("{head: pt2}}", "{head: pt2}, refine_lens: true}\nfusion: {estimator: mean}", 7, "only fusion: {estimator: joint} refines"),
        ("{head: pt2}}", "{head: pt2}, lens_sigma: {k1: 0}}", 7, "k1: input should be greater than 0"),
        ("rig: lab", "rig: lab\nfusion: {estimator: paper}", 2, "'joint', 'covariance', 'quality' or 'mean'"),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_line(tmp_path: Path, old: str, new: str, line: int, says: str) -> None:
    assert old in GOOD
    faults = _faults(tmp_path, GOOD.replace(old, new, 1))
    assert any(fault.startswith(f"{line}: ") and says in fault for fault in faults), faults


def test_all_faults_of_a_file_come_at_once(tmp_path: Path) -> None:
    text = GOOD.replace("fx: 827.7", "fx: -1").replace("size_m: 0.12", "size_mm: 120").replace("pt2}", "pt9}")
    faults = _faults(tmp_path, text)
    assert [fault.split(":")[0] for fault in faults] == ["4", "7", "12", "12"]


def test_a_fault_inside_a_head_raises_no_false_one_about_its_camera(tmp_path: Path) -> None:
    faults = _faults(tmp_path, GOOD.replace("address: 2", "address: 999"))
    assert len(faults) == 1, faults


def test_a_key_that_stands_twice_is_refused(tmp_path: Path) -> None:
    assert _faults(tmp_path, GOOD + "rig: other\n") == ["15: rig: this key stands twice"]


@pytest.mark.parametrize("text", ["", "[1, 2]", "a: [", "a: b: c", "{", "\t- x", "rig: !!python/object:os.system x"])
def test_what_is_no_yaml_mapping_is_one_clear_fault(tmp_path: Path, text: str) -> None:
    assert len(_faults(tmp_path, text)) == 1


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.yaml", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            load_rig(path)


def test_binary_rubbish_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ConfigError, match="cannot be read: it is not UTF-8"):
        load_rig(path)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_damage_to_a_file_escapes_as_anything_but_faults(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, len(GOOD) - 1))
    length = data.draw(st.integers(0, 12))
    text = GOOD[:place] + data.draw(st.text(max_size=8)) + GOOD[place + length :]
    path = tmp_path_factory.mktemp("damaged") / "rig.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with suppress(ConfigError):
        assert load_rig(path).rig.name


def test_lines_are_those_of_the_file_also_under_merged_keys(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("base: &b {x: 1}\nother:\n  <<: *b\n  y: 2\n")
    document = load_document(path)
    assert document.data["other"] == {"x": 1, "y": 2}
    assert document.lines["other", "y"] == 4
