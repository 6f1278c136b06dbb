"""Scene files: every kind of camera, defaults of the paper's problem, and all faults at once with line and key."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from camrig.config.scene import load_scene
from camrig.errors import ConfigError
from camrig.optimise import DronePlace, FixedPlace, HeadPlace

LENS = (
    "lenses:\n  lab: {size_px: [1280, 800], fx: 827.7, fy: 827.9, cx: 640, cy: 400, distortion: [-0.33, 0.1, 0, 0]}\n"
)
HEAD = "  - {id: c1, lens: lab, mount: head, position_m: [1, 2, 2.8], pan_deg: [-90, 90], tilt_deg: [-90, -5]}\n"
TARGETS = "targets:\n  - {id: t1, position_m: [1, 2, 0]}\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(text)
    return path


def faults(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_scene(write(tmp_path, text))
    return [f"{fault.line}:{fault.key}: {fault.message}" for fault in caught.value.faults]


def test_every_kind_of_camera_and_target_is_read(tmp_path: Path) -> None:
    text = (
        LENS
        + "cameras:\n"
        + HEAD
        + "  - {id: d1, lens: lab, mount: drone, box_m: [[0, 0, 1], [5, 3, 3]], min_separation_m: 0.5, yaw_deg: 90}\n"
        + "  - {id: f1, lens: lab, mount: fixed, position_m: [0, 0, 2.5], pan_deg: 30, tilt_deg: -60, alpha_deg: 20}\n"
        + "targets:\n"
        + "  - {id: t1, position_m: [1, 2, 0], tag_size_m: 0.1, weight: 2, normal: [0, 0, 1], facing_deg: 45}\n"
        + "space: {floor_m: [[0, 0], [5, 3]], keep_out_m: [[[2, 1, 0], [2.4, 1.6, 1.2]]]}\n"
        + "planner: {visibility: image, margin_deg: 1, min_separation_m: 0.8, seed: 3}\n"
    )
    file = load_scene(write(tmp_path, text))
    head, drone, fixed = (camera.place for camera in file.scene.cameras)
    assert isinstance(head, HeadPlace)
    assert head.pan_limits_rad == pytest.approx((-math.pi / 2, math.pi / 2))
    assert isinstance(drone, DronePlace)
    assert drone.min_separation_m == 0.5
    assert drone.yaw_rad == pytest.approx(math.pi / 2)
    assert isinstance(fixed, FixedPlace)
    axis = fixed.T_world_camera[:3, 2]
    assert np.degrees(np.arctan2(axis[1], axis[0])) == pytest.approx(30.0)
    assert axis[2] == pytest.approx(-math.sin(math.radians(60.0)))
    assert file.scene.cameras[2].alpha_rad == pytest.approx(math.radians(20.0))
    (target,) = file.scene.targets
    assert (target.tag_size_m, target.weight) == (0.1, 2.0)
    assert target.facing_rad == pytest.approx(math.pi / 4)
    assert (file.name, file.seed, len(file.scene.keep_out_m)) == ("room", 3, 1)
    assert file.scene.settings.margin_rad == pytest.approx(math.radians(1.0))


def test_a_bare_scene_is_the_papers_problem(tmp_path: Path) -> None:
    settings = load_scene(write(tmp_path, LENS + "cameras:\n" + HEAD + TARGETS)).scene.settings
    assert (settings.quality, settings.visibility, settings.objective) == ("pixel", "cone", "mean")
    assert (settings.margin_rad, settings.min_separation_m, settings.gain) == (0.0, 0.0, 0.0)


def test_all_faults_come_at_once_with_line_and_key(tmp_path: Path) -> None:
    text = (
        LENS
        + "cameras:\n"
        + HEAD
        + HEAD.replace("lens: lab", "lens: lost")
        + "  - {id: d1, lens: lab, mount: drone, box_m: [[0, 0, 0], [5, 3, 0.9]]}\n"
        + "  - {id: x1, lens: lab, mount: balloon}\n"
        + "targets:\n"
        + "  - {id: t1, position_m: [1, 2], colour: red}\n"
        + "planner: {quality: fisher, margin_deg: -1}\n"
        + "camers: []\n"
    )
    found = faults(tmp_path, text)
    expected = [
        ("5:cameras[c1].lens", "there is no lens 'lost'"),
        ("5:cameras[c1].id", "already the id"),
        ("6:cameras[d1].box_m", "at least 1 m"),
        ("7:cameras[x1].mount", "head, drone, fixed"),
        ("9:targets[t1].position_m", ""),
        ("9:targets[t1].colour", "unknown key"),
        ("10:planner.quality", "'pixel'"),
        ("10:planner.margin_deg", "greater than or equal to 0"),
        ("11:camers", "unknown key"),
    ]
    for place, words in expected:
        assert any(fault.startswith(place) and words in fault for fault in found), (place, found)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cameras:\n" + HEAD + TARGETS, "lenses"),
        (LENS + TARGETS, "cameras"),
        (LENS + "cameras: []\n" + TARGETS, "at least one"),
        (LENS + "cameras:\n" + HEAD + "targets: []\n", "at least one"),
        (LENS + "cameras:\n" + HEAD + "targets: 5\n", "must be a list"),
        (LENS + "cameras: [5]\n" + TARGETS, "mount"),
        (LENS + "cameras:\n" + HEAD + "targets:\n  - {id: t1, position_m: [.nan, 0, 0]}\n", "position_m"),
        (LENS + "cameras:\n" + HEAD + "targets:\n  - {id: t1, position_m: [0, 0, 0], normal: [0, 0, 0]}\n", "length"),
        (LENS + "cameras:\n" + HEAD.replace("[-90, 90]", "[90, -90]") + TARGETS, "pan_deg"),
        (LENS.replace("0.1, 0, 0]", "0.1, 0]") + "cameras:\n" + HEAD + TARGETS, "4, 5, 8, 12 or 14"),
        ("lenses: [\n", "not valid YAML"),
    ],
)
def test_a_faulty_scene_is_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    assert any(words in fault for fault in faults(tmp_path, text))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_scene(tmp_path / "nowhere.yaml")
