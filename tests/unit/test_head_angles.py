"""What a head's camera tells of its angles by the anchors it sees, and what a head that reports nothing makes of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.locate import HeadHistory, Histories, locate
from camrig.locate.camera_pose import MOUNT_COVARIANCE
from camrig.messages import AxisReading
from tests.anchored_cameras import (
    HEAD_CAMERA,
    KINEMATICS,
    ON_FLOOR,
    PAN,
    RIG,
    T_MOUNT,
    TILT,
    TRUE_ON_HEAD,
    anchor,
    read,
    rig_with,
    seen,
    within_chance,
)
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads


def angles(readings: tuple[AxisReading, ...]) -> Array:
    assert [reading.axis for reading in readings] == ["pan", "tilt"]
    return np.array([reading.angle_rad for reading in readings])


def test_a_head_that_tells_nothing_is_measured_by_anchors_alone() -> None:
    found = locate(seen(ON_FLOOR[:2], TRUE_ON_HEAD, HEAD_CAMERA), Histories(), RIG, {}).head_angles
    assert angles(found) == pytest.approx([PAN, TILT], abs=1e-4)
    assert {(reading.head_id, reading.stamp_s) for reading in found} == {("h", 1.0)}
    assert all(0.0 < reading.sigma_rad < math.radians(0.1) for reading in found)


@pytest.mark.parametrize("known", [False, True])
def test_its_sigmas_are_what_sampling_shows(known: bool) -> None:
    """Noise in the corners, a mount that is not quite where the rig says, and readings that are off or none."""
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(MOUNT_COVARIANCE)
    values = []
    for _ in range(300):
        pan_rad, tilt_rad = (float(angle) for angle in np.array([PAN, TILT]) + rng.normal(size=2) * 0.02)
        T = pose.perturb(KINEMATICS.T_world_camera(pan_rad, tilt_rad, T_MOUNT), root @ rng.normal(size=6))
        told_pan_rad, told_tilt_rad = (float(angle + 0.02 * rng.normal()) for angle in (pan_rad, tilt_rad))
        told = read(told_pan_rad, told_tilt_rad, 0.02) if known else Histories()
        found = locate(seen(ON_FLOOR[:2], T, HEAD_CAMERA, rng), told, RIG, {}).head_angles
        error = angles(found) - np.array([pan_rad, tilt_rad])
        values += [float((error[k] / found[k].sigma_rad) ** 2) for k in range(2)]
    assert within_chance(values, 1)


def test_what_the_readings_said_is_not_in_it() -> None:
    """Whatever a vague head believes of itself, the anchors say the same: its driver fuses both, and once."""
    picture = seen(ON_FLOOR, TRUE_ON_HEAD, HEAD_CAMERA, np.random.default_rng(5))
    low, high = (
        locate(picture, read(PAN + off, TILT - off, 0.05), RIG, {}).head_angles for off in (-0.03, 0.03)
    )  # fmt: skip
    assert angles(low) == pytest.approx(angles(high), abs=2e-5)
    assert low[0].sigma_rad == pytest.approx(high[0].sigma_rad, rel=0.05)


def test_of_a_head_that_knows_better_nothing_is_said() -> None:
    sure = locate(seen(ON_FLOOR[:1], TRUE_ON_HEAD, HEAD_CAMERA), read(PAN, TILT, 1e-5), rig_with(ON_FLOOR, 1e-5), {})
    assert sure.camera_pose is not None
    assert sure.head_angles == ()
    assert locate(seen((), TRUE_ON_HEAD, HEAD_CAMERA), read(PAN, TILT), RIG, {}).head_angles == ()


@pytest.mark.parametrize("pan_rad", [-2.5, 0.3, 3.0])
def test_looking_straight_down_the_pan_is_told_by_the_pictures_turn(pan_rad: float) -> None:
    down = KINEMATICS.T_world_camera(pan_rad, -math.pi / 2.0, T_MOUNT)
    below = (anchor(100, 1.0, 1.1), anchor(101, 1.3, 0.8))
    found = locate(seen(below, down, HEAD_CAMERA), Histories(), rig_with(below), {}).head_angles
    assert angles(found) == pytest.approx([pan_rad, -math.pi / 2.0], abs=1e-4)


def by_anchors(**settings: Any) -> SimulatedHeads:
    axis = {"speeds": {1: SPEED_DEG_S / 63.0, 63: SPEED_DEG_S}}
    model = {"start_s": 0.05, "start_sigma_s": 0.005, "stop_sigma_s": 0.005, "speed_sigma": 0.05}
    keys = {"grade": "open_loop", "axes": {"pan": axis, "tilt": axis}}
    keys["open_loop"] = {"zero": {"by": "anchors"}, **model}
    return SimulatedHeads(baud=9600, keys=keys, speed_drift=0.05, answers="none", **settings)


def test_a_head_zeroed_by_anchors_stands_until_it_sees_one_and_stays_known_while_it_does() -> None:
    """The whole loop: reckoned angles, the camera's picture at the true ones, and back to the driver."""
    rig = by_anchors(seed=4, start_pan_deg=math.degrees(PAN), start_tilt_deg=math.degrees(TILT))
    rig.head.open()
    rig.head.enable()
    rig.move(50.0, -60.0)
    assert rig.poll(5.0) == []
    assert rig.motions() == [], "it does not know where it is, so it stands"
    rng, history, errors, sigmas = np.random.default_rng(6), HeadHistory(), [], []
    for _ in range(12):
        rig.move(math.degrees(PAN) + rng.uniform(-8.0, 8.0), math.degrees(TILT) + rng.uniform(-8.0, 8.0))
        for _ in range(20):
            history = pictured(rig, history, rng)
        true_rad = rig.line.true_angles_rad("pt1", rig.time.now_s() - 0.3)
        state = history.at(rig.time.now_s() - 0.3)
        assert state is not None
        errors.append(state.angles_rad - true_rad)
        sigmas.append(np.sqrt(np.diag(state.covariance)))
    ratio = np.abs(errors) / np.array(sigmas)
    assert (ratio < 3.5).all()
    assert math.degrees(np.max(sigmas)) < 0.3, "the reckoning alone is 5 % of every way off"
    rig.head.close()


def pictured(rig: SimulatedHeads, history: HeadHistory, rng: np.random.Generator) -> HeadHistory:
    """Go on for a moment, then take a picture of a moment ago, locate its anchors and tell the head."""
    for reading in rig.poll(0.15):
        history = history.with_reading(reading)
    stamp_s = rig.time.now_s() - 0.07
    pan_rad, tilt_rad = rig.line.true_angles_rad("pt1", stamp_s)
    picture = seen(ON_FLOOR, KINEMATICS.T_world_camera(pan_rad, tilt_rad, T_MOUNT), HEAD_CAMERA, rng, stamp_s)
    for told in locate(picture, Histories({"h": history}), RIG, {}).head_angles:
        rig.head.correct(AxisReading("pt1", told.axis, told.angle_rad, told.stamp_s, told.sigma_rad, 0.0))
    return history
