"""Robots keep to the floor, their speed and their distance, at any time, from the seed alone."""

from __future__ import annotations

import pickle
from collections.abc import Mapping

import numpy as np
import pytest

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.rig import Body, Space
from camrig_emulators.robots import Motion, RobotLimits, plan_motions, poses

LIMITS = RobotLimits(margin_m=0.35, speed_m_s=(0.1, 0.4))
SPACE = Space(floor_m=((-1.0, 0.5), (5.0, 4.5)))
STEP_S = 0.02


def targets(count: int, motion: str = "floor") -> dict[str, Body]:
    return {f"robot{k}": Body(f"robot{k}", (), motion) for k in range(count)}


def states(motions: Mapping[str, Motion], times: Array) -> tuple[Array, Array]:
    found = [motion.states(times) for motion in motions.values()]
    return np.array([position for position, _ in found]), np.array([heading for _, heading in found])


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_five_robots_drive_gently_and_apart(seed: int) -> None:
    times = np.arange(-50.0, 150.0, STEP_S)
    position, heading = states(plan_motions(targets(5), SPACE, LIMITS, seed), times)

    assert np.all(position[..., :2] >= np.array(SPACE.floor_m[0]) + LIMITS.margin_m - 1e-3)
    assert np.all(position[..., :2] <= np.array(SPACE.floor_m[1]) - LIMITS.margin_m + 1e-3)
    assert np.all(position[..., 2] == 0.0)

    velocity = np.diff(position[..., :2], axis=1) / STEP_S
    speed = np.linalg.norm(velocity, axis=-1)
    assert speed.min() >= 0.095
    assert speed.max() <= 0.405

    turn_rad = np.angle(np.exp(1j * np.diff(heading, axis=1)))
    assert np.abs(turn_rad).max() / STEP_S < 1.5

    course = np.arctan2(velocity[..., 1], velocity[..., 0])
    middle = heading[:, :-1] + turn_rad / 2.0
    assert np.abs(np.angle(np.exp(1j * (course - middle)))).max() < 0.02

    apart = [np.linalg.norm(position[i] - position[j], axis=1).min() for i in range(5) for j in range(i)]
    assert min(apart) >= 0.3


def test_same_seed_same_poses_in_any_order_and_another_seed_others() -> None:
    first, again = (plan_motions(targets(3), SPACE, LIMITS, 7) for _ in range(2))
    other = plan_motions(targets(3), SPACE, LIMITS, 8)
    forwards = [poses(first, time_s) for time_s in (0.0, 12.5, -3.0)]
    backwards = [poses(again, time_s) for time_s in (-3.0, 12.5, 0.0)][::-1]
    copied = [poses(pickle.loads(pickle.dumps(first)), time_s) for time_s in (0.0, 12.5, -3.0)]
    for a, b, c in zip(forwards, backwards, copied, strict=True):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
            np.testing.assert_array_equal(a[name], c[name])
    assert not np.allclose(poses(other, 0.0)["robot0"], forwards[0]["robot0"])


def test_a_robot_more_leaves_the_others_as_they_were() -> None:
    few, more = (plan_motions(targets(count), SPACE, LIMITS, 3) for count in (3, 4))
    for name, pose in poses(few, 42.0).items():
        np.testing.assert_array_equal(pose, poses(more, 42.0)[name])


def test_poses_are_rigid_and_upright() -> None:
    for T in poses(plan_motions(targets(3), SPACE, LIMITS, 2), 5.0).values():
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_array_equal(T[:3, 2], [0.0, 0.0, 1.0])


def test_static_targets_stand_still_out_of_the_way_of_the_others() -> None:
    mixed = {**targets(3), "post": Body("post", (), "static")}
    motions = plan_motions(mixed, SPACE, LIMITS, 1)
    assert list(motions) == list(mixed)
    position, heading = states(motions, np.arange(0.0, 60.0, 0.05))
    assert np.ptp(position[3], axis=0).max() == 0.0
    assert np.ptp(heading[3]) == 0.0
    assert min(np.linalg.norm(position[k] - position[3], axis=1).min() for k in range(3)) >= 0.3


def test_free_targets_rise_and_sink() -> None:
    position, _ = states(plan_motions(targets(1, "free"), SPACE, LIMITS, 1), np.arange(0.0, 60.0, 0.1))
    assert position[0, :, 2].min() >= 0.4
    assert position[0, :, 2].max() <= 1.2
    assert np.ptp(position[0, :, 2]) > 0.5


def test_robots_keep_out_of_boxes_that_stand_on_the_floor() -> None:
    box = ((1.5, 2.0, 0.0), (2.3, 2.8, 1.0))
    space = Space(SPACE.floor_m, (box, ((-1.0, 0.5, 2.0), (5.0, 4.5, 2.5))))
    position, _ = states(plan_motions(targets(3), space, LIMITS, 1), np.arange(0.0, 90.0, 0.05))
    inside = np.all((position[..., :2] > np.array(box[0][:2])) & (position[..., :2] < np.array(box[1][:2])), axis=-1)
    assert not inside.any()


def test_a_floor_without_room_is_refused_in_one_sentence() -> None:
    with pytest.raises(InputError, match=r"floor of 0\.5 x 0\.5 m leaves robots no room"):
        plan_motions(targets(1), Space(((0.0, 0.0), (0.5, 0.5))), LIMITS, 1)
    with pytest.raises(InputError, match="no room on the floor for robot"):
        plan_motions(targets(40, "static"), Space(((0.0, 0.0), (1.5, 1.5))), LIMITS, 1)
