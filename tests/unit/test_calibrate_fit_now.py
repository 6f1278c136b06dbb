"""Whether a calibration fits now: cameras that were turned are told by how much, cameras that agree agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.calibrate.agreement import agreement
from camrig.calibrate.fit_now import fit_now, stations
from camrig.calibrate.setup import OnHead, Setup
from camrig.calibrate.sighted import Shot, sighted
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt, aim_rotation, look_of
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert, perturb, transform
from camrig.geometry.rotation import rotation_exp, rotation_from_rpy, rotation_z, rpy_of

LENS = BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
SIZE_M, NOISE_PX = 0.2, 0.2
TAGS = {f"a{k}": transform(np.eye(3), np.array([0.7 * (k % 2) - 0.35, 0.6 * (k // 2), 0.0])) for k in range(4)}
CAMERAS = {
    name: transform(aim_rotation(pan, -0.9) @ R_MOUNT_OPTICAL, np.array([x, 0.3, 2.2]))
    for name, x, pan in (("west", -1.3, 0.0), ("east", 1.3, np.pi))
}


def shots(moved: dict[str, Array] | None = None, seed: int = 0) -> list[Shot]:
    rng = np.random.default_rng(seed)
    found = []
    for name, T in CAMERAS.items():
        T_camera = invert(perturb(T, (moved or {}).get(name, np.zeros(6))))
        seen = {tag: LENS.project(apply(T_camera @ T_tag, SIZE_M * TAG_CORNERS)) for tag, T_tag in TAGS.items()}
        found.append(Shot(name, 0, {tag: px + rng.normal(size=(4, 2)) * NOISE_PX for tag, px in seen.items()}))
    return found


def setup(anchors: dict[str, Transform]) -> Setup:
    return Setup(dict.fromkeys(CAMERAS, LENS), dict.fromkeys(TAGS, SIZE_M), anchors, dict.fromkeys(TAGS, ""))


def test_a_camera_that_nobody_touched_fits_to_its_noise() -> None:
    fit = fit_now(shots(), setup(TAGS), {(name, 0): T for name, T in CAMERAS.items()})
    for off in fit.by_anchors.values():
        assert off.off_mm < 4.0 * off.sigma_mm
        assert off.off_deg < 4.0 * off.sigma_deg
        assert np.median(off.miss_px) < 2.0 * NOISE_PX
    assert np.median(fit.agreement.of_camera("west")[0]) < NOISE_PX


def test_a_camera_that_was_turned_is_told_by_how_much() -> None:
    turn = np.array([0.03, 0.0, 0.0, 0.0, 0.0, np.radians(0.8)])
    fit = fit_now(shots({"west": turn}), setup(TAGS), {(name, 0): T for name, T in CAMERAS.items()})
    off = fit.by_anchors["west", 0]
    assert off.off_deg == pytest.approx(0.8, abs=4.0 * off.sigma_deg)
    assert off.off_mm == pytest.approx(30.0, abs=4.0 * off.sigma_mm)
    assert fit.by_anchors["east", 0].off_deg < 4.0 * off.sigma_deg
    assert fit.seen == {"west": 4, "east": 4}


def test_without_anchors_cameras_that_disagree_are_told_in_pixels_and_millimetres() -> None:
    turn = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    fit = fit_now(shots({"west": turn}), setup({}), {(name, 0): T for name, T in CAMERAS.items()})
    assert fit.by_anchors == {}
    px, mm = fit.agreement.of_camera("east")
    assert len(px) == 16
    # Half of the 50 mm is each camera's; what is in the plane of both lines of sight would not show at all.
    assert np.median(px) == pytest.approx(0.025 * 828.0 / 2.4, rel=0.2)
    assert np.median(mm) == pytest.approx(25.0, rel=0.2)


def test_points_are_placed_where_they_are() -> None:
    """Without noise nothing is missed, whatever points make a mark."""
    clean = [
        Shot(
            name, 3, {tag: LENS.project(apply(invert(T) @ T_tag, SIZE_M * TAG_CORNERS)) for tag, T_tag in TAGS.items()}
        )
        for name, T in CAMERAS.items()
    ]
    seen = sighted(clean, dict.fromkeys(CAMERAS, LENS), dict.fromkeys(TAGS, SIZE_M), frozenset())
    found = agreement(seen, dict.fromkeys(CAMERAS, LENS), {(name, 0): T for name, T in CAMERAS.items()})
    assert found.points == 16
    assert np.abs(found.residual_px).max() < 1e-6
    assert agreement(seen, dict.fromkeys(CAMERAS, LENS), {("west", 0): CAMERAS["west"]}).points == 0


def test_a_camera_on_a_head_stands_where_its_head_says() -> None:
    head = PanTilt(
        transform(rotation_z(0.4), np.array([1.0, 2.0, 3.0])), transform(np.eye(3), np.array([0.01, 0, 0.05]))
    )
    mount = transform(rotation_exp(np.array([0.1, 0.2, 0.3])), np.array([0.02, 0.0, 0.04]))
    aims = [(0.1, -0.5), (0.7, -0.2)]
    of = [Shot("north", k, {}, aim_rad=aim) for k, aim in enumerate([*aims, aims[0]])]
    on_head = Setup({"north": LENS}, {}, heads={"north": OnHead(head.T_arm_tilt, mount, 0.001)})
    found = stations(of, on_head, {"north": head.T_world_base})
    assert list(found) == [("north", 0), ("north", 1)]
    for k, aim in enumerate(aims):
        np.testing.assert_allclose(found["north", k], head.T_world_camera(*aim, mount), atol=1e-12)


ANGLES = st.floats(-3.1, 3.1)


@settings(max_examples=50, deadline=None)
@given(ANGLES, st.floats(-1.57, 1.57), ANGLES)
def test_how_a_camera_looks_is_told_and_built_alike(pan: float, tilt: float, roll: float) -> None:
    R = aim_rotation(pan, tilt) @ R_MOUNT_OPTICAL @ rotation_z(roll)
    found = look_of(R)
    np.testing.assert_allclose(aim_rotation(*found[:2]) @ R_MOUNT_OPTICAL @ rotation_z(found[2]), R, atol=1e-7)
    np.testing.assert_allclose(rotation_from_rpy(*rpy_of(R)), R, atol=1e-7)
