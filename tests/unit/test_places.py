"""A camera's place as a vector and back: limits, axes askew, aims, zoom tables."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.geometry.lens_row import FX
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp, rotation_from_rpy, rotation_z
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.optimise import FixedPlace, HeadPlace, Scene, SceneCamera
from camrig.optimise.kernels.aims import head_vectors, within
from camrig.optimise.kernels.pose import lens_of, pose_of, twist_of
from camrig.optimise.kernels.problem import PAN, TILT, VARIABLES, ZOOM, Problem
from camrig.optimise.places import aim_of, bounds, vector_of
from camrig.optimise.problem import problem_of
from camrig.optimise.scene import ZoomStep
from tests.planner_scenes import BOX, LAB, LEVEL, drone, head, targets
from tests.planner_scenes import TILT as TILT_LIMITS


def problem(*cameras: SceneCamera) -> Problem:
    return problem_of(Scene(cameras, targets((1.0, 1.0))))


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.1, -0.2)])
def test_a_camera_mounted_askew_is_aimed_by_its_own_axis(rpy: tuple[float, float, float]) -> None:
    mounted = transform(rotation_from_rpy(*rpy) @ LEVEL[:3, :3], np.array([0.05, 0.02, 0.04]))
    camera = head("h", 1.0, 1.0, mounted)
    assert isinstance(camera.place, HeadPlace)
    directions = np.array([[1.0, 0.2, -1.0], [-0.5, 0.4, -0.8], [0.1, -1.0, -1.5]])
    one = problem(camera)
    vectors = head_vectors(one, 0, one.low[0, :3], directions, 0.0)
    poses = [pose_of(one.cameras[0], vector) for vector in vectors]
    axes = np.array([R[:, 2] for R, _ in poses])
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.degrees(np.arccos((axes * unit).sum(axis=1))).max() < 1.0
    for vector, (R, position) in zip(vectors, poses, strict=True):
        T = camera.place.kinematics.T_world_camera(vector[PAN], vector[TILT], mounted)
        np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
        np.testing.assert_allclose(T[:3, 3], position, atol=1e-12)


def test_a_pan_comes_inside_its_limits_by_whole_turns_first() -> None:
    one = problem(head("h", 0.0, 0.0))
    angles = np.array([[math.tau + 1.0, -0.5], [3.1, -0.5], [-1.0, 3.0]])
    vectors = np.column_stack([np.zeros((3, 2)), np.full(3, 2.7), angles, np.zeros(3)])
    inside = within(one, 0, vectors)[:, PAN : TILT + 1]
    np.testing.assert_allclose(inside, [[1.0, -0.5], [2.9, -0.5], [-1.0, TILT_LIMITS[1]]])


@given(st.floats(-20.0, 20.0), st.floats(-4.0, 4.0))
def test_what_is_within_the_limits_stays_and_all_else_comes_in(pan: float, tilt: float) -> None:
    one = problem(head("h", 1.0, 1.0))
    vector = np.array([1.0, 1.0, 2.7, pan, tilt, 0.0])
    inside = within(one, 0, vector[None])[0]
    assert (one.low[0] <= inside).all()
    assert (inside <= one.high[0]).all()
    if (one.low[0] <= vector).all() and (vector <= one.high[0]).all():
        assert (inside == vector).all()


def test_a_drone_is_a_head_whose_pan_is_the_yaw() -> None:
    camera = drone("d", yaw_free=True)
    u = np.array([1.0, 2.0, 1.5, 0.4, 0.0, 0.0])
    R, origin = pose_of(problem(camera).cameras[0], u)
    np.testing.assert_allclose(R, rotation_z(0.4) @ np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(origin, u[:3])
    low, high = bounds(camera.place)
    assert (low[:3].tolist(), high[:3].tolist()) == ([0.0, 0.0, 1.0], list(BOX[1]))  # never below a metre
    assert (low[PAN], high[PAN]) == (-1.5, 1.5)


def test_a_bolted_camera_stands_as_it_is_and_has_nothing_free() -> None:
    T = transform(rotation_exp(np.array([0.3, 2.0, -0.4])), np.array([1.0, 2.0, 2.4]))
    one = problem(SceneCamera("f", LAB, FixedPlace(T)))
    assert (one.low == one.high).all()
    R, origin = pose_of(one.cameras[0], one.low[0])
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-12)
    np.testing.assert_allclose(origin, T[:3, 3], atol=1e-12)


ZOOMED = replace(
    head("h", 1.0, 1.0),
    zoom=(
        ZoomStep(0.0, LAB),
        ZoomStep(100.0, replace(LAB, focal_px=(1500.0, 1500.0), distortion=(-0.2, 0.0, 0.0, 0.0))),
    ),
)


@pytest.mark.parametrize(
    ("camera", "aim"),
    [
        (head("h", 1.0, 1.0), HeadAim(0.3, -0.7)),
        (ZOOMED, HeadAim(0.3, -0.7, 25.0)),
        (drone("d"), DroneAim((1.0, 2.0, 1.5), 0.6)),
    ],
)
def test_an_aim_comes_back_from_its_vector(camera: SceneCamera, aim: Aim) -> None:
    vector = vector_of(camera, aim)
    assert vector is not None
    assert aim_of(camera, vector) == aim


def test_what_an_aim_does_not_say_has_no_vector() -> None:
    place = head("h", 1.0, 1.0).place
    assert isinstance(place, HeadPlace)
    mounted = replace(head("h", 1.0, 1.0), place=replace(place, mount_m=((0.0, 0.0, 2.7), (5.0, 3.0, 2.7))))
    assert vector_of(mounted, HeadAim(0.0, -0.5)) is None
    assert vector_of(head("h", 1.0, 1.0), DroneAim((1.0, 1.0, 1.0))) is None
    assert vector_of(drone("d"), None) is None
    assert aim_of(SceneCamera("f", LAB, FixedPlace(np.eye(4))), np.zeros(VARIABLES)) is None


def test_between_two_rows_of_a_zoom_table_the_lens_is_between() -> None:
    one = problem(ZOOMED)
    assert (one.low[0, ZOOM], one.high[0, ZOOM]) == (0.0, 1.0)
    wide, half, tele, beyond = (
        lens_of(one.cameras[0], one.lenses, np.array([0.0, 0.0, 0.0, 0.0, 0.0, at]))[FX] for at in (0.0, 0.5, 1.0, 1.5)
    )
    assert (wide, tele, beyond) == (LAB.focal_px[0], 1500.0, 1500.0)
    assert half == pytest.approx((wide + tele) / 2.0)


@settings(deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), st.integers(0, ZOOM))
def test_a_twist_is_how_the_pose_moves(values: list[float], variable: int) -> None:
    arm = transform(rotation_exp(np.array([0.1, -0.05, 0.2])), np.array([0.1, 0.05, -0.02]))
    mounted = transform(rotation_exp(np.array([0.2, 0.1, 0.0])) @ LEVEL[:3, :3], np.array([0.05, 0.02, 0.04]))
    base = transform(rotation_exp(np.array([0.1, 0.1, 0.5])), np.zeros(3))
    row = problem(SceneCamera("h", LAB, HeadPlace(PanTilt(base, arm), mounted, (-3.0, 3.0), (-1.6, 1.6)))).cameras[0]
    u, step = np.array(values), 1e-6 * np.eye(6)[variable]
    twist = np.empty(6)
    twist_of(row, u, variable, twist)
    (R_a, at_a), (R_b, at_b) = pose_of(row, u - step), pose_of(row, u + step)
    turn = (R_b - R_a) / 2e-6 @ pose_of(row, u)[0].T
    np.testing.assert_allclose(twist[:3], (at_b - at_a) / 2e-6, atol=1e-8)
    np.testing.assert_allclose(twist[3:], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-8)
