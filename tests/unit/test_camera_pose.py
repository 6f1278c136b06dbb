"""A camera's pose from its carrier, and what anchors make of it; consistency against sampling."""

from __future__ import annotations

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation
from camrig.geometry.rotation import rotation_from_rpy, rotation_z
from camrig.locate import Histories, camera_pose, locate
from camrig.messages import CameraPose, DroneReading, FlightState
from camrig.rig import CameraSpec
from tests.anchored_cameras import (
    DRONE_CAMERA,
    FIXED_CAMERA,
    FREE_CAMERA,
    HEAD_CAMERA,
    KINEMATICS,
    ON_FLOOR,
    PAN,
    RIG,
    T_MOUNT,
    T_UNDER,
    TILT,
    TRUE_ON_HEAD,
    anchor,
    read,
    seen,
    within_chance,
)


def nees(T: Array, found: CameraPose) -> float:
    error = pose.difference(T, found.T_world_camera)
    return float(error @ np.linalg.solve(found.covariance, error))


def sigmas(found: CameraPose | None) -> Array:
    assert found is not None
    return np.asarray(np.sqrt(np.diag(found.covariance)))


# --- from the carrier -----------------------------------------------------------------------------------


def test_a_head_camera_stands_where_the_kinematics_say() -> None:
    found = camera_pose(HEAD_CAMERA, RIG, read(PAN, TILT), 1.0)
    assert found is not None
    assert found.T_world_camera == pytest.approx(TRUE_ON_HEAD)
    assert (found.camera_id, found.stamp_s) == ("north", 1.0)


def test_a_heads_covariance_is_that_of_its_angles_and_its_bias() -> None:
    """Errors of reading and bias, drawn, through the exact kinematics; the mount's own slack is the only extra."""
    rng = np.random.default_rng(0)
    sigma = np.hypot(0.001 * np.sqrt(0.5), 0.003)
    found = camera_pose(HEAD_CAMERA, RIG, read(PAN, TILT), 1.0)
    assert found is not None
    draws = [
        pose.difference(KINEMATICS.T_world_camera(PAN + a, TILT + b, T_MOUNT), TRUE_ON_HEAD)
        for a, b in rng.normal(size=(4000, 2)) * sigma
    ]
    assert found.covariance == pytest.approx(np.cov(np.array(draws).T), abs=1.3e-6)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0


def test_a_drones_camera_hangs_under_it() -> None:
    T_world_body = pose.transform(rotation_from_rpy(0.05, -0.03, 0.4), np.array([2.0, 1.5, 1.8]))
    histories = Histories()
    for stamp_s in (0.95, 1.05):
        reading = DroneReading("d", stamp_s, T_world_body, np.diag([1e-4] * 3 + [2.5e-5] * 3), FlightState.FLYING)
        histories = histories.with_reading(reading)
    found = camera_pose(DRONE_CAMERA, RIG, histories, 1.0)
    assert found is not None
    assert found.T_world_camera == pytest.approx(T_world_body @ T_UNDER)
    assert (sigmas(found)[:3] >= 0.01).all()
    assert (sigmas(found)[3:] >= 0.005).all()


def test_a_fixed_camera_is_where_it_is_bolted_and_a_free_one_nowhere() -> None:
    found = camera_pose(FIXED_CAMERA, RIG, Histories(), 5.0)
    assert found is not None
    assert found.T_world_camera == pytest.approx(TRUE_ON_HEAD)
    assert (sigmas(found) > 0.0).all()
    assert camera_pose(FREE_CAMERA, RIG, Histories(), 5.0) is None


@pytest.mark.parametrize("camera", [HEAD_CAMERA, DRONE_CAMERA])
def test_without_readings_the_pose_is_unknown(camera: CameraSpec) -> None:
    assert camera_pose(camera, RIG, Histories(), 1.0) is None


# --- with anchors ---------------------------------------------------------------------------------------


def test_anchors_take_a_heads_bias_away() -> None:
    off = read(PAN + 0.004, TILT - 0.003)
    before = camera_pose(HEAD_CAMERA, RIG, off, 1.0)
    found = locate(seen(ON_FLOOR[:2], TRUE_ON_HEAD, HEAD_CAMERA), off, RIG, {}).camera_pose
    assert found is not None
    assert np.abs(pose.difference(TRUE_ON_HEAD, found.T_world_camera)[3:]).max() < 2e-4
    assert (sigmas(found) < sigmas(before)).all()
    assert sigmas(found)[3:].max() < 0.2 * sigmas(before)[3:].max()


def test_the_corrected_covariance_is_what_sampling_shows() -> None:
    rng = np.random.default_rng(1)
    prior = camera_pose(HEAD_CAMERA, RIG, read(PAN, TILT), 1.0)
    assert prior is not None
    root = np.linalg.cholesky(prior.covariance)
    values = []
    for _ in range(500):
        T = pose.perturb(TRUE_ON_HEAD, root @ rng.normal(size=6))
        found = locate(seen(ON_FLOOR[:2], T, HEAD_CAMERA, rng), read(PAN, TILT), RIG, {})
        assert found.notes == ()
        assert found.camera_pose is not None
        values.append(nees(T, found.camera_pose))
    assert within_chance(values, 6)


