"""Where tags are expected: around every place a tag may be, for cameras that rest, while nothing is missing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.messages import (
    AxisReading,
    CameraPose,
    DroneAim,
    Expected,
    FlightState,
    HeadAim,
    Region,
    RigPose,
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


def known(*, seen_s: float = SEEN_S, told: HeadAim | None = AIM, read: HeadAim = AIM) -> State:
    """Return a state with the camera's pose at ``seen_s``, and a head told and read as given, all the time."""
    pose = CameraPose("c", seen_s, T_CAMERA, np.diag([1e-6] * 3 + [2.5e-7] * 3))
    histories = begin(0.0).histories
    for stamp_s in (NOW_S - 0.5, NOW_S - 0.1):
        histories = histories.with_reading(AxisReading("h", "pan", read.pan_rad, stamp_s, 1e-4, 0.0))
        histories = histories.with_reading(AxisReading("h", "tilt", read.tilt_rad, stamp_s, 1e-4, 0.0))
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


def here(aim: HeadAim = AIM) -> RigPose:
    return RigPose({"h": aim}, {"d": DroneAim((2.0, 2.0, 2.0))})


def only(found: tuple[Expected, ...]) -> Expected:
    assert [each.camera_id for each in found] == ["c"]
    return found[0]


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
    found = only(expected(known(), (target,), RigPose(), FIXED, NOW_S))
    stamp_s = found.from_s + share * (found.until_s - found.from_s)
    assert found.holds_at(stamp_s)
    corners = tag_in_picture(LENS, T_CAMERA, tag_at(target, stamp_s, turned_rad), SIZE_M)
    assert corners is None or shown(corners, found.regions)


def test_a_tag_may_be_a_little_off_its_course() -> None:
    found = only(expected(known(), (robot(),), RigPose(), FIXED, NOW_S))
    for angle in np.linspace(0.0, 2.0 * math.pi, 9):
        beside = robot((2.3 + 0.04 * math.cos(angle), 2.0 + 0.04 * math.sin(angle)))
        corners = tag_in_picture(LENS, T_CAMERA, tag_at(beside, NOW_S, angle), SIZE_M)
        assert corners is not None
        assert shown(corners, found.regions)


def test_a_robot_takes_a_small_share_of_the_picture_and_none_where_it_cannot_be_seen() -> None:
    (region,) = only(expected(known(), (robot(velocity_m_s=(0.3, 0.0)),), RigPose(), FIXED, NOW_S)).regions
    area = (region[2] - region[0]) * (region[3] - region[1])
    assert area < 0.06 * 1280 * 720
    for away in ((2.3, 20.0), (-3.0, 2.0)):
        assert only(expected(known(), (robot(away),), RigPose(), FIXED, NOW_S)).regions == ()


def test_anchors_are_looked_for_too() -> None:
    anchor = Anchor(TagKey("tag36h11", 100), SIZE_M, transform(rotation_z(0.4), np.array([2.8, 2.4, 0.0])))
    room = rig(FixedMount(T_CAMERA), anchors=(anchor,))
    found = only(expected(known(), (robot(),), RigPose(), room, NOW_S))
    corners = tag_in_picture(LENS, T_CAMERA, anchor.T_world_tag, SIZE_M)
    assert corners is not None
    assert shown(corners, found.regions)


def test_what_stands_still_is_expected_in_a_smaller_place() -> None:
    def width(motion: str) -> int:
        room = rig(FixedMount(T_CAMERA), motion)
        (region,) = only(expected(known(), (robot(),), RigPose(), room, NOW_S)).regions
        return region[2] - region[0]

    assert width("static") < width("floor")


@pytest.mark.parametrize("status", [TargetStatus.LOST, TargetStatus.UNSEEN])
def test_while_a_target_is_missing_whole_pictures_are_searched(status: TargetStatus) -> None:
    assert expected(known(), (robot(status=status),), RigPose(), FIXED, NOW_S) == ()


def test_regions_hold_from_a_moment_ago_but_not_from_before_the_pose_they_are_made_with() -> None:
    old = only(expected(known(seen_s=NOW_S - 0.4), (robot(),), RigPose(), FIXED, NOW_S))
    assert (old.from_s, old.until_s) == (NOW_S - BEFORE_S, NOW_S + VALID_S)
    new = only(expected(known(seen_s=NOW_S - 0.05), (robot(),), RigPose(), FIXED, NOW_S))
    assert new.from_s == NOW_S - 0.05


def test_a_camera_whose_pose_is_old_looks_at_its_whole_pictures() -> None:
    assert expected(known(seen_s=NOW_S - POSE_AGE_S - 0.1), (robot(),), RigPose(), FIXED, NOW_S) == ()
    assert expected(begin(0.0), (robot(),), RigPose(), FIXED, NOW_S) == ()


@pytest.mark.parametrize("told", [AIM, None])
def test_a_head_at_rest_where_it_was_told_to_be_gives_regions(told: HeadAim | None) -> None:
    assert only(expected(known(told=told), (robot(),), here(), ON_HEAD, NOW_S)).regions


TURNED = HeadAim(AIM.pan_rad + math.radians(1.0), AIM.tilt_rad)


@pytest.mark.parametrize(
    ("told", "read", "at"),
    [(TURNED, AIM, AIM), (TURNED, AIM, TURNED), (AIM, TURNED, AIM), (AIM, AIM, TURNED), (None, AIM, TURNED)],
    ids=["told to go", "just arrived", "came back", "strays", "turns unasked"],
)
def test_a_head_that_moves_or_moved_since_its_last_pose_gives_none(
    told: HeadAim | None, read: HeadAim, at: HeadAim
) -> None:
    assert expected(known(told=told, read=read), (robot(),), here(at), ON_HEAD, NOW_S) == ()


def test_a_head_that_does_not_say_where_it_is_gives_none() -> None:
    assert expected(known(), (robot(),), RigPose(), ON_HEAD, NOW_S) == ()


@pytest.mark.parametrize("mount", [DroneMount("d", transform(R_BODY_OPTICAL_DOWN, np.zeros(3))), FreeMount()])
def test_a_camera_that_never_rests_gives_none(mount: Mount) -> None:
    state = replace(known(), flight={"d": FlightState.FLYING})
    assert expected(state, (robot(),), here(), rig(mount), NOW_S) == ()
