"""Where tags are expected: around every place a tag may be, for cameras that rest, while nothing is missing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.detect import merged
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import (
    AxisReading,
    CameraPose,
    Expected,
    FlightState,
    HeadAim,
    Region,
    Target,
    TargetStatus,
)
from camrig.pipeline import State, begin
from camrig.pipeline.expect import BEFORE_S, POSE_AGE_S, VALID_S, expected
from camrig.rig import (
    Anchor,
    Body,
    BodyTag,
    CameraSpec,
    DroneMount,
    DroneSpec,
    FixedMount,
    FreeMount,
    HeadMount,
    HeadSpec,
    Mount,
    Rig,
    Space,
    TagKey,
)
from camrig.steer import SteerState
from tests.simulated_room import LENS, RIM, SIZE_M, tag_in_picture

NOW_S = 50.0
SEEN_S = 49.8
AIM = HeadAim(0.0, math.radians(-50.0))
T_BASE = transform(np.eye(3), np.array([0.0, 2.0, 2.8]))
T_CAMERA = T_BASE @ transform(aim_rotation(AIM.pan_rad, AIM.tilt_rad) @ R_MOUNT_OPTICAL, np.zeros(3))
T_ROOF = transform(np.eye(3), np.array([0.0, 0.0, 0.25]))
HEAD = HeadSpec("h", PanTilt(T_BASE), (-2.0, 2.0), (-1.6, 0.0), 0.7)
DRONE = DroneSpec("d", ((0.0, 0.0, 1.0), (6.0, 4.0, 3.0)), 0.5, 0.6)


def rig(mount: Mount, motion: str = "floor", anchors: tuple[Anchor, ...] = ()) -> Rig:
    body = Body("robot", (BodyTag(TagKey("tag36h11", 1), SIZE_M, T_ROOF),), motion)
    cameras = {"c": CameraSpec("c", LENS, mount)}
    return Rig("r", Space(), cameras, {"h": HEAD}, {"d": DRONE}, {"robot": body}, anchors)


FIXED = rig(FixedMount(T_CAMERA))
ON_HEAD = rig(HeadMount("h", transform(R_MOUNT_OPTICAL, np.zeros(3))))


def known(*, seen_s: float = SEEN_S, told: HeadAim | None = AIM) -> State:
    """Return a state with the camera's pose at ``seen_s``, and a head told as given and read at AIM all the time."""
    pose = CameraPose("c", seen_s, T_CAMERA, np.diag([1e-6] * 3 + [2.5e-7] * 3))
    histories = begin(0.0).histories
    for stamp_s in (NOW_S - 0.5, NOW_S - 0.1):
        histories = histories.with_reading(AxisReading("h", "pan", AIM.pan_rad, stamp_s, 1e-4, 0.0))
        histories = histories.with_reading(AxisReading("h", "tilt", AIM.tilt_rad, stamp_s, 1e-4, 0.0))
    steered = SteerState(head_aims={"h": (told, NOW_S - 5.0)} if told else {})
    return replace(begin(0.0), camera_poses={"c": pose}, histories=histories, steer=steered)


def robot(
    position_m: tuple[float, float] = (2.3, 2.0),
    velocity_m_s: tuple[float, float] = (0.0, 0.0),
    heading_rad: float = 0.0,
    status: TargetStatus = TargetStatus.TRACKED,
) -> Target:
    place, speed = np.array([*position_m, 0.0]), np.array([*velocity_m_s, 0.0])
    covariance = np.eye(3) * 0.005**2
    return Target("robot", NOW_S, status, place, speed, covariance, rotation_z(heading_rad), ("c",), NOW_S)


def only(found: tuple[Expected, ...]) -> Expected:
    assert [each.camera_id for each in found] == ["c"]
    return found[0]


def regions(found: Expected, stamp_s: float = NOW_S) -> tuple[Region, ...]:
    """Return what of the picture is searched at a stamp."""
    return merged([window.region for window in found.windows_at(stamp_s)], LENS.size_px)


def shown(corners_px: Array, regions: tuple[Region, ...]) -> bool:
    """Tell whether a region holds a tag and as much of its rim as the picture does."""
    centre = corners_px.mean(axis=0)
    rim = np.clip(centre + RIM * (corners_px - centre), 0, np.array(LENS.size_px) - 1)
    return any((rim >= [left, top]).all() and (rim < [right, bottom]).all() for left, top, right, bottom in regions)


def tag_at(target: Target, stamp_s: float, turned_rad: float) -> Transform:
    R = target.R_world_body @ rotation_z(turned_rad)
    return transform(R, target.position_m + (stamp_s - target.stamp_s) * target.velocity_m_s) @ T_ROOF