def test_an_anchor_that_is_not_where_the_rig_says_is_left_out_and_named() -> None:
    moved = (ON_FLOOR[0], anchor(101, 1.5, 2.6), ON_FLOOR[2])
    alone = locate(seen((ON_FLOOR[0], ON_FLOOR[2]), TRUE_ON_HEAD, HEAD_CAMERA), read(PAN, TILT), RIG, {}).camera_pose
    found = locate(seen(moved, TRUE_ON_HEAD, HEAD_CAMERA), read(PAN, TILT), RIG, {})
    assert found.camera_pose is not None
    assert alone is not None
    assert found.camera_pose.T_world_camera == pytest.approx(alone.T_world_camera, abs=1e-9)
    (note,) = found.notes
    assert note.about == "tag36h11:101"
    assert "not where north should see it" in note.text


def test_of_contradicting_anchors_under_a_vague_drone_the_odd_one_out_is_left_out() -> None:
    T_world_body = pose.transform(rotation_z(0.3), np.array([1.8, 2.1, 1.9]))
    histories = Histories()
    for stamp_s in (0.95, 1.05):
        reading = DroneReading("d", stamp_s, T_world_body, np.diag([2.5e-3] * 3 + [4e-4] * 3), FlightState.FLYING)
        histories = histories.with_reading(reading)
    # 3 cm is within what the drone's own pose leaves open, and far outside what two good anchors do.
    moved = (ON_FLOOR[0], anchor(101, 1.23, 2.6), ON_FLOOR[2])
    found = locate(seen(moved, T_world_body @ T_UNDER, DRONE_CAMERA), histories, RIG, {})
    assert [note.about for note in found.notes] == ["tag36h11:101"]
    assert found.camera_pose is not None
    assert found.camera_pose.T_world_camera == pytest.approx(T_world_body @ T_UNDER, abs=1e-3)


def test_one_oblique_anchor_places_a_free_camera() -> None:
    found = locate(seen(ON_FLOOR[:1], TRUE_ON_HEAD, FREE_CAMERA), Histories(), RIG, {}).camera_pose
    assert found is not None
    assert found.T_world_camera == pytest.approx(TRUE_ON_HEAD, abs=1e-4)


def test_a_free_cameras_covariance_is_what_sampling_shows() -> None:
    rng = np.random.default_rng(2)
    values = []
    for _ in range(500):
        found = locate(seen(ON_FLOOR[:2], TRUE_ON_HEAD, FREE_CAMERA, rng), Histories(), RIG, {})
        assert found.camera_pose is not None
        values.append(nees(TRUE_ON_HEAD, found.camera_pose))
    assert within_chance(values, 6)


def head_on(distance_m: float) -> Array:
    """A camera straight above anchor 100, so far that its two poses look alike."""
    return pose.transform(aim_rotation(0.0, -np.pi / 2 + 0.05) @ R_MOUNT_OPTICAL, np.array([1.9, 2.2, distance_m]))


def test_a_free_camera_whose_one_anchor_leaves_two_poses_open_has_none() -> None:
    rng = np.random.default_rng(3)
    found = locate(seen(ON_FLOOR[:1], head_on(6.0), FREE_CAMERA, rng), Histories(), RIG, {})
    assert found.camera_pose is None
    (note,) = found.notes
    assert (note.about, "two camera poses" in note.text) == ("hand", True)


def test_a_second_anchor_decides_between_them() -> None:
    rng = np.random.default_rng(3)
    found = locate(seen(ON_FLOOR[:2], head_on(6.0), FREE_CAMERA, rng), Histories(), RIG, {})
    assert found.camera_pose is not None
    assert np.abs(pose.difference(head_on(6.0), found.camera_pose.T_world_camera)[3:]).max() < 0.05


def test_a_free_camera_without_anchors_is_nowhere() -> None:
    assert locate(seen((), TRUE_ON_HEAD, FREE_CAMERA), Histories(), RIG, {}).camera_pose is None


def test_a_head_that_does_not_answer_is_placed_by_anchors_alone() -> None:
    found = locate(seen(ON_FLOOR[:2], TRUE_ON_HEAD, HEAD_CAMERA), Histories(), RIG, {}).camera_pose
    assert found is not None
    assert found.T_world_camera == pytest.approx(TRUE_ON_HEAD, abs=1e-4)


def test_of_an_anchor_seen_twice_the_one_in_its_place_counts() -> None:
    twin = anchor(100, 1.2, 2.6)
    both = seen((twin, ON_FLOOR[0]), TRUE_ON_HEAD, HEAD_CAMERA)
    found = locate(both, read(PAN, TILT), RIG, {})
    alone = locate(seen(ON_FLOOR[:1], TRUE_ON_HEAD, HEAD_CAMERA), read(PAN, TILT), RIG, {})
    assert found.camera_pose is not None
    assert alone.camera_pose is not None
    assert found.camera_pose.T_world_camera == pytest.approx(alone.camera_pose.T_world_camera, abs=1e-12)
    assert [note.about for note in found.notes] == ["tag36h11:100"]
    # Nothing says which is meant: neither counts.
    assert locate(seen((twin, ON_FLOOR[0]), TRUE_ON_HEAD, FREE_CAMERA), Histories(), RIG, {}).camera_pose is None
