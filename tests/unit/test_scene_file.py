# ruff: noqa: E501 - a table of faults reads best unwrapped
"""Scene files: every kind of camera, defaults of the paper's problem, and all faults at once with line and key."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from camrig.config.scene import load_scene
from camrig.errors import ConfigError
from camrig.optimise import DronePlace, FixedPlace, HeadPlace, PlannerSettings, PoseSigma, SceneAnchor

LENS = (
    "lenses:\n  lab: {size_px: [1280, 800], fx: 827.7, fy: 827.9, cx: 640, cy: 400, distortion: [-0.33, 0.1, 0, 0]}\n"
)
HEAD = "  - {id: c1, lens: lab, mount: head, position_m: [1, 2, 2.8], pan_deg: [-90, 90], tilt_deg: [-90, -5]}\n"
TARGETS = "targets:\n  - {id: t1, position_m: [1, 2, 0]}\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(text)
    return path


def head(more: str) -> str:
    return "  - {id: c1, lens: lab, mount: head, " + more + "}\n"


def scene_text(cameras: str = HEAD, targets: str = TARGETS, lens: str = LENS, rest: str = "") -> str:
    return lens + "cameras:\n" + cameras + targets + rest


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
        + "planner: {quality: magic, margin_deg: -1}\n"
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
        ("10:planner.quality", "'pixel', 'fisher' or 'perspective'"),
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


def test_a_camera_to_be_mounted_has_a_surface(tmp_path: Path) -> None:
    text = scene_text(head("surface_m: [[0, 0, 2.8], [5, 3, 2.8]]"))
    (camera,) = load_scene(write(tmp_path, text)).scene.cameras
    assert isinstance(camera.place, HeadPlace)
    assert camera.place.mount_m == ((0.0, 0.0, 2.8), (5.0, 3.0, 2.8))
    assert camera.place.kinematics.T_world_base[:3, 3] == pytest.approx([2.5, 1.5, 2.8])


@pytest.mark.parametrize(
    ("yaw", "yaw_deg", "limits_deg"),
    [("", 0.0, None), (", yaw_deg: 90", 90.0, None), (", yaw_deg: [-45, 135]", -45.0, (-45.0, 135.0))],
)
def test_a_drones_yaw_is_one_angle_or_planned_between_two(
    tmp_path: Path, yaw: str, yaw_deg: float, limits_deg: tuple[float, float] | None
) -> None:
    text = scene_text(f"  - {{id: d1, lens: lab, mount: drone, box_m: [[0, 0, 1], [5, 3, 3]]{yaw}}}\n")
    (camera,) = load_scene(write(tmp_path, text)).scene.cameras
    assert isinstance(camera.place, DronePlace)
    assert math.degrees(camera.place.yaw_rad) == pytest.approx(yaw_deg)
    limits_rad = camera.place.yaw_limits_rad
    assert limits_rad == (limits_deg and pytest.approx(np.radians(limits_deg)))


def test_a_zoom_lens_is_a_table_of_lenses_by_position(tmp_path: Path) -> None:
    rows = "{position: 0, fx: 900, fy: 900, distortion: [-0.3, 0.1, 0, 0]}, {position: 16384, fx: 9000, fy: 9010, cx: 630, cy: 350, r_max: 0.1}"
    lens = f"lenses:\n  lab: {{size_px: [1280, 720], zoom: [{rows}]}}\n"
    (camera,) = load_scene(write(tmp_path, scene_text(lens=lens))).scene.cameras
    near, far = camera.zoom
    assert (near.position, far.position) == (0.0, 16384.0)
    assert (near.lens.focal_px, near.lens.centre_px) == ((900.0, 900.0), (640.0, 360.0))
    assert (far.lens.focal_px, far.lens.centre_px, far.lens.r_max) == ((9000.0, 9010.0), (630.0, 350.0), 0.1)
    assert camera.lens is near.lens


def test_pose_sigmas_are_those_of_a_rig_unless_given(tmp_path: Path) -> None:
    box = "box_m: [[0, 0, 1], [5, 3, 3]]"
    given = "pose_sigma: {position_mm: 5, attitude_deg: 0.5, pan_deg: 0.2}"
    text = scene_text(
        HEAD
        + f"  - {{id: c2, lens: lab, mount: head, position_m: [1, 2, 2], {given}}}\n"
        + f"  - {{id: d1, lens: lab, mount: drone, {box}}}\n"
        + f"  - {{id: d2, lens: lab, mount: drone, {box}, pose_sigma: {{position_mm: 10}}}}\n"
        + "  - {id: f1, lens: lab, mount: fixed, position_m: [0, 0, 2.5]}\n"
    )
    bias, half, fifth, one = (math.radians(degrees) for degrees in (0.1, 0.5, 0.2, 1.0))
    expected = [
        PoseSigma(0.001, 0.0005, bias, bias),
        PoseSigma(0.005, half, fifth, bias),
        PoseSigma(0.03, one),
        PoseSigma(0.01, one),
        PoseSigma(0.001, 0.0005),
    ]
    for camera, sigma in zip(load_scene(write(tmp_path, text)).scene.cameras, expected, strict=True):
        assert dataclasses.astuple(camera.pose_sigma) == pytest.approx(dataclasses.astuple(sigma)), camera.id


def test_anchors_and_who_needs_them_are_read(tmp_path: Path) -> None:
    anchors = "anchors:\n  - {position_m: [1, 1, 0], tag_size_m: 0.2}\n  - {position_m: [0, 1, 1], tag_size_m: 0.3, normal: [1, 0, 0], facing_deg: 90}\n"
    scene = load_scene(
        write(tmp_path, scene_text(head("position_m: [1, 2, 2], needs_anchor: true"), rest=anchors))
    ).scene
    assert scene.cameras[0].needs_anchor
    assert scene.anchors == (
        SceneAnchor((1.0, 1.0, 0.0), 0.2),
        SceneAnchor((0.0, 1.0, 1.0), 0.3, (1.0, 0.0, 0.0), math.pi / 2.0),
    )


def test_every_key_of_the_planner_reaches_it(tmp_path: Path) -> None:
    planner = (
        "planner: {quality: perspective, objective: worst, max_range_m: 6, min_tag_px: 20, max_incidence_deg: 60, "
        "motion_cost_per_s: 0.0001, deadline_s: 2}\n"
    )
    file = load_scene(write(tmp_path, scene_text(rest=planner)))
    assert file.deadline_s == 2.0
    assert file.scene.settings == PlannerSettings(
        quality="perspective",
        objective="worst",
        max_range_m=6.0,
        min_tag_px=20.0,
        max_incidence_rad=math.radians(60.0),
        motion_cost_per_s=0.0001,
    )


FISHER = "planner: {quality: fisher}\n"


def test_fisher_wants_the_size_of_every_tag(tmp_path: Path) -> None:
    targets = TARGETS + "  - {id: t2, position_m: [1, 2, 0], tag_size_m: 0.1}\n  - {id: t3, position_m: [1, 1, 0]}\n"
    message = "is missing; quality 'fisher' judges by the corners of a tag"
    expected = [f"6:targets[t1].tag_size_m: {message}", f"8:targets[t3].tag_size_m: {message}"]
    assert faults(tmp_path, scene_text(targets=targets, rest=FISHER)) == expected
    path = write(tmp_path, scene_text(targets=targets, rest=FISHER))
    assert load_scene(path, "pixel").scene.settings.quality == "pixel"
    with pytest.raises(ConfigError, match="judges by the corners"):
        load_scene(write(tmp_path, scene_text()), "fisher")


ZOOM = (
    "lenses:\n  lab: {size_px: [1280, 720], zoom: [{position: 0, fx: 900, fy: 900}, {position: 9, fx: 999, fy: 999}]}\n"
)
DRONE = "  - {id: d1, lens: lab, mount: drone, box_m: [[0, 0, 1], [5, 3, 3]]}\n"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (scene_text(head("pan_deg: [0, 9]")), "4:cameras[c1]: a head has a position_m, or a surface_m"),
        (scene_text(head("position_m: [1, 1, 2], surface_m: [[0, 0, 2], [5, 3, 2]]")), "4:cameras[c1]: a head has"),
        (scene_text(head("surface_m: [[0, 0, 3], [5, 3, 2]]")), "4:cameras[c1].surface_m: the surface is empty"),
        (scene_text(head("surface_m: [[1, 1, 2], [1, 1, 2]]")), "4:cameras[c1].surface_m: the surface is empty"),
        (scene_text(head("surface_m: [[0, 0, 2], [5, .inf, 2]]")), "4:cameras[c1].surface_m"),
        (scene_text(DRONE.replace("]]}", "]], yaw_deg: [90, 0]}")), "4:cameras[d1].yaw_deg: must be one angle"),
        (scene_text(DRONE.replace("]]}", "]], yaw_deg: 999}")), "4:cameras[d1].yaw_deg: must be one angle"),
        (scene_text(DRONE.replace("]]}", "]], yaw_deg: .nan}")), "4:cameras[d1].yaw_deg: must be one angle"),
        (scene_text(DRONE.replace("]]}", "]], pose_sigma: {pan_deg: 1}}")), "4:cameras[d1].pose_sigma.pan_deg: unknown"),
        (scene_text(head("position_m: [1, 1, 2], pose_sigma: {position_mm: 0}")), "4:cameras[c1].pose_sigma.position_mm"),
        (scene_text(head("position_m: [1, 1, 2], needs_anchor: true")), "4:cameras[c1].needs_anchor: 'c1' must keep"),
        (scene_text(rest="anchors:\n  - {position_m: [0, 0, 0]}\n"), "8:anchors[0].tag_size_m: is missing"),
        (scene_text(rest="anchors: 5\n"), "7:anchors: must be a list"),
        (scene_text(rest="planner: {max_range_m: 0}\n"), "7:planner.max_range_m"),
        (scene_text(rest="planner: {max_incidence_deg: 91}\n"), "7:planner.max_incidence_deg"),
        (scene_text(rest="planner: {min_tag_px: -1}\n"), "7:planner.min_tag_px"),
        (scene_text(rest="planner: {motion_cost_per_s: .inf}\n"), "7:planner.motion_cost_per_s"),
        (scene_text(lens=ZOOM.replace("position: 9", "position: 0")), "2:lenses.lab: the positions of zoom must rise"),
        (scene_text(lens=ZOOM.replace(", {position: 9, fx: 999, fy: 999}", "")), "2:lenses.lab.zoom"),
        (scene_text(lens=ZOOM.replace("fy: 999", "fy: 999, r_max: 2, distortion: [-0.3, 0, 0, 0]")), "2:lenses.lab: zoom[1]: r_max 2"),
        (scene_text(lens=ZOOM.replace("fy: 999", "fy: 999, cx: 2000")), "2:lenses.lab: zoom[1]: cx, cy"),
        (scene_text(lens=ZOOM.replace("fy: 999", "fy: -1")), "2:lenses.lab.zoom[1].fy"),
        (scene_text(lens=ZOOM.replace("zoom:", "fx: 900, zoom:")), "2:lenses.lab.fx: unknown key"),
        (scene_text(DRONE, lens=ZOOM), "4:cameras[d1].lens: 'lab' is a zoom lens"),
        (scene_text(head("position_m: [1, 1, 2], alpha_deg: 30"), lens=ZOOM), "4:cameras[c1].alpha_deg: goes with a lens"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_one_fault_with_line_and_key(tmp_path: Path, text: str, fault: str) -> None:
    (found,) = faults(tmp_path, text)
    assert found.startswith(fault)


def test_the_example_of_the_manual_is_a_scene(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    scene = load_scene(write(tmp_path, text.split("```yaml\n")[1].split("```")[0])).scene
    assert (len(scene.cameras), len(scene.targets), len(scene.anchors)) == (4, 1, 1)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_scene(tmp_path / "nowhere.yaml")
