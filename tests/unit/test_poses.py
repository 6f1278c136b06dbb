"""Rotations and poses: group laws, the covariance convention, angle recovery near pi."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.rotation import rotation_exp, rotation_from_rpy, rotation_log, rotation_z, wrap_angle

vectors = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))


@given(vectors)
def test_log_undoes_exp_up_to_whole_turns(vector: Array) -> None:
    R = rotation_exp(vector)
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert rotation_exp(rotation_log(R)) == pytest.approx(R, abs=1e-7)
    assert np.linalg.norm(rotation_log(R)) <= np.pi + 1e-12


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, -0.8)])
@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, np.pi - 1e-5, 1e-9, 0.0])
def test_log_near_its_singularities(axis: tuple[float, ...], angle: float) -> None:
    R = rotation_exp(np.array(axis) * angle)
    assert rotation_exp(rotation_log(R)) == pytest.approx(R, abs=1e-9)


def test_rpy_turns_about_fixed_axes_in_the_order_roll_pitch_yaw() -> None:
    R = rotation_from_rpy(0.1, 0.2, 0.3)
    assert R[:, 0] == pytest.approx(rotation_z(0.3) @ [np.cos(0.2), 0.0, -np.sin(0.2)])


@given(vectors, vectors, vectors, vectors)
def test_compose_and_invert_carry_covariance_as_sampling_does(a: Array, b: Array, c: Array, d: Array) -> None:
    T_a_b, T_b_c = pose.transform(rotation_exp(a), b), pose.transform(rotation_exp(c), d)
    step = 1e-6
    for k in range(6):
        delta = np.zeros(6)
        delta[k] = step
        unit = np.outer(delta, delta) / step**2
        moved = pose.difference(pose.perturb(T_a_b, delta) @ T_b_c, T_a_b @ T_b_c) / step
        assert pose.compose(T_a_b, unit, T_b_c, np.zeros((6, 6)))[1] == pytest.approx(np.outer(moved, moved), abs=1e-3)
        moved = pose.difference(T_a_b @ pose.perturb(T_b_c, delta), T_a_b @ T_b_c) / step
        assert pose.compose(T_a_b, np.zeros((6, 6)), T_b_c, unit)[1] == pytest.approx(np.outer(moved, moved), abs=1e-3)
        T_b_a, covariance = pose.inverse_covariance_pose(T_a_b, unit)
        moved = pose.difference(pose.invert(pose.perturb(T_a_b, delta)), T_b_a) / step
        assert covariance == pytest.approx(np.outer(moved, moved), abs=1e-3)


def test_a_head_looking_down_has_image_up_along_the_pan_direction() -> None:
    R_world_camera = aim_rotation(np.pi / 2, -np.pi / 2) @ R_MOUNT_OPTICAL
    assert R_world_camera[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert -R_world_camera[:, 1] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


@given(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), vectors, vectors, vectors)
def test_pan_tilt_jacobian_is_the_derivative(
    pan_rad: float, tilt_rad: float, base: Array, offset: Array, mounted: Array
) -> None:
    head = PanTilt(pose.transform(rotation_exp(base), offset), pose.transform(np.eye(3), 0.05 * mounted))
    T_mount_camera = pose.transform(R_MOUNT_OPTICAL, 0.1 * base)
    J = head.jacobian(pan_rad, tilt_rad, T_mount_camera)
    step = 1e-6
    T = head.T_world_camera(pan_rad, tilt_rad, T_mount_camera)
    pan = pose.difference(head.T_world_camera(pan_rad + step, tilt_rad, T_mount_camera), T) / step
    tilt = pose.difference(head.T_world_camera(pan_rad, tilt_rad + step, T_mount_camera), T) / step
    assert pytest.approx(np.stack([pan, tilt], axis=1), abs=1e-4) == J


@given(st.floats(-100.0, 100.0))
def test_wrapped_angles_stay_within_half_a_turn(angle_rad: float) -> None:
    wrapped = wrap_angle(angle_rad)
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle_rad), abs=1e-9)