@given(
    position_m=st.tuples(st.floats(0.8, 5.0), st.floats(0.5, 3.5)),
    velocity_m_s=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    heading_rad=st.floats(-math.pi, math.pi),
    turned_rad=st.floats(-0.5, 0.5),
    share=st.floats(0.0, 1.0),
)
def test_a_tag_that_goes_on_as_it_did_is_in_a_region_all_the_time_the_regions_hold(
    position_m: tuple[float, float],
    velocity_m_s: tuple[float, float],
    heading_rad: float,
    turned_rad: float,
    share: float,
) -> None:
    target = robot(position_m, velocity_m_s, heading_rad)
    found = only(expected(known(), (target,), FIXED, NOW_S))
    stamp_s = found.from_s + share * (found.until_s - found.from_s)
    assert found.holds_at(stamp_s)
    corners = tag_in_picture(LENS, T_CAMERA, tag_at(target, stamp_s, turned_rad), SIZE_M)
    assert corners is None or shown(corners, regions(found, stamp_s))


def test_a_tag_may_be_a_little_off_its_course() -> None:
    found = only(expected(known(), (robot(),), FIXED, NOW_S))
    for angle in np.linspace(0.0, 2.0 * math.pi, 9):
        beside = robot((2.3 + 0.04 * math.cos(angle), 2.0 + 0.04 * math.sin(angle)))
        corners = tag_in_picture(LENS, T_CAMERA, tag_at(beside, NOW_S, angle), SIZE_M)
        assert corners is not None
        assert shown(corners, regions(found))


def test_a_robot_takes_a_small_share_of_the_picture_and_none_where_it_cannot_be_seen() -> None:
    (region,) = regions(only(expected(known(), (robot(velocity_m_s=(0.3, 0.0)),), FIXED, NOW_S)))
    area = (region[2] - region[0]) * (region[3] - region[1])
    assert area < 0.06 * 1280 * 720
    for away in ((2.3, 20.0), (-3.0, 2.0)):
        assert regions(only(expected(known(), (robot(away),), FIXED, NOW_S))) == ()


def test_anchors_are_looked_for_too() -> None:
    anchor = Anchor(TagKey("tag36h11", 100), SIZE_M, transform(rotation_z(0.4), np.array([2.8, 2.4, 0.0])))
    room = rig(FixedMount(T_CAMERA), anchors=(anchor,))
    found = only(expected(known(), (robot(),), room, NOW_S))
    corners = tag_in_picture(LENS, T_CAMERA, anchor.T_world_tag, SIZE_M)
    assert corners is not None
    assert shown(corners, regions(found))


def test_what_stands_still_is_expected_in_a_smaller_place() -> None:
    def width(motion: str) -> int:
        room = rig(FixedMount(T_CAMERA), motion)
        (region,) = regions(only(expected(known(), (robot(),), room, NOW_S)))
        return region[2] - region[0]

    assert width("static") < width("floor")


@pytest.mark.parametrize("status", [TargetStatus.LOST, TargetStatus.UNSEEN])
def test_while_a_target_is_missing_whole_pictures_are_searched(status: TargetStatus) -> None:
    assert expected(known(), (robot(status=status),), FIXED, NOW_S) == ()


def test_regions_hold_from_a_moment_ago_but_not_from_before_the_pose_they_are_made_with() -> None:
    old = only(expected(known(seen_s=NOW_S - 0.4), (robot(),), FIXED, NOW_S))
    assert (old.from_s, old.until_s) == (NOW_S - BEFORE_S, NOW_S + VALID_S)
    new = only(expected(known(seen_s=NOW_S - 0.05), (robot(),), FIXED, NOW_S))
    assert new.from_s == NOW_S - 0.05


def test_a_camera_whose_pose_is_old_looks_at_its_whole_pictures() -> None:
    assert expected(known(seen_s=NOW_S - POSE_AGE_S - 0.1), (robot(),), FIXED, NOW_S) == ()
    assert expected(begin(0.0), (robot(),), FIXED, NOW_S) == ()


@pytest.mark.parametrize("told", [AIM, None])
def test_a_head_at_rest_where_it_was_told_to_be_gives_regions(told: HeadAim | None) -> None:
    assert regions(only(expected(known(told=told), (robot(),), ON_HEAD, NOW_S)))


POLL_S = 0.05
SPEED_RAD_S = 0.7


