"""The emulated drone without GPS: poses sent to it, their loss, origins, as measured on the real firmware."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.drone_pilot import ACCEPTED, ARM, FAILED, GUIDED, REQUEST, SET_MODE, TEMPORARILY_REJECTED, Pilot, set_point

LAND, OFFBOARD, ALTITUDE = 9, 0x00060000, 0x00020000
GPS_LESS: dict[str, dict[str, float]] = {
    "ardupilot": {
        "GPS1_TYPE": 0,
        "VISO_TYPE": 1,
        "EK3_SRC1_POSXY": 6,
        "EK3_SRC1_POSZ": 6,
        "EK3_SRC1_VELXY": 0,
        "EK3_SRC1_VELZ": 0,
        "EK3_SRC1_YAW": 6,
        "COMPASS_ENABLE": 0,
    },
    "px4": {"EKF2_GPS_CTRL": 0, "SYS_HAS_GPS": 0, "EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_MAG_TYPE": 5},
}
FLAVOURS = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
SENSOR_GPS, SENSOR_VISION, PREARM = 0x20, 0x80, 0x10000000


def origin(system: int = 1) -> Any:
    return dialect.MAVLink_set_gps_global_origin_message(system, 473977420, 85455940, 488000)


def blind_pilot(flavour: str, **settings: Any) -> Pilot:
    pilot = Pilot(flavour, params=GPS_LESS[flavour], **settings)
    pilot.quiet()
    return pilot


def flying(flavour: str) -> Pilot:
    """Fly to 2 m by vision alone."""
    pilot = blind_pilot(flavour)
    both = both_messages(pilot, None if flavour == "ardupilot" else set_point((0.0, 0.0, -2.0)))
    pilot.wait(1.0, both, 25.0)
    pilot.say(origin())
    if flavour == "ardupilot":
        pilot.command(SET_MODE, 1, GUIDED)
        assert pilot.command(ARM, 1) == [ACCEPTED]
        assert pilot.command(22, 0, 0, 0, 0, 0, 0, 2.0) == [ACCEPTED]
    else:
        pilot.command(SET_MODE, 1, 6)
        assert pilot.command(ARM, 1) == [ACCEPTED]
    pilot.wait(5.0, both, 25.0)
    assert pilot.height_m == pytest.approx(2.0, abs=0.1)
    return pilot


def both_messages(pilot: Pilot, point: Any, **pose: Any) -> Any:
    """Return what says ``point`` whenever it is asked for a pose."""

    def message() -> Any:
        if point is not None:
            pilot.say(point)
        return pilot.pose(**pose)

    return message


def test_ardupilot_before_any_pose_says_what_it_misses() -> None:
    pilot = blind_pilot("ardupilot")
    pilot.wait(1.0)
    assert pilot.command(ARM, 1) == [FAILED]
    pilot.wait(0.6)
    assert pilot.texts() == [(2, "Arm: VisOdom: not healthy"), (2, "Arm: AHRS: waiting for home")]
    assert pilot.since(0.0, "LOCAL_POSITION_NED") == []
    status = pilot.last("SYS_STATUS")
    assert not status.onboard_control_sensors_present & SENSOR_GPS
    assert status.onboard_control_sensors_present & SENSOR_VISION
    assert not status.onboard_control_sensors_health & (SENSOR_VISION | PREARM)


def test_ardupilot_knows_its_place_before_its_origin_but_arms_only_after() -> None:
    pilot = blind_pilot("ardupilot")
    pilot.wait(0.6, pilot.pose, 25.0)
    assert (6, "EKF3 IMU0 is using external nav data") in pilot.texts()
    assert pilot.since(0.0, "LOCAL_POSITION_NED")
    assert pilot.command(REQUEST, 49) == [FAILED]
    assert pilot.command(ARM, 1) == [FAILED]
    pilot.wait(0.1, pilot.pose, 25.0)
    assert pilot.texts()[-1] == (2, "Arm: AHRS: waiting for home")
    before_s = pilot.now_s
    pilot.say(origin())
    assert pilot.since(before_s, "COMMAND_ACK") == []
    assert pilot.last("GPS_GLOBAL_ORIGIN").latitude == 473977420
    pilot.wait(0.1, pilot.pose, 25.0)
    assert pilot.texts()[-1][1].endswith("origin set")
    assert pilot.command(ARM, 1) == [ACCEPTED]
    count = len(pilot.since(0.0, "GPS_GLOBAL_ORIGIN"))
    pilot.say(dialect.MAVLink_set_gps_global_origin_message(1, 100000000, 0, 0))  # settable once
    assert len(pilot.since(0.0, "GPS_GLOBAL_ORIGIN")) == count
    assert pilot.vehicle.cockpit.frame.latitude_deg == pytest.approx(47.397742)


def test_px4_needs_no_origin_and_takes_one_in_flight_without_a_jump() -> None:
    pilot = flying("px4")
    point = set_point((0.0, 0.0, -2.0))
    before = pilot.last("LOCAL_POSITION_NED")
    pilot.say(origin(system=0))
    other = dialect.MAVLink_set_gps_global_origin_message(1, 100000000, 0, 0)
    pilot.say(other)
    pilot.wait(0.5, both_messages(pilot, point), 25.0)
    after = pilot.last("LOCAL_POSITION_NED")
    assert (after.x, after.y, after.z) == pytest.approx((before.x, before.y, before.z), abs=0.1)


def test_px4_ignores_an_origin_for_everybody() -> None:
    pilot = blind_pilot("px4")
    pilot.say(origin(system=0))
    assert pilot.since(0.0, "GPS_GLOBAL_ORIGIN") == []
    pilot.say(origin(system=1))
    assert pilot.since(0.0, "GPS_GLOBAL_ORIGIN")


@pytest.mark.parametrize(
    ("flavour", "frame", "child", "taken"),
    [
        ("ardupilot", 20, 12, True),
        ("ardupilot", 1, 12, False),
        ("ardupilot", 20, 8, False),
        ("px4", 1, 12, True),
        ("px4", 20, 8, False),
    ],
)
def test_which_odometry_counts(flavour: str, frame: int, child: int, taken: bool) -> None:
    pilot = blind_pilot(flavour)
    pilot.wait(1.0, lambda: pilot.odometry(frame, child), 30.0)
    assert bool(pilot.since(0.0, "LOCAL_POSITION_NED")) == taken


def test_a_failed_odometry_does_not_count() -> None:
    pilot = blind_pilot("px4")
    pilot.wait(1.0, lambda: pilot.odometry(1, quality=-1), 30.0)
    assert pilot.since(0.0, "LOCAL_POSITION_NED") == []


@FLAVOURS
def test_less_than_four_poses_a_second_are_none(flavour: str) -> None:
    pilot = blind_pilot(flavour)
    pilot.say(origin())
    pilot.wait(3.16, pilot.pose, 2.5)  # the last one came at 2.8 s
    assert set(pilot.command(ARM, 1)) <= {FAILED, TEMPORARILY_REJECTED}


@FLAVOURS
def test_it_believes_where_it_is_told_to_be_and_flies_by_it(flavour: str) -> None:
    """A pose that is 0.5 m off to the north makes it fly 0.5 m too far south."""
    pilot = flying(flavour)
    point = set_point((1.0, 0.0, -2.0), mask=0xDF8)
    pilot.wait(3.0, both_messages(pilot, point, shift_m=(0.5, 0.0, 0.0)), 25.0)
    assert pilot.ned == pytest.approx(np.array([0.5, 0.0, -2.0]), abs=0.1)
    assert pilot.last("LOCAL_POSITION_NED").x == pytest.approx(1.0, abs=0.1)


def test_a_pose_far_off_is_not_believed_unless_the_counter_says_reset() -> None:
    pilot = flying("ardupilot")
    far = (3.0, 0.0, 0.0)
    pilot.wait(0.4, lambda: pilot.pose(shift_m=far), 25.0)
    assert pilot.last("LOCAL_POSITION_NED").x == pytest.approx(0.0, abs=0.1)
    pilot.wait(0.2, lambda: pilot.pose(shift_m=far, reset=1), 25.0)
    assert pilot.last("LOCAL_POSITION_NED").x == pytest.approx(3.0, abs=0.3)


def test_a_turned_pose_turns_its_idea_of_north() -> None:
    pilot = blind_pilot("ardupilot")
    pilot.command(511, 30, 1e5)
    pilot.wait(1.0, lambda: pilot.pose(turn_rad=0.3), 25.0)
    assert pilot.last("ATTITUDE").yaw == pytest.approx(math.pi / 2.0 + 0.3, abs=0.02)


def test_when_the_pose_stops_ardupilot_drifts_claims_it_stayed_and_lands_for_good() -> None:
    pilot = flying("ardupilot")
    pilot.say(set_point((1.0, 2.0, -2.0)))
    pilot.wait(4.0, pilot.pose, 25.0)
    lost_s = pilot.now_s
    waited_s = pilot.until(lambda: pilot.mode == LAND)
    assert waited_s == pytest.approx(7.9, abs=0.3)
    assert pilot.texts(lost_s) == [(2, "EKF variance"), (2, "EKF Failsafe: changed to LAND Mode")]
    claimed = pilot.last("LOCAL_POSITION_NED")
    assert (claimed.x, claimed.y) == pytest.approx((1.0, 2.0), abs=0.15)
    assert np.linalg.norm(pilot.ned[:2] - [1.0, 2.0]) == pytest.approx(0.6, abs=0.15)
    pilot.wait(1.0, pilot.pose, 25.0)  # the pose is back, and it stays in LAND
    assert pilot.mode == LAND
    pilot.until(lambda: not pilot.armed, pilot.pose)


def test_when_the_pose_stops_px4_gives_up_its_place_and_sinks() -> None:
    pilot = flying("px4")
    point = set_point((0.0, 0.0, -2.0))
    waited_s = pilot.until(lambda: pilot.mode == ALTITUDE, point)
    assert waited_s == pytest.approx(5.3, abs=0.5)
    assert "Failsafe activated\t" in [text for _, text in pilot.texts()]
    assert pilot.until(lambda: pilot.height_m == 0.0, point) == pytest.approx(4.0, abs=0.7)
    assert np.linalg.norm(pilot.ned[:2]) == pytest.approx(1.6, abs=0.4)
    pilot.until(lambda: not pilot.armed, point)
    assert pilot.height_m == 0.0  # set-points do not lift it again


@FLAVOURS
@pytest.mark.parametrize("lost_s", [1.0, 7.0])
def test_without_poses_it_can_still_be_told_to_land(flavour: str, lost_s: float) -> None:
    pilot = flying(flavour)
    pilot.wait(lost_s, set_point((0.0, 0.0, -2.0)))
    assert pilot.command(21) == [ACCEPTED]
    pilot.until(lambda: not pilot.armed)
    assert pilot.height_m == 0.0


def test_px4_without_an_origin_has_no_home_to_tell() -> None:
    pilot = blind_pilot("px4")
    pilot.wait(1.0, pilot.pose, 25.0)
    assert pilot.command(REQUEST, 242) == [FAILED]
    pilot.say(origin())
    assert pilot.command(REQUEST, 242) == [ACCEPTED]


def test_px4_returns_to_offboard_when_the_pose_is_back() -> None:
    pilot = flying("px4")
    point = set_point((0.0, 0.0, -2.0))
    pilot.until(lambda: pilot.mode == ALTITUDE, point)
    pilot.wait(2.0, both_messages(pilot, point, reset=1), 25.0)
    assert pilot.mode == OFFBOARD


def test_px4_without_a_reboot_believes_to_be_in_a_pit_and_climbs() -> None:
    pilot = Pilot("px4")
    pilot.quiet()
    for name, value in GPS_LESS["px4"].items():
        pilot.vehicle.params.set(name, value)
        pilot.vehicle.firmware.parameter_set(name)
    pilot.wait(0.5)
    assert pilot.last("LOCAL_POSITION_NED").z == pytest.approx(488.0, abs=0.1)
    point = set_point((0.0, 0.0, -2.0))
    pilot.wait(0.5, point)
    pilot.command(SET_MODE, 1, 6)
    pilot.command(ARM, 1)
    pilot.wait(15.0, point)
    assert pilot.height_m > 10.0


@FLAVOURS
def test_parameters_count_from_the_next_boot_and_are_kept(flavour: str) -> None:
    pilot = Pilot(flavour)
    for name, value in GPS_LESS[flavour].items():
        pilot.vehicle.params.set(name, value)
    pilot.wait(0.1)
    assert pilot.vehicle.cockpit.estimator.sources.gps
    pilot.command(246, 1)
    pilot.wait(2.0)
    assert not pilot.vehicle.cockpit.estimator.sources.gps
    pilot.quiet()
    pilot.wait(1.0, pilot.pose, 25.0)
    assert pilot.last("LOCAL_POSITION_NED").z == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(("clock", "taken"), [("answered", True), ("other", False)])
def test_px4_believes_stamps_once_it_knows_their_clock(clock: str, taken: bool) -> None:
    """It asks ten times a second; after 500 answers a stamp counts, before that the time of arrival."""
    pilot = blind_pilot("px4")
    ahead_s = 77.0

    def answer() -> Any:
        question = pilot.last("TIMESYNC")
        return dialect.MAVLink_timesync_message(round((pilot.now_s + ahead_s) * 1e9), question.ts1)

    def pose() -> Any:
        stamp_s = pilot.now_s + (ahead_s if clock == "answered" else 0.0)
        return pilot.odometry(1, time_us=round(stamp_s * 1e6))

    pilot.wait(1.0, pose, 25.0)
    assert pilot.vehicle.cockpit.estimator.aided  # not converged: any stamp
    pilot.wait(52.0, answer, 10.0)
    pilot.wait(1.0, pose, 25.0)
    assert pilot.vehicle.cockpit.estimator.aided == taken
