"""What a drone that navigates by its camera is told: poses by anchors alone, never by its own telemetry."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.rotation import rotation_from_rpy
from camrig.locate import Histories, body_pose, locate, navigates_by
from camrig.messages import BodyPose, DroneReading, FlightState
from camrig.rig import Anchor, DroneSpec, Rig
from tests.anchored_cameras import DRONE_CAMERA, RIG, T_UNDER, anchor, rig_with, seen

HOVER_M = (1.8, 2.1, 1.7)


def by_vision(anchors: tuple[Anchor, ...]) -> Rig:
    rig = rig_with(anchors)
    drone: DroneSpec = replace(rig.drones["d"], needs_anchor=True)
    return replace(rig, drones={"d": drone})


ONE, TWO = by_vision((anchor(100, 1.9, 2.2),)), by_vision((anchor(100, 1.9, 2.2), anchor(102, 2.2, 1.7)))


def hover(rng: np.random.Generator, tilt_rad: float = 0.03) -> Transform:
    roll, pitch = rng.normal(0.0, tilt_rad, 2)
    return pose.transform(rotation_from_rpy(roll, pitch, rng.uniform(-3.0, 3.0)), np.array(HOVER_M))


def found(rig: Rig, T_world_body: Transform, rng: np.random.Generator | None = None) -> BodyPose:
    told = body_pose(seen(rig.anchors, T_world_body @ T_UNDER, DRONE_CAMERA, rng), rig)
    assert told is not None
    return told


def test_it_is_where_the_anchors_put_it() -> None:
    T = hover(np.random.default_rng(1))
    told = found(TWO, T)
    assert (told.drone_id, told.stamp_s) == ("d", 1.0)
    assert np.abs(pose.difference(T, told.T_world_body)).max() < 1e-3


@pytest.mark.parametrize("rig", [ONE, TWO], ids=["one", "two"])
@pytest.mark.parametrize(("tilt_rad", "missed"), [(0.03, 0.02), (0.08, 0.15)])
def test_covariance_is_never_too_bold(rig: Rig, tilt_rad: float, missed: float) -> None:
    """Tilts of a calm hover, and as large as is believed; the corners' noise is that of the law (mean NEES of 6)."""
    rng, values = np.random.default_rng(2), []
    for _ in range(150):
        T = hover(rng, tilt_rad)
        told = body_pose(seen(rig.anchors, T @ T_UNDER, DRONE_CAMERA, rng), rig)
        if told is not None:
            error = pose.difference(T, told.T_world_body)
            values.append(float(error @ np.linalg.solve(told.covariance, error)))
    assert len(values) >= (1.0 - missed) * 150
    assert 1.0 < np.mean(values) < 6.0


def test_one_anchor_seen_from_above_does_not_leave_two_poses_open() -> None:
    """Without the knowledge that a hovering drone is nearly level, some of these frames would say nothing."""
    rng = np.random.default_rng(3)
    hovers = [hover(rng) for _ in range(200)]
    told = [(T, body_pose(seen(ONE.anchors, T @ T_UNDER, DRONE_CAMERA, rng), ONE)) for T in hovers]
    errors_m = [np.linalg.norm((found.T_world_body - T)[:3, 3]) for T, found in told if found is not None]
    assert len(errors_m) >= 196
    assert max(errors_m) < 0.15  # the other solution is further off


def test_without_anchors_it_is_unknown() -> None:
    assert body_pose(seen((), np.eye(4), DRONE_CAMERA), ONE) is None


def test_only_a_drone_that_needs_anchors_navigates_by_them() -> None:
    assert navigates_by("above", RIG) is None
    assert navigates_by("above", ONE) == "d"
    assert navigates_by("north", ONE) is None


def test_telemetry_made_of_anchors_is_not_counted_beside_them() -> None:
    """However sure the telemetry is, it changes nothing where anchors are in view, and stands alone where none is."""
    T = hover(np.random.default_rng(4))
    off = pose.perturb(T, np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]))
    histories = Histories()
    for stamp_s in (0.9, 1.1):
        reading = DroneReading("d", stamp_s, off, 1e-8 * np.eye(6), FlightState.FLYING)
        histories = histories.with_reading(reading)
    detections = seen(TWO.anchors, T @ T_UNDER, DRONE_CAMERA)
    fused = locate(detections, histories, TWO, {}).camera_pose
    unfused = locate(detections, Histories(), TWO, {}).camera_pose
    assert fused is not None
    assert unfused is not None
    assert np.array_equal(fused.T_world_camera, unfused.T_world_camera)
    alone = locate(seen((), T @ T_UNDER, DRONE_CAMERA), histories, TWO, {}).camera_pose
    assert alone is not None
    assert alone.T_world_camera[:3, 3] == pytest.approx((off @ T_UNDER)[:3, 3])


def test_a_pose_is_there_in_milliseconds() -> None:
    """Beside the detection; the median, for the machine is shared."""
    rng = np.random.default_rng(5)
    pictures = [seen(TWO.anchors, hover(rng) @ T_UNDER, DRONE_CAMERA, rng) for _ in range(30)]
    times_s: list[float] = []
    for picture in pictures:
        began_s = time.perf_counter()
        body_pose(picture, TWO)
        times_s.append(time.perf_counter() - began_s)
    assert float(np.median(np.asarray(times_s, dtype=float))) < 0.010


def sigma_m(told: BodyPose) -> Array:
    return np.asarray(np.sqrt(told.covariance.diagonal()[:3]))


def test_more_anchors_are_surer() -> None:
    T = hover(np.random.default_rng(6))
    assert (sigma_m(found(TWO, T)) < sigma_m(found(ONE, T))).all()
