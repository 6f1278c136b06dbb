"""The three grades of pointing on an emulated head, in simulated time."""

import math
from itertools import pairwise
from typing import Any

import pytest

from camrig.errors import NotEnabledError
from camrig.messages import AxisReading
from camrig_drivers.pelco_d.reckoning import Reckoning, TimeModel
from tests.simulated_line import SimulatedHeads

SPEEDS = {"speeds": {1: 40.0 / 63.0, 63: 40.0}}
AXES: dict[str, Any] = {"pan": SPEEDS, "tilt": SPEEDS}
STORE_1 = bytes.fromhex("ff010003000105")
EXACT = {"start_s": 0.05, "start_sigma_s": 0.0, "stop_sigma_s": 0.0, "speed_sigma": 0.02}


def opened(grade: str = "absolute", script: str = "", baud: int = 9600, **settings: Any) -> SimulatedHeads:
    keys = {"grade": grade, "axes": AXES, **settings.pop("keys", {})}
    rig = SimulatedHeads(baud=baud, keys=keys, script=script, **settings)
    rig.line.receive(STORE_1, rig.time.now_s(), baud)
    rig.time.sleep_s(0.5)
    rig.head.open()
    rig.head.enable()
    return rig


def by_preset(**zero: Any) -> dict[str, Any]:
    preset = {"by": "preset", "preset": 1, "pan_deg": 0.0, "tilt_deg": 0.0, "travel_s": 6.0, "sigma_deg": 0.05}
    return {"keys": {"open_loop": {"zero": {**preset, **zero}, **EXACT}}, "answers": "none"}


def last(readings: list[AxisReading], axis: str) -> AxisReading:
    return [reading for reading in readings if reading.axis == axis][-1]


# --- with read-back -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [2400, 9600])
@pytest.mark.parametrize("grade", ["absolute", "velocity"])
def test_a_head_with_read_back_arrives(grade: str, baud: int) -> None:
    rig = opened(grade, baud=baud)
    for aim in ((90.0, -60.0), (-150.0, 5.0), (-149.7, 4.8)):
        rig.move(*aim)
        readings = rig.poll(13.0)
        assert rig.truth_deg() == pytest.approx(aim, abs=0.11)
        assert rig.worst_error_deg(readings) <= 0.01


@pytest.mark.parametrize("grade", ["absolute", "velocity"])
def test_play_is_taken_up_from_one_side_and_reckoned_with(grade: str) -> None:
    play = {"backlash_deg": 0.4, **SPEEDS}
    rig = opened(grade, keys={"axes": {"pan": play, "tilt": play}, "readback_sigma_deg": 0.0}, backlash_deg=0.4)
    for aim in ((60.0, -30.0), (20.0, -60.0)):  # from below, and from above
        rig.move(*aim)
        readings = rig.poll(12.0)
        assert rig.truth_deg() == pytest.approx(aim, abs=0.11)
        for axis, true_deg in zip(("pan", "tilt"), rig.truth_deg(), strict=True):
            reading = last(readings, axis)
            assert math.degrees(reading.angle_rad) == pytest.approx(true_deg, abs=0.006)
            assert math.degrees(reading.sigma_rad) < 0.004
    pan = rig.line._bus.heads["pt1"].pan.motion
    assert pan.motor(rig.time.now_s()) > rig.truth_deg()[0], "it arrived rising"


def test_at_a_limit_there_is_no_room_to_turn_round() -> None:
    play = {"backlash_deg": 0.4}
    rig = opened(keys={"axes": {"pan": play, "tilt": play}}, backlash_deg=0.4)
    rig.move(-170.0, -90.0)
    rig.poll(10.0)
    assert rig.truth_deg() == pytest.approx((-170.0, -90.0), abs=0.11)


def test_a_servo_never_leaves_the_limits() -> None:
    rig = opened("velocity", script="from 1 to 1.5 silent; from 2 to 2.3 latency 0.2", seed=3)
    furthest = 0.0
    for aim in ((170.0, 10.0), (-170.0, -90.0)):
        rig.move(*aim)
        for _ in range(60):
            rig.poll(0.2)
            pan_deg, tilt_deg = rig.truth_deg()
            furthest = max(furthest, abs(pan_deg) - 170.0, tilt_deg - 10.0, -90.0 - tilt_deg)
    assert furthest <= 0.11


def test_a_motion_is_said_again_before_a_dead_man_ends_it() -> None:
    rig = opened("open_loop", dead_man_s=8.0, max_speed_deg_s=8.0, **with_speeds(8.0))
    rig.move(0.0, 0.0)
    rig.poll(7.0)
    rig.move(160.0, 0.0)
    rig.poll(24.0)
    assert rig.truth_deg()[0] == pytest.approx(160.0, abs=0.5)
    assert len([frame for frame in rig.motions() if frame.startswith("ff0100043f00")]) >= 3


def with_speeds(fastest_deg_s: float) -> dict[str, Any]:
    settings = by_preset()
    axis = {"speeds": {63: fastest_deg_s}}
    settings["keys"] = {**settings["keys"], "axes": {"pan": axis, "tilt": axis}}
    return settings


def test_a_stop_in_the_middle_ends_a_servo_for_good() -> None:
    rig = opened("velocity")
    rig.move(150.0, -80.0)
    rig.poll(1.0)
    rig.head.stop()
    heard = len(rig.motions())
    rig.poll(3.0)
    assert set(rig.motions()[heard:]) <= {"stop"}
    with pytest.raises(NotEnabledError):
        rig.move(0.0, 0.0)


