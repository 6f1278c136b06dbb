"""ArduCopter's habits, each as it was measured on the real firmware."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.drone_pilot import (
    ACCEPTED,
    ARM,
    FAILED,
    GUIDED,
    LAND,
    POSITION_ONLY,
    SET_INTERVAL,
    SET_MODE,
    TAKE_OFF,
    UNSUPPORTED,
    VELOCITY,
    Pilot,
    command_long,
    set_point,
)

ALT_HOLD, LOITER, RTL, LANDING, BRAKE = 2, 5, 6, 9, 17


@pytest.fixture
def pilot() -> Pilot:
    return Pilot("ardupilot")


@pytest.fixture
def flying(pilot: Pilot) -> Pilot:
    pilot.take_off()
    return pilot


def test_a_fresh_boot_sends_heartbeats_and_time_alone(pilot: Pilot) -> None:
    pilot.wait(9.5)
    names = {message.get_type() for _, message in pilot.heard}
    assert names == {"HEARTBEAT", "TIMESYNC"}
    heartbeat = pilot.last("HEARTBEAT")
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.get_srcComponent()) == (2, 3, 1)
    assert len(pilot.since(0.0, "HEARTBEAT")) == 10


def test_a_message_comes_at_the_interval_asked_for_and_on_that_link_alone(pilot: Pilot) -> None:
    pilot.wait(0.1)
    pilot.say(command_long(SET_INTERVAL, 32, 1e6 / 5.0), address=("other", 2))
    pilot.wait(2.0)
    assert pilot.since(0.0, "LOCAL_POSITION_NED") == []
    assert pilot.command(SET_INTERVAL, 32, 1e6 / 25.0) == [ACCEPTED]
    pilot.wait(4.0)
    assert len(pilot.since(0.0, "LOCAL_POSITION_NED")) == pytest.approx(100, abs=2)


def test_the_documented_flight(flying: Pilot) -> None:
    flying.say(set_point((1.0, 2.0, -2.0), yaw=math.pi / 2.0))
    arrival_s = flying.until(lambda: bool(np.linalg.norm(flying.ned - [1.0, 2.0, -2.0]) < 0.1))
    assert arrival_s < 5.0
    errors_m = []
    for _ in range(40):  # one set-point holds for ever
        flying.wait(0.2)
        errors_m.append(float(np.linalg.norm(flying.ned - [1.0, 2.0, -2.0])))
    assert max(errors_m) < 0.1
    assert flying.vehicle.history.latest.truth.yaw_rad == pytest.approx(0.0, abs=0.02)  # NED east = ENU 0
    assert flying.command(LAND) == [ACCEPTED]
    touched_s = flying.until(lambda: flying.height_m == 0.0)
    assert touched_s == pytest.approx(4.4, abs=0.6)
    assert flying.until(lambda: not flying.armed) == pytest.approx(2.0, abs=0.3)
    flying.wait(1.0)
    assert flying.last("EXTENDED_SYS_STATE").landed_state == 1


def test_a_set_point_before_lift_off_cancels_the_take_off_without_a_word(pilot: Pilot) -> None:
    pilot.command(SET_MODE, 1, GUIDED)
    pilot.command(ARM, 1)
    assert pilot.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 2.0) == [ACCEPTED]
    asked_s = pilot.now_s
    pilot.say(set_point((0.0, 0.0, -2.0)))
    pilot.wait(9.5)
    assert pilot.height_m == 0.0
    assert pilot.armed
    assert [text for text in pilot.texts(asked_s) if text[1] != "Arming motors"] == []
    pilot.wait(1.0)
    assert not pilot.armed  # DISARM_DELAY


def test_armed_without_take_off_it_disarms_after_ten_seconds(pilot: Pilot) -> None:
    pilot.command(SET_MODE, 1, GUIDED)
    pilot.command(ARM, 1)
    assert pilot.until(lambda: not pilot.armed) == pytest.approx(10.0, abs=0.15)


def test_outside_guided_set_points_are_ignored_without_a_word(flying: Pilot) -> None:
    flying.command(SET_MODE, 1, BRAKE)
    changed_s = flying.now_s
    flying.wait(4.0, set_point((2.0, 0.0, -2.0)))
    assert np.linalg.norm(flying.ned - [0.0, 0.0, -2.0]) < 0.1
    assert flying.texts(changed_s + 0.1) == []
    assert flying.since(changed_s + 0.1, "COMMAND_ACK") == []


@pytest.mark.parametrize("mode", [ALT_HOLD, LOITER])
def test_a_mode_with_sticks_falls_to_the_floor_without_a_remote_control(flying: Pilot, mode: int) -> None:
    assert flying.command(SET_MODE, 1, mode) == [ACCEPTED]
    speed_m_s = 0.0
    while flying.height_m > 0.0:
        flying.wait(0.02)
        speed_m_s = max(speed_m_s, flying.speed_m_s)
    assert speed_m_s == pytest.approx(2.4, abs=0.2)


def test_velocity_ends_after_the_guided_timeout(flying: Pilot) -> None:
    flying.wait(2.0, set_point(velocity=(0.5, 0.0, 0.0), mask=VELOCITY))
    assert flying.speed_m_s == pytest.approx(0.5, abs=0.1)
    start_m = flying.ned[0]
    flying.wait(4.3)
    assert flying.speed_m_s < 0.1
    assert flying.ned[0] - start_m == pytest.approx(1.7, abs=0.2)


@pytest.mark.parametrize(
    ("frame", "expected"),
    [(1, (0.5, 0.25, -2.0)), (7, (1.5, 0.25, -2.0)), (8, (0.75, 0.5, -2.0)), (9, (0.75, 0.5, -2.0))],
)
def test_frames(flying: Pilot, frame: int, expected: tuple[float, float, float]) -> None:
    """At (1, 0, -2) with the nose to the east: 1 is from the origin, 7 an offset, 8 and 9 along the heading."""
    flying.say(set_point((1.0, 0.0, -2.0), yaw=math.pi / 2.0))
    flying.wait(6.0)
    z = -2.0 if frame == 1 else 0.0
    flying.say(set_point((0.5, 0.25, z), mask=POSITION_ONLY, frame=frame))
    flying.wait(5.0)
    assert flying.ned == pytest.approx(np.array(expected), abs=0.08)
    assert flying.vehicle.history.latest.truth.yaw_rad == pytest.approx(0.0, abs=0.03)  # kept


@pytest.mark.parametrize(
    "point",
    [
        set_point((5.0, 0.0, -2.0), mask=0xFFF),
        set_point((5.0, 0.0, -2.0), mask=POSITION_ONLY | 0x002),  # one axis ignored drops all three
        set_point((5.0, 0.0, -2.0), frame=6),
        set_point((5.0, math.nan, -2.0)),
    ],
)
def test_what_it_does_not_understand_stops_it(flying: Pilot, point: object) -> None:
    flying.say(set_point((8.0, 0.0, -2.0)))
    flying.wait(2.0)
    stopped_m, count = flying.ned[0], len(flying.heard)
    flying.say(point)
    flying.wait(4.0)
    assert flying.speed_m_s < 0.1
    assert 0.2 < flying.ned[0] - stopped_m < 1.5
    assert {message.get_type() for _, message in flying.heard[count:]}.isdisjoint({"COMMAND_ACK", "STATUSTEXT"})


def test_take_off_needs_guided_and_armed_and_the_floor(pilot: Pilot) -> None:
    height = (0, 0, 0, 0, 0, 0, 2.0)
    pilot.command(SET_MODE, 1, GUIDED)
    assert pilot.command(TAKE_OFF, *height) == [FAILED]
    pilot.take_off()
    assert pilot.command(TAKE_OFF, *height) == [FAILED]


def test_refusals(flying: Pilot) -> None:
    flying.wait(0.1)
    before_s = flying.now_s
    assert flying.command(SET_MODE, 1, 999) == [FAILED]
    assert flying.command(ARM, 0) == [FAILED]  # in the air
    assert flying.command(1000, -90) == [FAILED]  # no mount
    assert flying.command(31999) == [UNSUPPORTED]
    flying.wait(0.1)
    assert flying.texts(before_s) == [(4, "No such mode 231")]
    assert flying.armed
    assert flying.mode == GUIDED


def test_a_forced_disarm_drops_it(flying: Pilot) -> None:
    assert flying.command(ARM, 0, 21196) == [ACCEPTED]
    assert flying.until(lambda: flying.height_m == 0.0) < 1.0


def test_a_mode_shows_at_once_in_an_extra_heartbeat(flying: Pilot) -> None:
    flying.wait(0.5)
    flying.command(SET_MODE, 1, BRAKE)
    flying.wait(0.04)
    assert flying.mode == BRAKE


def test_arming_is_refused_with_a_reason(pilot: Pilot) -> None:
    slow = Pilot("ardupilot", ready_after_s=3.0)
    assert slow.command(ARM, 1) == [FAILED]
    slow.wait(0.1)
    assert slow.texts() == [(2, "Arm: AHRS: waiting for home")]
    slow.quiet()
    slow.wait(2.0)
    assert slow.since(0.0, "LOCAL_POSITION_NED") == []
    assert not slow.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    slow.wait(2.0)
    assert slow.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    assert slow.command(ARM, 1) == [ACCEPTED]
    pilot.command(LAND)
    assert pilot.command(ARM, 1) == [FAILED]  # LAND is not armable


def test_without_a_failsafe_the_loss_of_the_ground_station_means_nothing(flying: Pilot) -> None:
    flying.beats = False
    flying.wait(12.0)
    assert flying.vehicle.firmware.custom_mode == GUIDED
    assert flying.height_m == pytest.approx(2.0, abs=0.1)


def test_the_ground_station_failsafe_lands_and_stays_in_land(flying: Pilot) -> None:
    flying.vehicle.cockpit.params.set("FS_GCS_ENABLE", 5)
    flying.wait(1.0)
    flying.beats = False
    lost_s = flying.until(lambda: flying.vehicle.firmware.custom_mode == LANDING)
    assert lost_s == pytest.approx(4.5, abs=0.7)
    flying.beats = True
    back_s = flying.now_s
    flying.wait(2.0, set_point((0.0, 0.0, -2.0)))
    assert (4, "GCS Failsafe Cleared") in flying.texts(back_s)
    assert flying.mode == LANDING
    flying.until(lambda: not flying.armed)


def test_another_system_id_is_no_ground_station() -> None:
    pilot = Pilot("ardupilot", system=245)
    pilot.vehicle.cockpit.params.set("FS_GCS_ENABLE", 5)
    pilot.command(SET_MODE, 1, GUIDED)
    pilot.wait(6.0)
    assert pilot.command(ARM, 1) == [FAILED]
    pilot.wait(0.1)
    assert (2, "Arm: GCS failsafe on") in pilot.texts()


def test_a_changed_speed_lasts_until_guided_is_entered_anew(flying: Pilot) -> None:
    def top_speed_m_s(target: tuple[float, float, float]) -> float:
        flying.say(set_point(target))
        speeds = []
        while np.linalg.norm(flying.ned - target) > 0.1:
            flying.wait(0.1)
            speeds.append(flying.speed_m_s)
        return max(speeds)

    assert flying.command(178, 1, 0.4) == [ACCEPTED]
    assert top_speed_m_s((1.5, 0.0, -2.0)) == pytest.approx(0.42, abs=0.08)
    flying.command(SET_MODE, 1, BRAKE)
    flying.wait(1.0)
    flying.command(SET_MODE, 1, GUIDED)
    assert top_speed_m_s((-1.5, 0.0, -2.0)) > 1.5


def test_return_to_launch_climbs(flying: Pilot) -> None:
    flying.say(set_point((3.0, 0.0, -2.0)))
    flying.wait(4.0)
    assert flying.command(SET_MODE, 1, RTL) == [ACCEPTED]
    flying.until(lambda: flying.height_m > 14.5)
    assert flying.ned[0] == pytest.approx(3.0, abs=0.1)
    flying.until(lambda: not flying.armed, limit_s=120.0)
    assert np.linalg.norm(flying.ned) < 0.2


def test_a_reboot_forgets_streams_and_time(pilot: Pilot) -> None:
    pilot.quiet()
    pilot.wait(1.0)
    before_ms = pilot.last("LOCAL_POSITION_NED").time_boot_ms
    assert pilot.command(246, 1) == [ACCEPTED]
    asked_s = pilot.now_s
    pilot.wait(4.0)
    heartbeat_s = next(s for s, m in pilot.heard if s > asked_s and m.get_type() == "HEARTBEAT")
    assert heartbeat_s - asked_s == pytest.approx(1.2, abs=0.05)
    assert pilot.since(asked_s + 0.01, "LOCAL_POSITION_NED") == []
    pilot.quiet()
    pilot.wait(0.5)
    assert pilot.last("LOCAL_POSITION_NED").time_boot_ms < 6000 < before_ms