def turning(
    told: HeadAim | None, begun_s: float, *, until_s: float = NOW_S
) -> tuple[State, Callable[[float], HeadAim]]:
    """Return a state whose head was read every ``POLL_S`` as it turned from AIM towards ``told``, from ``begun_s`` on,
    and where it truly is at any stamp. The camera's last pose is of ``SEEN_S``.
    """
    goal = np.array([told.pan_rad, told.tilt_rad]) if told else np.array([AIM.pan_rad + 1.0, AIM.tilt_rad])
    start = np.array([AIM.pan_rad, AIM.tilt_rad])

    def at(stamp_s: float) -> HeadAim:
        reach = SPEED_RAD_S * max(0.0, stamp_s - begun_s)
        pan, tilt = start + np.clip(goal - start, -reach, reach)
        return HeadAim(float(pan), float(tilt))

    histories = begin(0.0).histories
    for stamp_s in np.arange(until_s - 1.0, until_s + 1e-9, POLL_S):
        aim = at(stamp_s)
        histories = histories.with_reading(AxisReading("h", "pan", aim.pan_rad, stamp_s, 1e-4, 0.0))
        histories = histories.with_reading(AxisReading("h", "tilt", aim.tilt_rad, stamp_s, 1e-4, 0.0))
    pose = CameraPose("c", SEEN_S, camera_at(at(SEEN_S)), np.diag([1e-6] * 3 + [2.5e-7] * 3))
    steered = SteerState(head_aims={"h": (told, begun_s)} if told else {})
    return replace(begin(0.0), camera_poses={"c": pose}, histories=histories, steer=steered), at


def camera_at(aim: HeadAim) -> Transform:
    return T_BASE @ transform(aim_rotation(aim.pan_rad, aim.tilt_rad) @ R_MOUNT_OPTICAL, np.zeros(3))


@given(
    pan_deg=st.floats(-60.0, 60.0),
    tilt_deg=st.floats(-25.0, 25.0),
    begun_s=st.floats(NOW_S - 0.8, NOW_S + 0.3),
    share=st.floats(0.0, 1.0),
    position_m=st.tuples(st.floats(0.8, 5.0), st.floats(0.5, 3.5)),
)
def test_a_head_on_its_way_to_where_it_was_told_to_be_finds_its_tags_in_their_regions(
    pan_deg: float, tilt_deg: float, begun_s: float, share: float, position_m: tuple[float, float]
) -> None:
    told = HeadAim(AIM.pan_rad + math.radians(pan_deg), AIM.tilt_rad + math.radians(tilt_deg))
    state, at = turning(told, begun_s)
    found = only(expected(state, (robot(position_m),), ON_HEAD, NOW_S))
    stamp_s = found.from_s + share * (found.until_s - found.from_s)
    corners = tag_in_picture(LENS, camera_at(at(stamp_s)), tag_at(robot(position_m), stamp_s, 0.3), SIZE_M)
    assert corners is None or shown(corners, regions(found, stamp_s))


def test_regions_of_a_head_that_turns_are_larger_the_further_ahead_they_are() -> None:
    state, _ = turning(HeadAim(AIM.pan_rad + 1.0, AIM.tilt_rad), NOW_S - 0.3)
    found = only(expected(state, (robot(),), ON_HEAD, NOW_S))
    (soon,), (late,) = regions(found, NOW_S), regions(found, NOW_S + 0.2)
    assert soon[2] - soon[0] < late[2] - late[0]
    assert (soon[2] - soon[0]) * (soon[3] - soon[1]) < 0.05 * 1280 * 720


def test_a_head_that_turns_unasked_gives_none() -> None:
    state, _ = turning(None, NOW_S - 0.3)
    assert expected(state, (robot(),), ON_HEAD, NOW_S) == ()


def test_a_head_that_has_not_said_where_it_is_for_long_gives_none() -> None:
    assert expected(turning(AIM, NOW_S, until_s=NOW_S - 0.6)[0], (robot(),), ON_HEAD, NOW_S) == ()
    nothing_read = replace(known(), histories=begin(0.0).histories)
    assert expected(nothing_read, (robot(),), ON_HEAD, NOW_S) == ()


def test_the_shortest_side_of_a_tag_is_told_and_never_too_long() -> None:
    found = only(expected(known(), (robot(),), FIXED, NOW_S))
    (window,) = found.windows_at(NOW_S)
    assert window.key == TagKey("tag36h11", 1)
    for turned_rad in np.linspace(0.0, math.pi / 2.0, 7):
        corners = tag_in_picture(LENS, T_CAMERA, tag_at(robot(), NOW_S, turned_rad), SIZE_M)
        assert corners is not None
        side_px = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min()
        assert 0.7 * side_px < window.side_px < 1.03 * side_px


@pytest.mark.parametrize("mount", [DroneMount("d", transform(R_BODY_OPTICAL_DOWN, np.zeros(3))), FreeMount()])
def test_a_camera_that_never_rests_gives_none(mount: Mount) -> None:
    state = replace(known(), flight={"d": FlightState.FLYING})
    assert expected(state, (robot(),), rig(mount), NOW_S) == ()