def test_what_counts_as_there_is_the_sections() -> None:
    rig = opened(keys={"axes": {"pan": {"arrival_deg": 1.0}, "tilt": {"arrival_deg": 1.0}}}, stop_error_deg=0.5, seed=2)
    rig.move(40.0, -40.0)
    rig.poll(8.0)
    assert len(rig.motions()) == 3, "the stored preset, and each axis once"


# --- by the clock ---------------------------------------------------------------------------------------------


def test_an_open_loop_head_is_unknown_until_it_has_zeroed_itself() -> None:
    rig = opened("open_loop", **by_preset())
    assert rig.poll(2.0) == []
    assert rig.motions()[1:] == [], "and moves nothing before it is sent"
    rig.move(50.0, -40.0)
    assert rig.poll(5.9) == []
    readings = rig.poll(5.0)
    assert rig.truth_deg() == pytest.approx((50.0, -40.0), abs=0.2)
    assert rig.worst_error_deg(readings) <= 0.0


def test_a_stop_on_its_way_leaves_it_where_it_is_reckoned_to_be() -> None:
    rig = opened("open_loop", **by_preset())
    rig.move(0.0, 0.0)
    rig.poll(7.0)
    rig.move(150.0, -20.0)
    rig.poll(1.0)
    rig.head.stop()
    rig.time.sleep_s(0.5)
    rig.head.stop()
    readings = rig.poll(6.0)
    assert rig.worst_error_deg(readings) <= 0.0
    rig.head.enable()
    rig.move(-160.0, -20.0)
    readings = rig.poll(12.0)
    assert rig.worst_error_deg(readings) <= 0.0
    assert rig.truth_deg()[0] == pytest.approx(-160.0, abs=2.0)


def test_a_stop_on_its_way_to_the_preset_leaves_it_unknown() -> None:
    rig = opened("open_loop", **by_preset())
    rig.move(120.0, -20.0)
    rig.poll(12.0)
    rig.head.close()
    rig.head.open()
    rig.head.enable()
    rig.move(10.0, -10.0)
    rig.poll(0.8)
    rig.head.stop()
    assert rig.poll(8.0) == []
    rig.head.enable()
    rig.move(10.0, -10.0)
    assert rig.poll(5.9) == []
    rig.poll(5.0)
    assert rig.truth_deg() == pytest.approx((10.0, -10.0), abs=0.2)


def test_its_sigma_grows_with_its_way_and_a_preset_makes_it_small_again() -> None:
    rig = opened("open_loop", speed_drift=0.02, seed=5, **by_preset())
    sigmas_deg = []
    for k in range(7):
        rig.move(60.0 if k % 2 else -60.0, -20.0)
        readings = rig.poll(16.0)
        assert rig.worst_error_deg(readings) <= 0.0
        sigmas_deg.append(math.degrees(last(readings, "pan").sigma_rad))
    assert sigmas_deg[0] == pytest.approx(math.hypot(0.05, 0.02 * 60.0), rel=0.1)
    grown = [after > before for before, after in pairwise(sigmas_deg)]
    assert grown == [True, True, False, True, True, False], sigmas_deg  # above 3 deg it went through the preset
    assert max(sigmas_deg) < 6.0


def test_end_stops_zero_it_too() -> None:
    settings = by_preset(by="end_stops", preset=None, pan_deg=-175.0, tilt_deg=-95.0, travel_s=12.0)
    rig = opened("open_loop", **settings)
    rig.move(-100.0, -40.0)
    rig.poll(20.0)
    assert rig.truth_deg() == pytest.approx((-100.0, -40.0), abs=0.2)


def test_what_is_measured_of_it_corrects_it() -> None:
    rig = opened("open_loop", speed_drift=0.05, seed=1, **by_preset())
    assert rig.poll(0.5) == []
    measure(rig)
    rig.move(50.0, -40.0)
    rig.poll(6.0)
    assert len(rig.motions()) > 2, "known by that, it needs no preset"
    before = last(rig.poll(1.0), "pan")
    measure(rig)
    after = last(rig.poll(0.5), "pan")
    assert after.sigma_rad < 0.2 * before.sigma_rad
    assert abs(math.degrees(after.angle_rad) - rig.truth_deg()[0]) < 3.0 * math.degrees(after.sigma_rad)


def measure(rig: SimulatedHeads) -> None:
    """Tell the head where it looked a moment ago, as anchors would."""
    stamp_s = rig.time.now_s() - 0.2
    for axis, true_deg in zip(("pan", "tilt"), rig.truth_deg(stamp_s), strict=True):
        assert axis in ("pan", "tilt")
        rig.head.correct(AxisReading("pt1", axis, math.radians(true_deg), stamp_s, math.radians(0.1), 0.0))  # type: ignore[arg-type]


def test_a_motion_of_some_time_goes_speed_times_time_whatever_the_ramps() -> None:
    for acceleration in (0.5, 2.0, 20.0):
        axis = Reckoning(TimeModel(0.1, 0.0, 0.0, acceleration, 0.05), 1.0, 0.0)
        axis.command(0.5, 10.0)
        axis.command(0.0, 13.1)
        assert axis.at(20.0) == pytest.approx(1.0 + 0.5 * 3.0)
        assert axis.rests(20.0)
        assert axis.sigma_rad(20.0) == pytest.approx(0.05 * 1.5)


# --- the camera -----------------------------------------------------------------------------------------------


def test_the_lens_is_set_in_the_heads_dialect_when_it_is_enabled() -> None:
    keys = {
        "camera": {"auto_focus": False, "awb": True, "magnification": 1.0},
        "dialect": {"auto_off": 2, "magnification_msb": False},
    }
    rig = opened(keys=keys)
    rig.poll(1.0)
    assert rig.motions()[1:] == ["ff01005f0064c4", "ff01002b00022e", "ff010033000135"]
