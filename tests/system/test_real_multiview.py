"""Cameras and tags from real detections alone, against the solution of another program (shared test data).

``tagslam_2``: two fisheye cameras carried past 13 tags on walls and floor; ``tagslam_23``: a board of 8 tags before one
camera. The lenses' calibrations are given; every pose is found from the corners.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camrig.calibrate.extrinsics import Extrinsics, extrinsics
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import Shot
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert, transform

SIZE_M = {"tagslam_2": 0.16, "tagslam_23": 0.049}
VIEWS = {"tagslam_2": 4276, "tagslam_23": 1896}
"""Tags in pictures that the other program placed too."""

Place = tuple[str, int, str]


@dataclass(frozen=True)
class Solved:
    """Camrig's solution of one set and the other program's, by camera, instant and tag: (4,) misses in pixels."""

    found: Extrinsics
    ours_px: dict[Place, Array]
    theirs_px: dict[Place, Array]
    T_theirs: dict[str, Transform]

    @property
    def both(self) -> tuple[Array, Array]:
        """The misses of both, of the corners that both have."""
        names = sorted(self.theirs_px.keys() & self.ours_px.keys())
        return tuple(np.concatenate([misses[name] for name in names]) for misses in (self.ours_px, self.theirs_px))  # type: ignore[return-value]


@pytest.fixture(scope="module", params=sorted(SIZE_M))
def solved(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, Solved]:
    return request.param, solve(shared_data, request.param)


@lru_cache(maxsize=2)
def solve(shared_data: Path, name: str) -> Solved:
    data = json.loads((shared_data / "images" / name / f"{name}.json").read_text())
    lenses = {camera: lens(spec) for camera, spec in data["cameras"].items()}
    shots = [
        Shot(camera, k, {tag: np.array(corners) for tag, corners in tags.items()})
        for k, frame in enumerate(data["frames"])
        for camera, tags in frame["det"].items()
    ]
    sizes_m = {tag: SIZE_M[name] for shot in shots for tag in shot.corners_px}
    found = extrinsics(shots, Setup(lenses, sizes_m))
    ours = {
        (each.picture.camera, each.picture.instant, each.mark): np.linalg.norm(off, axis=1)
        for each, off in zip(found.sighted, found.residual_px, strict=True)
    }
    T, T_body = reference(data["reference"]), reference_bodies(data)
    theirs = {
        (shot.camera_id, shot.instant, tag): np.linalg.norm(
            lenses[shot.camera_id].project(
                apply(
                    invert(T_body[shot.instant].get("rig", T["rig"]) @ T[shot.camera_id])
                    @ T_body[shot.instant].get("tag_board", np.eye(4))
                    @ T[f"tag_{tag}"],
                    SIZE_M[name] * TAG_CORNERS,
                )
            )
            - corners,
            axis=1,
        )
        for shot in shots
        for tag, corners in shot.corners_px.items()
        if shot.instant in T_body
    }
    return Solved(found, ours, theirs, T)


def lens(spec: dict[str, Any]) -> BrownLens | FisheyeLens:
    fx, fy, cx, cy = spec["fx_fy_cx_cy"]
    kind = FisheyeLens if spec["model"] == "equidistant" else BrownLens
    return kind(tuple(spec["resolution"]), (fx, fy), (cx, cy), tuple(float(k) for k in spec["dist"]))


def reference(data: dict[str, Any]) -> dict[str, Transform]:
    """Return the static poses in their parents; the perch is the world."""
    return {name: pose([*each["t"], *each["q_xyzw"]]) for name, each in data["static_tf"].items()}


def reference_bodies(data: dict[str, Any]) -> dict[int, dict[str, Transform]]:
    """Return where the body that moves was, by instant."""
    instants = {frame["stamp"]: k for k, frame in enumerate(data["frames"])}
    ((name, poses),) = data["reference"]["body_odom"].items()
    return {instants[stamp]: {name.removeprefix("body_"): pose(each)} for stamp, each in poses.items()}


def pose(t_q: list[float]) -> Transform:
    x, y, z, w = np.array(t_q[3:]) / np.linalg.norm(t_q[3:])
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return transform(np.eye(3) + 2.0 * w * K + 2.0 * K @ K, np.array(t_q[:3]))


def test_corners_are_missed_by_no_more_than_by_the_other_program(solved: tuple[str, Solved]) -> None:
    name, of = solved
    ours, theirs = of.both
    assert ours.size == theirs.size == 4 * VIEWS[name]
    assert of.found.unplaced == ()
    assert np.median(ours) <= 1.1 * np.median(theirs)
    assert np.sqrt(np.mean(ours**2)) <= 1.05 * np.sqrt(np.mean(theirs**2))


def test_tags_are_where_the_other_program_has_them(solved: tuple[str, Solved]) -> None:
    """Distances between tags, for the frames of the world are free; in multiples of a tag's size."""
    name, of = solved
    ours, theirs = (
        np.stack([T[:3, 3] for T in poses])
        for poses in (
            [mark.T for mark in of.found.body_marks.values()],
            [of.T_theirs[f"tag_{tag}"] for tag in of.found.body_marks],
        )
    )
    apart = [np.linalg.norm(at[:, None] - at, axis=-1) for at in (ours, theirs)]
    assert np.abs(apart[0] - apart[1]).max() < 0.1 * SIZE_M[name]


def test_the_two_cameras_are_as_far_apart(shared_data: Path) -> None:
    of = solve(shared_data, "tagslam_2")
    ours = {name: camera.T for name, camera in of.found.cameras.items()}
    apart = [np.linalg.norm(T["cam1"][:3, 3]) for T in (ours, of.T_theirs)]
    assert apart[0] == pytest.approx(apart[1], rel=0.02)
    turned = ours["cam1"][:3, :3] @ of.T_theirs["cam1"][:3, :3].T
    assert np.degrees(np.arccos(0.5 * (np.trace(turned) - 1.0))) < 0.5


def test_the_noise_of_one_sets_corners_is_that_of_the_other(shared_data: Path) -> None:
    """By the sigma that the board's corners gave, the residuals of the rig's have a sigma of 1 within a fifth."""
    board, rig = (solve(shared_data, name).found for name in ("tagslam_23", "tagslam_2"))
    assert rig.noise_px / board.noise_px == pytest.approx(1.0, abs=0.2)
