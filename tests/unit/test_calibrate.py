"""Sparse bundle adjustment and extrinsics: slopes by differences, poses recovered, covariance honest, faults named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from camrig.calibrate.adjust import adjust
from camrig.calibrate.chains import Chains, points_in_camera, slopes_in_camera
from camrig.calibrate.extrinsics import Extrinsics, extrinsics
from camrig.calibrate.normal import TagViews
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import Shot
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, difference, invert, perturb, transform
from camrig.geometry.rotation import rotation_exp, rotation_x

SIZE_M = 0.1
NOISE_PX = 0.2
LENSES: dict[str, Lens] = {
    "left": BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0, 0.0)),
    "right": FisheyeLens((1280, 1024), (470.0, 470.0), (620.0, 530.0), (-0.018, -0.003, 0.007, -0.003)),
}


@dataclass
class Walk:
    """Two cameras on a rig carried past eight tags: what is true, and what is seen of it."""

    T_rig_camera: dict[str, Transform]
    T_world_tag: dict[str, Transform]
    T_world_rig: list[Transform]
    shots: list[Shot]


def walk(seed: int, instants: int = 12, noise_px: float = NOISE_PX) -> Walk:
    rng = np.random.default_rng(seed)
    rig = {
        "left": np.eye(4),
        "right": transform(rotation_exp(np.array([0.02, -0.05, 0.01])), np.array([0.12, 0.0, 0.01])),
    }
    tags = {
        f"t{k}": transform(rotation_exp(rng.normal(size=3) * 0.2), np.array([0.3 * (k % 4), 0.3 * (k // 4), 0.0]))
        for k in range(8)
    }
    carried = [
        perturb(
            transform(rotation_x(np.pi), np.array([0.45, 0.15, 1.2])), rng.normal(size=6) * [0.3, 0.3, 0.2, 0.2, 0.2, 1]
        )
        for _ in range(instants)
    ]
    shots = []
    for k, T_world_rig in enumerate(carried):
        for name, lens in LENSES.items():
            T_camera_world = invert(T_world_rig @ rig[name])
            seen = {tag: lens.project(apply(T_camera_world @ T, SIZE_M * TAG_CORNERS)) for tag, T in tags.items()}
            size = np.array(lens.size_px)
            inside = {tag: px for tag, px in seen.items() if np.isfinite(px).all() and ((px > 0) & (px < size)).all()}
            shots.append(Shot(name, k, {tag: px + rng.normal(size=(4, 2)) * noise_px for tag, px in inside.items()}))
    return Walk(rig, tags, carried, shots)


def solve(of: Walk, lenses: dict[str, Lens] | None = None) -> Extrinsics:
    return extrinsics(of.shots, Setup(lenses or LENSES, {f"t{k}": SIZE_M for k in range(8)}))


def tag_error(found: Extrinsics, of: Walk, tag: str) -> Array:
    board = next(name for name, mark in found.body_marks.items() if (np.eye(4) == mark.T).all())
    return difference(invert(of.T_world_tag[board]) @ of.T_world_tag[tag], found.body_marks[tag].T)


def test_each_pose_of_a_chain_moves_corners_as_its_slope_says() -> None:
    rng = np.random.default_rng(0)
    T = np.stack([transform(rotation_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(5)])
    chains = Chains(np.array([[0, 1], [2, -1]]), np.array([[3, 4], [-1, 3]]))
    corners = rng.normal(size=(2, 4, 3))
    points, slopes = slopes_in_camera(T, chains, corners)
    assert points == pytest.approx(points_in_camera(T, chains, corners))
    for pose in range(5):
        for k in range(6):
            step = np.zeros(6)
            step[k] = 1e-6
            above, below = T.copy(), T.copy()
            above[pose], below[pose] = perturb(T[pose], step), perturb(T[pose], -step)
            expected = (points_in_camera(above, chains, corners) - points_in_camera(below, chains, corners)) / 2e-6
            found = np.where((chains.columns == pose)[:, None, None, :], slopes[..., k], 0.0).sum(axis=-1)
            assert found == pytest.approx(expected, abs=1e-8)


def test_without_noise_everything_is_found_from_scratch() -> None:
    of = walk(1, noise_px=0.0)
    found = solve(of)
    assert found.unplaced == ()
    assert pytest.approx(of.T_rig_camera["right"], abs=1e-6) == found.cameras["right"].T
    assert max(float(np.abs(tag_error(found, of, tag)).max()) for tag in found.body_marks) < 1e-6


def test_covariances_and_noise_are_those_of_the_errors() -> None:
    """NEES of the second camera and of one tag over scenes, within the 99.8 % bounds of its mean."""
    camera, tag, noise = [], [], []
    for seed in range(12):
        of = walk(seed)
        found = solve(of)
        error = difference(of.T_rig_camera["right"], found.cameras["right"].T)
        camera.append(float(error @ np.linalg.solve(found.cameras["right"].covariance, error)))
        name = next(name for name, mark in found.body_marks.items() if mark.covariance.any())
        error = tag_error(found, of, name)
        tag.append(float(error @ np.linalg.solve(found.body_marks[name].covariance, error)))
        noise.append(found.noise_px)
    low, high = (float(chi2.ppf(p, 6 * len(tag))) / len(tag) for p in (0.001, 0.999))
    assert low <= np.mean(camera) <= high
    assert low <= np.mean(tag) <= high
    assert np.mean(noise) == pytest.approx(NOISE_PX, rel=0.05)


def test_a_few_tags_misread_change_little() -> None:
    of = walk(3)
    for k in (0, 7, 14):
        tag, corners = next(iter(of.shots[k].corners_px.items()))
        of.shots[k] = Shot(of.shots[k].camera_id, of.shots[k].instant, {**of.shots[k].corners_px, tag: corners + 30.0})
    found = solve(of)
    assert difference(of.T_rig_camera["right"], found.cameras["right"].T) == pytest.approx(np.zeros(6), abs=2e-3)
    assert found.noise_px == pytest.approx(NOISE_PX, rel=0.2)


def test_what_hangs_on_nothing_else_is_named() -> None:
    of = walk(4)
    apart = [shot for shot in of.shots if (shot.camera_id == "left") == (shot.instant < 6)]
    alone = Shot("left", 99, {"t9": next(iter(of.shots[0].corners_px.values()))})
    found = extrinsics([*apart, alone], Setup(LENSES, {f"t{k}": SIZE_M for k in range(10)}))
    assert found.unplaced == ("right", "t9")
    assert set(found.cameras) == {"left"}


def test_anchors_put_cameras_in_the_world() -> None:
    """Cameras on a ceiling, a board of four tags walked past them, two anchors on the floor that one of them sees."""
    rng = np.random.default_rng(6)
    ceiling = transform(rotation_x(np.pi), np.array([0.5, 0.4, 2.0]))
    cameras = {"left": ceiling, "right": ceiling @ transform(np.eye(3), np.array([0.4, 0.0, 0.0]))}
    anchors = {f"a{k}": transform(np.eye(3), np.array([0.3 * k, 0.2, 0.0])) for k in range(2)}
    board = {f"t{k}": transform(np.eye(3), np.array([0.2 * (k % 2), 0.2 * (k // 2), 0.0])) for k in range(4)}
    shots = []
    for k in range(15):
        T_world_board = perturb(
            np.eye(4), rng.normal(size=6) * [0.2, 0.2, 0.2, 0.3, 0.3, 1.0] + [0.6, 0.3, 0.6, 0, 0, 0]
        )
        places = {**anchors, **{tag: T_world_board @ T for tag, T in board.items()}}
        for name, lens in LENSES.items():
            pixels = {
                tag: lens.project(apply(invert(cameras[name]) @ T, SIZE_M * TAG_CORNERS)) for tag, T in places.items()
            }
            seen = [
                tag for tag, px in pixels.items() if np.isfinite(px).all() and (name == "left" or tag not in anchors)
            ]
            shots.append(Shot(name, k, {tag: pixels[tag] + rng.normal(size=(4, 2)) * NOISE_PX for tag in seen}))
    found = extrinsics(shots, Setup(LENSES, dict.fromkeys((*board, *anchors), SIZE_M), anchors))
    assert found.anchored
    assert found.unplaced == ()
    for name, T in cameras.items():
        error = difference(T, found.cameras[name].T)
        nees = float(error @ np.linalg.solve(found.cameras[name].covariance, error))
        assert nees < float(chi2.ppf(0.999, 6))
        assert np.linalg.norm(error[:3]) < 0.02


def test_nothing_seen_is_told_in_one_sentence() -> None:
    with pytest.raises(InputError, match="no camera shows a tag or a board"):
        extrinsics([Shot("left", 0, {})], Setup(LENSES, {}))


def test_a_pose_without_a_view_is_told() -> None:
    lens = LENSES["left"]
    T = np.stack([transform(np.eye(3), np.array([0.0, 0.0, 1.0])), np.eye(4)])
    one = np.zeros((1, 1), dtype=np.int64)
    corners = SIZE_M * TAG_CORNERS[None]
    views = TagViews(one[0], Chains(one - 1, one), corners, lens.project(apply(T[0], corners)), np.ones((1, 4)))
    with pytest.raises(InputError, match="1 of 2 poses are in no view"):
        adjust(views, [lens], T, np.zeros(2, dtype=bool))
    found = adjust(views, [lens], T, np.array([False, True]))
    assert np.abs(found.T - T).max() < 1e-9
    assert not found.covariance_of(1).any()
