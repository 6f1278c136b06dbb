"""Pictures of plans: what they show, labels that keep clear of each other, files that are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from camrig.config.scene import load_scene
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.messages import PlanStatus, RigPlan
from camrig.optimise import Scene, SceneTarget, plan, quality_at
from camrig.optimise.plan_views import mounted
from camrig.report.plan_axes import RED, Word, Words, draw_plan, extent_of
from camrig.report.plan_labels import place_labels
from camrig.report.plan_map import plan_panel, write_plan_map

pytestmark = pytest.mark.usefixtures("picture_fonts")

SCENE = """\
lenses:
  lab: {size_px: [1280, 800], fx: 827.7, fy: 827.9, cx: 640, cy: 400, distortion: [-0.3358, 0.1014, 0, 0, 0]}
  wide: {model: fisheye, size_px: [640, 480], fx: 200, fy: 200, cx: 320, cy: 240}
cameras:
  - {id: north, lens: lab, mount: head, surface_m: [[0, 4, 2.2], [6, 4, 2.8]]}
  - {id: sky, lens: lab, mount: drone, box_m: [[0, 0, 1.2], [6, 4, 2.5]], yaw_deg: [-90, 90], needs_anchor: true}
  - {id: door, lens: wide, mount: fixed, position_m: [5.8, 0.2, 2.5], pan_deg: 140, tilt_deg: -35}
targets:
  - {id: robot1, position_m: [1, 2, 0.1], tag_size_m: 0.15}
  - {id: robot2, position_m: [4.5, 1, 0.1], tag_size_m: 0.15}
  - {id: hidden, position_m: [2.6, 1.6, 0.1], tag_size_m: 0.15, normal: [0, 0, -1]}
anchors:
  - {position_m: [2, 2, 0], tag_size_m: 0.2}
