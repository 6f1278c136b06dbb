"""The emulated axis: trapezoids in closed form, limits, latency, play."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_emulators.pelco_d_motion import AxisMotion, follow, phases

SPEED, ACCELERATION = 40.0, 160.0
LIMITS = (-170.0, 170.0)

Order = tuple[float, tuple[str, float]]

angles = st.floats(*LIMITS)
speeds = st.floats(-SPEED, SPEED)
commands = st.lists(
    st.tuples(
        st.floats(0.0, 3.0),  # seconds after the command before
        st.one_of(
            angles.map(lambda target: ("go_to", target)),
            speeds.map(lambda speed: ("jog", speed)),
            st.just(("stop", 0.0)),
        ),
    ),
    min_size=1,
    max_size=12,
)


def axis(start: float = 0.0, **changed: float) -> AxisMotion:
    return AxisMotion(start, limits=LIMITS, speed=SPEED, acceleration=ACCELERATION, **changed)


def command(motion: AxisMotion, kind: str, value: float, at_s: float) -> None:
    match kind:
        case "go_to":
            motion.go_to(value, at_s)
        case "jog":
            motion.jog(value, at_s)
        case _:
            motion.stop(at_s)


def test_a_long_move_takes_distance_over_speed_plus_one_ramp() -> None:
    motion = axis()
    motion.go_to(100.0, at_s=1.0)
    arrival_s = 1.0 + 100.0 / SPEED + SPEED / ACCELERATION
    assert motion.motor(arrival_s) == 100.0
    assert motion.motor(arrival_s - 0.01) < 100.0
    assert motion.speed(2.0) == SPEED


def test_a_short_move_never_reaches_full_speed() -> None:
    motion = axis()
    motion.go_to(4.0, at_s=0.0)
    peak = math.sqrt(ACCELERATION * 4.0)
    assert motion.speed(peak / ACCELERATION) == pytest.approx(peak)
    assert motion.motor(2.0 * peak / ACCELERATION) == 4.0


def test_a_target_behind_is_braked_for_and_returned_to() -> None:
    motion = axis()
    motion.go_to(100.0, at_s=0.0)
    motion.go_to(10.0, at_s=1.0)
    turn_s = 1.0 + SPEED / ACCELERATION
    assert motion.speed(turn_s) == pytest.approx(0.0, abs=1e-9)
    assert motion.motor(turn_s) > motion.motor(1.0) > 10.0
    assert motion.motor(10.0) == 10.0


@given(angles, commands)
def test_speed_acceleration_and_limits_hold_whatever_is_commanded(start: float, orders: list[Order]) -> None:
    motion = axis(start)
    now_s = 0.0
    for pause_s, (kind, value) in orders:
        now_s += pause_s
        command(motion, kind, value, now_s)
    stamps_s = np.arange(0.0, now_s + 12.0, 0.01)
    positions = np.array([motion.motor(stamp_s) for stamp_s in stamps_s])
    velocities = np.array([motion.speed(stamp_s) for stamp_s in stamps_s])
    assert (np.abs(velocities) <= SPEED + 1e-6).all()
    assert (np.abs(np.diff(velocities)) <= ACCELERATION * 0.01 + 1e-6).all()
    assert (np.abs(np.diff(positions)) <= SPEED * 0.01 + 1e-6).all()
    assert ((positions >= LIMITS[0] - 1e-6) & (positions <= LIMITS[1] + 1e-6)).all()
    mean_speeds = (velocities[1:] + velocities[:-1]) / 2.0
    assert np.abs(np.diff(positions) - mean_speeds * 0.01).max() <= ACCELERATION * 0.01**2


@given(angles, commands)
def test_the_last_command_decides_where_it_rests(start: float, orders: list[Order]) -> None:
    motion = axis(start)
    now_s = 0.0
    for pause_s, (kind, value) in orders:
        now_s += pause_s
        command(motion, kind, value, now_s)
    motion.go_to(12.5, now_s + 0.1)
    rest_s = now_s + 0.1 + 340.0 / SPEED + 3.0 * SPEED / ACCELERATION
    assert motion.motor(rest_s) == 12.5
    assert motion.at_rest(rest_s)


@given(angles, commands)
def test_a_command_never_changes_the_past(start: float, orders: list[Order]) -> None:
    motion = axis(start, play=0.3)
    now_s = 0.0
    for pause_s, (kind, value) in orders:
        now_s += pause_s
        stamps_s = np.linspace(0.0, now_s, 50)
        before = [(motion.motor(stamp_s), motion.load(stamp_s)) for stamp_s in stamps_s]
        command(motion, kind, value, now_s)
        after = [(motion.motor(stamp_s), motion.load(stamp_s)) for stamp_s in stamps_s]
        np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-9)


@given(st.floats(-500.0, 500.0), st.floats(-90.0, 90.0), st.floats(0.1, 60.0), st.floats(1.0, 400.0))
def test_phases_travel_the_distance_and_end_at_rest(
    distance: float, speed: float, cruise: float, acceleration: float
) -> None:
    travelled, velocity = 0.0, speed
    for phase_acceleration, duration_s in phases(distance, speed, cruise, acceleration):
        assert abs(phase_acceleration) in {0.0, acceleration}
        travelled += velocity * duration_s + phase_acceleration * duration_s**2 / 2.0
        velocity += phase_acceleration * duration_s
    assert travelled == pytest.approx(distance, abs=1e-6)
    assert velocity == pytest.approx(0.0, abs=1e-6)


def test_a_jog_ends_at_the_limit_without_touching_it_at_speed() -> None:
    motion = axis(160.0)
    motion.jog(20.0, at_s=0.0)
    assert motion.speed(0.3) == 20.0
    assert motion.motor(5.0) == LIMITS[1]
    assert motion.at_rest(5.0)


def test_an_axis_without_limits_turns_for_ever() -> None:
    motion = AxisMotion(0.0, limits=None, speed=SPEED, acceleration=ACCELERATION)
    motion.jog(-10.0, at_s=0.0)
    assert motion.speed(3600.0) == -10.0


def test_motion_starts_after_the_latency_but_goes_on_without() -> None:
    motion = axis(start_latency_s=0.05)
    motion.jog(20.0, at_s=1.0)
    assert motion.motor(1.05) == 0.0
    assert motion.motor(1.06) > 0.0
    motion.jog(40.0, at_s=2.0)
    assert motion.speed(2.01) > 20.0


def test_a_start_that_is_pending_is_replaced_not_put_off_and_stop_takes_it_back() -> None:
    motion = axis(start_latency_s=0.05)
    motion.jog(20.0, at_s=1.0)
    motion.jog(-20.0, at_s=1.04)
    assert motion.speed(1.06) < 0.0
    motion.stop(at_s=1.5)
    rest = motion.motor(3.0)
    motion.go_to(50.0, at_s=3.0)
    motion.stop(at_s=3.01)
    assert motion.motor(10.0) == rest


@given(st.lists(angles, min_size=1, max_size=8), st.floats(0.0, 5.0))
def test_the_load_is_the_hysteresis_of_the_motor(targets: list[float], play: float) -> None:
    motion = axis(play=play)
    now_s, load = 0.0, 0.0
    for target in targets:
        motion.go_to(target, now_s)
        for _ in range(int(10.0 / 0.02)):  # a fine step of the definition, against the closed form
            now_s += 0.02
            load = follow(load, motion.motor(now_s), play)
            assert motion.load(now_s) == pytest.approx(load, abs=1e-9)


def test_backlash_lags_half_the_play_on_either_side() -> None:
    motion = axis(play=0.4)
    motion.go_to(30.0, at_s=0.0)
    assert motion.load(5.0) == pytest.approx(29.8)
    motion.go_to(29.7, at_s=5.0)
    assert motion.load(10.0) == pytest.approx(29.8)  # still within the play
    motion.go_to(10.0, at_s=10.0)
    assert motion.load(20.0) == pytest.approx(10.2)


def test_what_is_forgotten_is_refused_not_invented() -> None:
    motion = axis(history_s=10.0)
    for second in range(40):
        motion.go_to(float(second % 2), at_s=float(second))
    assert motion.motor(30.5) >= 0.0
    with pytest.raises(ValueError, match="older than"):
        motion.motor(5.0)
