"""Real tag corners against TagSLAM's solution: a board of tags before a fixed camera, fisheyes among fixed tags."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.locate import Histories, Located, locate
from camrig.messages import TagDetection, TagDetections
from camrig.rig import Anchor, Body, BodyTag, CameraSpec, FixedMount, FreeMount, Rig, Space, TagKey


def load(folder: Path, name: str) -> dict[str, Any]:
    text = (folder / "images" / name / f"{name}.json").read_text()
    return dict(json.loads(text))


def key(number: str) -> TagKey:
    return TagKey("tag36h11", int(number))


def from_quaternion(t: Any, q_xyzw: Any) -> Transform:
    x, y, z, w = np.asarray(q_xyzw, dtype=float) / np.linalg.norm(q_xyzw)
    v = np.array([x, y, z])
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return pose.transform((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * K, np.asarray(t, dtype=float))


def placed(data: dict[str, Any], name: str) -> Transform:
    entry = data["reference"]["static_tf"][name]
    return from_quaternion(entry["t"], entry["q_xyzw"])


def moving(data: dict[str, Any], body: str) -> dict[str, Transform]:
    return {
        stamp: from_quaternion(v[:3], v[3:7]) for stamp, v in data["reference"]["body_odom"][f"body_{body}"].items()
    }


def views(data: dict[str, Any], rig: Rig, step: int) -> Iterator[tuple[str, str, int, Located]]:
    """Locate every ``step``-th picture that shows tags; its stamp, camera and number of tags."""
    for frame in data["frames"][::step]:
        for name, camera in rig.cameras.items():
            corners = {number: np.array(four, dtype=float) for number, four in frame["det"].get(name, {}).items()}
            tags = tuple(
                TagDetection(key(number), four, (float(four[:, 0].mean()), float(four[:, 1].mean())), 0, 60.0)
                for number, four in corners.items()
            )
            if tags:
                detections = TagDetections(name, 0.0, 0, camera.lens.size_px, tags, 0.0)
                yield frame["stamp"], name, len(tags), locate(detections, Histories(), rig, {})


def quantiles(errors: list[Array]) -> tuple[Array, Array]:
    """Median and 95 % of position errors (m) and of rotation errors (rad)."""
    both = np.array(errors)
    sizes = np.stack([np.linalg.norm(both[:, :3], axis=1), np.linalg.norm(both[:, 3:], axis=1)])
    return np.quantile(sizes[0], [0.5, 0.95]), np.quantile(sizes[1], [0.5, 0.95])


def test_a_board_of_nine_tags_is_where_tagslam_puts_it(shared_data: Path) -> None:
    data = load(shared_data, "tagslam_23")
    fx, fy, cx, cy = data["cameras"]["cam0"]["fx_fy_cx_cy"]
    camera = CameraSpec(
        "cam0", BrownLens((640, 480), (fx, fy), (cx, cy)), FixedMount(placed(data, "rig") @ placed(data, "cam0"))
    )
    names = [name for name in data["reference"]["static_tf"] if name[4:].isdigit() and name.startswith("tag_")]
    board = Body("board", tuple(BodyTag(key(name[4:]), 0.049, placed(data, name)) for name in names), "free")
    rig = Rig("tagslam", Space(), {"cam0": camera}, targets={"board": board})
    truth = moving(data, "tag_board")
    errors = []
    for stamp, _, _, found in views(data, rig, step=2):
        (sighting,) = found.sightings
        errors.append(pose.difference(truth[stamp], sighting.T_world_body))
    position, rotation = quantiles(errors)
    assert len(errors) == 186
    assert position == pytest.approx([0.0, 0.0], abs=0.0005)
    assert rotation == pytest.approx([0.0, 0.0], abs=0.003)


def test_fisheye_cameras_find_themselves_among_anchors_where_tagslam_does(shared_data: Path) -> None:
    data = load(shared_data, "tagslam_2")
    cameras = {}
    for name, given in data["cameras"].items():
        fx, fy, cx, cy = given["fx_fy_cx_cy"]
        lens = FisheyeLens(tuple(given["resolution"]), (fx, fy), (cx, cy), tuple(given["dist"]))
        cameras[name] = CameraSpec(name, lens, FreeMount())
    names = [name for name in data["reference"]["static_tf"] if name.startswith("tag_")]
    anchors = tuple(Anchor(key(name[4:]), 0.16, placed(data, "perch") @ placed(data, name)) for name in names)
    rig = Rig("tagslam", Space(), cameras, anchors=anchors)
    truth = moving(data, "rig")
    errors, seen, unplaced = [], 0, 0
    for stamp, name, tags, found in views(data, rig, step=3):
        if stamp not in truth:
            continue
        seen += 1
        if found.camera_pose is None:
            unplaced += 1
            assert tags == 1
            assert "two camera poses" in found.notes[0].text
        elif tags > 1:
            errors.append(pose.difference(truth[stamp] @ placed(data, name), found.camera_pose.T_world_camera))
    position, rotation = quantiles(errors)
    assert seen > 250
    assert unplaced < 0.02 * seen
    assert position[0] < 0.004
    assert position[1] < 0.02
    assert rotation[0] < 0.003
