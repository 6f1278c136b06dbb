"""PX4's habits, each as it was measured on the real firmware."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.drone_pilot import (
    ACCEPTED,
    ARM,
    LAND,
    POSITION_ONLY,
    SET_INTERVAL,
    SET_MODE,
    TAKE_OFF,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    VELOCITY,
    Pilot,
    set_point,
)

OFFBOARD, HOLD, TAKING_OFF, RETURN, LANDING = 0x00060000, 0x03040000, 0x02040000, 0x05040000, 0x06040000
HERE_POINT = set_point((0.0, 0.0, -2.0))


@pytest.fixture
def pilot() -> Pilot:
    return Pilot("px4")


@pytest.fixture
def flying(pilot: Pilot) -> Pilot:
    pilot.take_off()
    return pilot


def test_telemetry_is_pushed_unasked_and_can_be_changed(pilot: Pilot) -> None:
    pilot.wait(4.0)
    for name, rate_hz in {"LOCAL_POSITION_NED": 30, "EXTENDED_SYS_STATE": 5, "SYS_STATUS": 5, "HEARTBEAT": 1}.items():
        assert len(pilot.since(0.0, name)) == pytest.approx(4 * rate_hz, rel=0.1, abs=1), name
    assert len(pilot.since(0.0, "ATTITUDE")) > 150  # 100 Hz, as often as this pilot polls
    heartbeat = pilot.last("HEARTBEAT")
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.custom_mode) == (2, 12, HOLD)
    assert pilot.command(SET_INTERVAL, 30, -1) == [ACCEPTED]
    changed_s = pilot.now_s
    pilot.wait(1.0)
    assert pilot.since(changed_s + 0.01, "ATTITUDE") == []


def test_the_documented_flight(flying: Pilot) -> None:
    point = set_point((1.0, 2.0, -2.0), yaw=math.pi / 2.0)
    assert flying.until(lambda: bool(np.linalg.norm(flying.ned - [1.0, 2.0, -2.0]) < 0.1), point) < 5.0
    for _ in range(20):
        flying.wait(0.2, point)
        assert np.linalg.norm(flying.ned - [1.0, 2.0, -2.0]) < 0.1
    assert flying.vehicle.history.latest.truth.yaw_rad == pytest.approx(0.0, abs=0.02)
    assert flying.command(LAND) == [ACCEPTED]
    flying.until(lambda: flying.height_m == 0.0)
    assert flying.until(lambda: not flying.armed) == pytest.approx(2.0, abs=0.3)
    flying.wait(1.0)
    assert flying.last("EXTENDED_SYS_STATE").landed_state == 1


@pytest.mark.parametrize("main_mode", [6, 99, 3])
def test_a_change_of_mode_is_always_accepted_and_seldom_done(pilot: Pilot, main_mode: int) -> None:
    assert set(pilot.command(SET_MODE, 1, main_mode)) == {ACCEPTED}
    pilot.wait(3.0)
    assert pilot.mode == HOLD
    said = [text for severity, text in pilot.texts() if severity == 2]
    assert said == {6: ["Switching to Offboard is currently not available\t"], 99: []}.get(
        main_mode, ["Switching to Position is currently not available\t"]
    )


def test_now_and_then_a_mode_is_acknowledged_twice(pilot: Pilot) -> None:
    counts = [len(pilot.command(SET_MODE, 1, 4, 3)) for _ in range(100)]
    assert set(counts) == {1, 2}


def test_offboard_needs_a_running_stream(pilot: Pilot) -> None:
    pilot.wait(1.0, HERE_POINT)
    pilot.wait(1.5)
    pilot.command(SET_MODE, 1, 6)
    pilot.wait(1.5)
    assert pilot.mode == HOLD
    pilot.wait(0.5, HERE_POINT)
    pilot.command(SET_MODE, 1, 6)
    assert pilot.until(lambda: pilot.mode == OFFBOARD, HERE_POINT) < 0.7


@pytest.mark.parametrize(("rate_hz", "kept"), [(2.5, True), (1.2, True), (0.7, False)])
def test_how_slow_a_stream_may_be(flying: Pilot, rate_hz: float, kept: bool) -> None:
    start_s = flying.now_s
    flying.wait(6.0, HERE_POINT, rate_hz)
    modes = {message.custom_mode for message in flying.since(start_s, "HEARTBEAT")}
    assert (modes == {OFFBOARD}) == kept


def test_without_set_points_it_holds_and_then_returns_which_climbs(flying: Pilot) -> None:
    assert flying.until(lambda: flying.mode != OFFBOARD) == pytest.approx(1.4, abs=0.2)
    assert flying.mode == HOLD
    assert flying.until(lambda: flying.mode == RETURN) == pytest.approx(5.0, abs=0.3)
    flying.until(lambda: flying.height_m > 10.0)
    assert flying.last("HEARTBEAT").system_status == 5


def test_with_the_right_parameter_it_lands_instead(flying: Pilot) -> None:
    flying.vehicle.cockpit.params.set("COM_OBL_RC_ACT", 4)
    flying.until(lambda: flying.mode == LANDING)
    flying.until(lambda: not flying.armed)


@pytest.mark.parametrize("silence_s", [3.0, 8.0])
def test_set_points_that_come_back_are_flown_at_once_without_a_command(flying: Pilot, silence_s: float) -> None:
    flying.wait(silence_s)
    assert flying.mode in {HOLD, RETURN}
    stale = set_point((2.0, 0.0, -2.0))
    flying.wait(6.0, stale)
    assert flying.mode == OFFBOARD
    assert flying.ned == pytest.approx(np.array([2.0, 0.0, -2.0]), abs=0.1)


def test_a_mode_chosen_by_command_is_not_taken_back_by_set_points(flying: Pilot) -> None:
    flying.command(SET_MODE, 1, 4, 3)
    flying.wait(3.0, set_point((2.0, 0.0, -2.0)))
    assert flying.mode == HOLD
    assert np.linalg.norm(flying.ned - [0.0, 0.0, -2.0]) < 0.1


@pytest.mark.parametrize("frame", [7, 9])
def test_other_frames_are_refused_in_chunks_of_text(flying: Pilot, frame: int) -> None:
    start_s = flying.now_s
    flying.say(set_point((2.0, 0.0, 0.0), frame=frame))
    flying.wait(0.1, HERE_POINT)
    chunks = flying.since(start_s, "STATUSTEXT")
    assert [chunk.chunk_seq for chunk in chunks] == [0, 1]
    assert len({chunk.id for chunk in chunks}) == 1
    assert chunks[0].id != 0
    text = "".join(chunk.text for chunk in chunks)
    assert text == f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported\t"
    assert flying.since(start_s + 0.01, "COMMAND_ACK") == []


def test_in_the_body_frame_velocity_counts_and_position_does_not(flying: Pilot) -> None:
    east = set_point((0.0, 0.0, -2.0), yaw=math.pi / 2.0)
    flying.wait(3.0, east)
    ahead = set_point((9.0, 9.0, -9.0), (0.5, 0.0, 0.0), mask=VELOCITY & ~0x007, frame=8)
    start = flying.ned
    flying.wait(3.0, ahead)
    assert flying.ned - start == pytest.approx(np.array([0.0, 1.4, 0.0]), abs=0.15)


def test_each_axis_may_be_ignored_singly(flying: Pilot) -> None:
    flying.wait(5.0, set_point((1.0, 7.0, -2.0), mask=POSITION_ONLY | 0x002))
    assert flying.ned == pytest.approx(np.array([1.0, 0.0, -2.0]), abs=0.15)


def test_another_vehicles_set_points_do_not_count(pilot: Pilot) -> None:
    pilot.wait(1.0, set_point((0.0, 0.0, -2.0), system=2))
    pilot.command(SET_MODE, 1, 6)
    pilot.wait(1.5)
    assert pilot.mode == HOLD


@pytest.mark.parametrize(("altitude_m", "height_m"), [(math.nan, 2.5), (489.5, 1.5), (2.0, 2.5)])
def test_a_take_off_is_above_the_sea(pilot: Pilot, altitude_m: float, height_m: float) -> None:
    pilot.quiet()
    assert pilot.command(ARM, 1) == [ACCEPTED]
    assert pilot.command(TAKE_OFF, *[math.nan] * 6, altitude_m) == [ACCEPTED]
    pilot.until(lambda: pilot.mode == TAKING_OFF)
    pilot.until(lambda: pilot.mode == HOLD)
    pilot.wait(2.0)
    assert pilot.height_m == pytest.approx(height_m, abs=0.08)


def test_disarming(flying: Pilot) -> None:
    assert flying.command(ARM, 0) == [TEMPORARILY_REJECTED]
    flying.wait(0.1, HERE_POINT)
    assert (2, "Disarming denied: not landed\t") in flying.texts()
    assert flying.armed
    assert flying.command(ARM, 0, 21196) == [ACCEPTED]
    assert flying.until(lambda: flying.height_m == 0.0) < 1.0


def test_arming_in_offboard_needs_the_stream(pilot: Pilot) -> None:
    pilot.wait(0.5, HERE_POINT)
    pilot.command(SET_MODE, 1, 6)
    pilot.wait(1.5)
    assert pilot.command(ARM, 1) == [TEMPORARILY_REJECTED]
    assert not pilot.armed


def test_armed_and_not_flown_it_disarms(pilot: Pilot) -> None:
    assert pilot.command(ARM, 1) == [ACCEPTED]
    assert pilot.until(lambda: not pilot.armed) == pytest.approx(10.0, abs=0.15)


def test_what_it_does_not_know(pilot: Pilot) -> None:
    assert pilot.command(115, 90) == [UNSUPPORTED]
    assert pilot.command(31999) == [UNSUPPORTED]
    for gimbal in (205, 1000, 1001):
        assert pilot.command(gimbal, -90) == []


def test_texts_wait_for_a_ground_station(flying: Pilot) -> None:
    flying.beats = False
    flying.wait(3.0, HERE_POINT)
    silent_s = flying.now_s
    flying.command(ARM, 0)
    flying.wait(11.0, HERE_POINT)
    assert flying.texts(silent_s) == []
    assert flying.mode == OFFBOARD  # NAV_DLL_ACT 0
    flying.beats = True
    flying.wait(0.1, HERE_POINT)
    texts = [text for _, text in flying.texts(silent_s)]
    assert texts == [
        "Disarming denied: not landed\t",
        "Connection to ground station lost\t",
        "Ground station connection regained\t",
    ]


def test_the_data_link_failsafe_holds_and_stays(flying: Pilot) -> None:
    flying.vehicle.cockpit.params.set("NAV_DLL_ACT", 1)
    flying.wait(1.0, HERE_POINT)
    flying.beats = False
    assert flying.until(lambda: flying.mode == HOLD, HERE_POINT) == pytest.approx(11.7, abs=0.8)
    flying.beats = True
    flying.wait(3.0, HERE_POINT)
    assert flying.mode == HOLD


def test_integers_travel_as_raw_bits(pilot: Pilot) -> None:
    def read(name: bytes) -> float:
        pilot.say(dialect.MAVLink_param_request_read_message(1, 1, name, -1))
        assert pilot.last("PARAM_VALUE").param_id == name.decode()
        return float(pilot.last("PARAM_VALUE").param_value)

    bits = struct.unpack("<f", struct.pack("<i", 3))[0]
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"NAV_DLL_ACT", bits, 6))
    assert struct.pack("<f", read(b"NAV_DLL_ACT")) == struct.pack("<i", 3)
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 1.25, 9))
    assert read(b"MIS_TAKEOFF_ALT") == 1.25
    assert pilot.vehicle.cockpit.params["NAV_DLL_ACT"] == 3