space: {floor_m: [[0, 0], [6, 4]], keep_out_m: [[[2.2, 1.2, 0], [3, 1.9, 1.4]]]}
"""


def planned(folder: Path, planner: str) -> tuple[Scene, RigPlan]:
    path = folder / "room.yaml"
    path.write_text(SCENE + f"planner: {planner}\n")
    scene = load_scene(path).scene
    return scene, plan(scene, now=lambda: 0.0)


@pytest.mark.parametrize(
    ("planner", "words"),
    [
        ("{quality: fisher, visibility: image}", ["mm rms"]),
        ("{quality: pixel, visibility: cone, objective: worst}", ["mm/px", "worst"]),
    ],
)
def test_a_picture_names_everything_with_units(tmp_path: Path, planner: str, words: list[str]) -> None:
    scene, found = planned(tmp_path, planner)
    assert found.uncovered == ("hidden",)
    found = replace(found, status=PlanStatus.PARTIAL)
    picture = tmp_path / "room.svg"
    write_plan_map(picture, "room", scene, found)
    text = picture.read_text()
    legend = ["camera on a head", "camera on a drone", "fixed camera", "target nobody sees", "anchor", "keep-out box"]
    for word in [*legend, *words, "x, m", "y, m", "room: partial", "2 of 3 covered", "place nobody sees"]:
        assert word in text, word
    assert RED in text
    _, drawn = draw_plan(Figure().add_subplot(), scene, found, extent_of(scene, found))
    quality_m = found.targets["robot1"].quality_m
    assert quality_m is not None
    labels = {word.text for word in drawn.labels}
    assert {"north", "sky", "door", "hidden", f"robot1  {quality_m * 1e3:.2f}"} < labels
    assert "robot1" not in {word.text for word in drawn.without_targets().labels}


def test_several_plans_share_a_picture(tmp_path: Path) -> None:
    scene, found = planned(tmp_path, "{visibility: image}")
    write_plan_map(tmp_path / "one.png", "one", scene, found)
    plan_panel(tmp_path / "four.png", [(f"room {number}", scene, found) for number in range(4)])
    for name in ("one.png", "four.png"):
        image = cv2.imread(str(tmp_path / name))
        assert image is not None
        assert min(image.shape[:2]) > 400
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 500


def test_footprints_are_what_the_cameras_see_of_the_plane_of_the_targets(tmp_path: Path) -> None:
    for planner in ("{visibility: image}", "{visibility: cone}"):
        scene, found = planned(tmp_path, planner)
        axes = Figure().add_subplot()
        draw_plan(axes, scene, found, extent_of(scene, found))
        outlines = [patch for patch in axes.patches if isinstance(patch, Polygon)]
        assert len(outlines) == len(scene.cameras)
        for camera, outline in zip(scene.cameras, outlines, strict=True):
            inside = outline.get_path().contains_points([target.position_m[:2] for target in scene.targets])
            for target, shown in zip(scene.targets, inside, strict=True):
                assert shown or camera.id not in found.targets[target.id].seen_by


def test_a_plan_that_sees_nothing_is_still_a_picture(tmp_path: Path) -> None:
    path = tmp_path / "dark.yaml"
    lens = "lenses:\n  lab: {size_px: [1280, 800], fx: 800, fy: 800, cx: 640, cy: 400}\n"
    head = "  - {id: c1, lens: lab, mount: head, position_m: [0, 0, 2], tilt_deg: [60, 89]}\n"
    path.write_text(lens + "cameras:\n" + head + "targets:\n  - {id: t1, position_m: [0, 0, 0]}\n")
    scene = load_scene(path).scene
    found = plan(scene, now=lambda: 0.0)
    assert found.objective_m is None
    write_plan_map(tmp_path / "dark.png", "dark", scene, found)
    assert (tmp_path / "dark.png").stat().st_size > 1000


def test_a_crowd_of_targets_is_dots_without_words(tmp_path: Path) -> None:
    scene, found = planned(tmp_path, "{visibility: image}")
    crowd = tuple(SceneTarget(f"t{n}", (0.05 * n, 2.0, 0.1), 0.15) for n in range(100))
    crowded = mounted(replace(scene, targets=crowd), found.mounts)
    write_plan_map(tmp_path / "crowd.svg", "crowd", crowded, quality_at(crowded, found.aims))
    assert "in colour who sees it" not in (tmp_path / "crowd.svg").read_text()


@pytest.mark.parametrize("name", ["plan.jpg", "plan", "none/plan.png"])
def test_a_file_that_cannot_be_a_picture_is_refused(tmp_path: Path, name: str) -> None:
    scene, found = planned(tmp_path, "{visibility: image}")
    with pytest.raises(InputError, match="plan"):
        write_plan_map(tmp_path / name, "room", scene, found)
    with pytest.raises(InputError, match="plan"):
        plan_panel(tmp_path / name, [("room", scene, found)])


def laid_out(words: Words) -> list[Array]:
    """Return the (4,) boxes in pixels of the labels of 10 m x 6 m axes."""
    figure = Figure(figsize=(8.0, 5.0), dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(xlim=(0.0, 10.0), ylim=(0.0, 6.0))
    figure.draw_without_rendering()
    place_labels(axes, words)
    frame = np.array(axes.bbox.extents)
    boxes = [np.array(text.get_window_extent().extents) for text in axes.texts]
    assert all((box[:2] >= frame[:2] - 1.0).all() and (box[2:] <= frame[2:] + 1.0).all() for box in boxes)
    return boxes


def test_labels_keep_clear_of_each_other_and_stay_in_the_picture() -> None:
    rng = np.random.default_rng(1)
    places = [(float(x), float(y)) for x, y in rng.uniform((0.2, 0.2), (9.8, 5.8), (24, 2))] + [(5.0, 3.0)] * 6
    words = Words([Word(f"t{n}  1.23", at, "black", True) for n, at in enumerate(places)], places)
    boxes = laid_out(words)
    for n, first in enumerate(boxes):
        for second in boxes[n + 1 :]:
            sides = np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2])
            assert (sides <= 0.5).any()


def test_where_there_are_too_many_labels_only_those_that_matter_are_drawn() -> None:
    places = [(0.5 + 9.0 * (n % 20) / 20.0, 0.5 + 5.0 * math.floor(n / 20) / 10.0) for n in range(200)]
    labels = [Word(f"t{n}  1.23", at, "black", True) for n, at in enumerate(places)]
    lost, camera = Word("t0", places[0], RED, True), Word("c1", (5.0, 5.8), "blue")
    assert len(laid_out(Words([*labels, lost, camera], places))) == 2
