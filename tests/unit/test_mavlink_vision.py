"""Poses that go back to the autopilot: golden numbers for axes, yaw, covariance order, stamps and the reset counter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.geometry.arrays import Array
from camrig.geometry.pose import perturb, transform
from camrig.geometry.rotation import rotation_from_rpy
from camrig.messages import BodyPose
from camrig_drivers.mavlink.codec import Encoder
from camrig_drivers.mavlink.frames import LocalFrame, R_world_body, rpy_ned_frd
from camrig_drivers.mavlink.packets import ExternalPose, Odometry, VisionEstimate
from camrig_drivers.mavlink.vision import VisionPoses

ORIGIN_M = (0.5, 0.2, 0.1)
UPPER = [(i, j) for i in range(6) for j in range(i, 6)]
ANGLE = st.floats(-3.1, 3.1)


def pose(
    stamp_s: float = 12.345678, place_m: tuple[float, float, float] = (1.5, 2.2, 1.6), yaw_rad: float = 0.0
) -> BodyPose:
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 4e-6, 9e-6])
    return BodyPose("d1", stamp_s, transform(rotation_from_rpy(0.0, 0.0, yaw_rad), np.array(place_m)), covariance)


def sent(found: ExternalPose | None = None) -> ExternalPose:
    taken = VisionPoses(LocalFrame(ORIGIN_M)).take(pose()) if found is None else found
    assert taken is not None
    return taken


def wire(said: VisionEstimate | Odometry) -> Any:
    return dialect.MAVLink(None).decode(bytearray(Encoder().encode(said, (1, 1))))


def test_east_north_up_becomes_north_east_down() -> None:
    """1 m east, 2 m north, 1.5 m up of the origin; nose east is a yaw of 90 degrees from north."""
    found = sent()
    assert found.position_ned_m == pytest.approx((2.0, 1.0, -1.5))
    assert found.rpy_rad == pytest.approx((0.0, 0.0, math.pi / 2.0))


@pytest.mark.parametrize(
    ("yaw_enu_deg", "yaw_ned_deg"), [(0.0, 90.0), (90.0, 0.0), (-90.0, 180.0), (135.0, -45.0), (30.0, 60.0)]
)
def test_yaw_counts_from_north_clockwise(yaw_enu_deg: float, yaw_ned_deg: float) -> None:
    found = VisionPoses(LocalFrame(ORIGIN_M)).take(pose(yaw_rad=math.radians(yaw_enu_deg)))
    assert math.cos(sent(found).rpy_rad[2] - math.radians(yaw_ned_deg)) == pytest.approx(1.0)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), ANGLE)
def test_attitude_that_telemetry_gave_goes_back_as_it_came(roll: float, pitch: float, yaw: float) -> None:
    assert rpy_ned_frd(R_world_body(roll, pitch, yaw)) == pytest.approx((roll, pitch, yaw), abs=1e-6)


def test_covariance_is_the_upper_triangle_of_north_east_down_roll_pitch_yaw() -> None:
    """Nose east: the roll axis is the world's x, the pitch axis points south."""
    found = dict(zip(UPPER, sent().covariance, strict=True))
    diagonal = [found[i, i] for i in range(6)]
    assert diagonal == pytest.approx([4e-4, 1e-4, 9e-4, 1e-6, 4e-6, 9e-6])
    assert [value for (i, j), value in found.items() if i != j] == pytest.approx([0.0] * 15, abs=1e-12)


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), ANGLE, st.integers(0, 5))
def test_covariance_is_that_of_what_is_sent(roll: float, pitch: float, yaw: float, axis: int) -> None:
    """A small error of the pose about one world axis changes what is sent as the covariance says."""
    T = transform(R_world_body(roll, pitch, yaw), np.array([1.0, 2.0, 1.5]))
    error = np.zeros(6)
    error[axis] = 1e-5
    covariance = np.outer(error, error)
    first = sent(VisionPoses(LocalFrame(ORIGIN_M)).take(BodyPose("d1", 1.0, T, covariance)))
    other = sent(VisionPoses(LocalFrame(ORIGIN_M)).take(BodyPose("d1", 1.0, perturb(T, error), covariance)))
    change: Array = np.array([*other.position_ned_m, *other.rpy_rad]) - [*first.position_ned_m, *first.rpy_rad]
    change[3:] = (change[3:] + math.pi) % math.tau - math.pi
    told = np.array([first.covariance[UPPER.index((i, i))] for i in range(6)])
    assert np.sqrt(told) == pytest.approx(np.abs(change), abs=2e-6)  # a tilt of 0.1 rad costs a tenth


def test_stamp_is_our_monotonic_clock_in_microseconds() -> None:
    """TIMESYNC is answered with the same clock, so that the autopilot can map it to its own."""
    assert sent().stamp_us == 12_345_678


def test_ardupilot_gets_vision_position_estimate() -> None:
    message = wire(VisionEstimate(sent()))
    assert message.get_type() == "VISION_POSITION_ESTIMATE"
    assert (message.usec, message.reset_counter) == (12_345_678, 0)
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -1.5))
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.0, 0.0, math.pi / 2.0))
    assert message.covariance == pytest.approx(sent().covariance)


def test_px4_gets_odometry_in_ned_and_frd() -> None:
    message = wire(Odometry(sent()))
    assert message.get_type() == "ODOMETRY"
    assert (message.frame_id, message.child_frame_id) == (1, 12)
    assert message.q == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])  # body to NED
    assert message.pose_covariance == pytest.approx(sent().covariance)
    assert all(map(math.isnan, (message.vx, message.vy, message.vz, message.rollspeed, message.velocity_covariance[0])))
    assert (message.time_usec, message.reset_counter) == (12_345_678, 0)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_quaternion_turns_the_body_as_its_angles_do(roll: float, pitch: float, yaw: float) -> None:
    message = wire(Odometry(ExternalPose(1, (0.0, 0.0, 0.0), (roll, pitch, yaw), (0.0,) * 21, 0)))
    w, x, y, z = message.q
    forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)]
    assert forward == pytest.approx(rotation_from_rpy(roll, pitch, yaw)[:, 0], abs=1e-6)


def test_reset_counter_counts_jumps_and_nothing_else() -> None:
    poses = VisionPoses(LocalFrame(ORIGIN_M))
    flights = [
        pose(1.0),
        pose(1.033, (1.52, 2.2, 1.6)),
        pose(1.066, (2.6, 2.2, 1.6)),  # another anchor: a metre off
        pose(1.1, (2.6, 2.2, 1.6)),
        pose(1.133, (2.6, 2.2, 1.6), math.pi),  # an ambiguity resolved
        pose(3.0, (4.0, 2.2, 1.6), math.pi),  # two seconds unseen: it may have flown there
    ]
    counts = [sent(poses.take(flight)).reset_counter for flight in flights]
    assert counts == [0, 0, 1, 1, 2, 2]


def test_what_is_older_or_follows_too_soon_is_left_out() -> None:
    poses = VisionPoses(LocalFrame(ORIGIN_M))
    assert poses.take(pose(1.0)) is not None
    assert poses.take(pose(1.005)) is None
    assert poses.take(pose(0.9)) is None
    assert poses.take(pose(1.033)) is not None
