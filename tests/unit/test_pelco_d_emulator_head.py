"""What an emulated head does when told, and what it reports; stepped in simulated time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_emulators.pelco_d_bench import Bench
from tests.head_on_bench import DOWN, LEFT, RIGHT, STOP, UP, head, read_raw, truth_deg

# --- motion ---------------------------------------------------------------------------------------------------


def test_nothing_moves_unasked_and_queries_move_nothing() -> None:
    bench = Bench(head(start_pan_deg=30.0, start_tilt_deg=-45.0))
    assert (read_raw(bench, 0x51), read_raw(bench, 0x53)) == (33000, 4500)  # counts clockwise and down
    bench.wait(100.0)
    assert truth_deg(bench) == pytest.approx((30.0, -45.0))


def test_absolute_moves_of_the_two_axes_do_not_disturb_each_other() -> None:
    bench = Bench(head())
    bench.send(1, 0x4B, 36000 - 9000)
    bench.send(1, 0x4D, 3000)
    bench.wait(10.0)
    assert truth_deg(bench) == pytest.approx((90.0, -30.0))


@pytest.mark.parametrize(
    ("bits", "pan", "tilt"), [(RIGHT, -1, 0), (LEFT, 1, 0), (UP, 0, 1), (DOWN, 0, -1), (LEFT | DOWN, 1, -1)]
)
def test_a_jog_goes_on_until_stop_and_idle_speed_bytes_do_not_matter(bits: int, pan: int, tilt: int) -> None:
    bench = Bench(head(start_latency_s=0.0, tilt_limits_deg=(-90.0, 90.0)))
    bench.send(1, bits, 0x1F1F)
    bench.wait(3.0)
    bench.send(1, STOP)
    bench.wait(60.0)
    travel_deg = 3.0 * 40.0 * 31 / 63  # braking gives back what the start took
    assert truth_deg(bench) == pytest.approx((pan * travel_deg, tilt * travel_deg))


def test_a_jog_stops_at_the_limit() -> None:
    bench = Bench(head())
    bench.send(1, DOWN, 0x003F)
    bench.wait(20.0)
    assert truth_deg(bench) == (0.0, -90.0)


def test_a_standard_command_aborts_moves_to_a_position() -> None:
    bench = Bench(head())
    bench.send(1, 0x4B, 9000)
    bench.send(1, 0x4D, 9000)
    bench.wait(0.5)
    bench.send(1, STOP)
    bench.wait(1.0)
    rest = truth_deg(bench)
    bench.wait(10.0)
    assert truth_deg(bench) == rest
    assert -90.0 < rest[0] < 0.0
    assert -90.0 < rest[1] < 0.0


def test_speed_0_with_a_direction_does_not_move() -> None:
    bench = Bench(head())
    bench.send(1, RIGHT, 0x0000)
    bench.wait(5.0)
    assert truth_deg(bench) == (0.0, 0.0)


def test_the_dead_man_ends_a_jog_that_is_not_repeated() -> None:
    bench = Bench(head(dead_man_s=1.0, start_latency_s=0.0, pan_limits_deg=None))
    for _ in range(4):
        bench.send(1, LEFT, 0x3F00)
        bench.wait(0.9)
    moving = truth_deg(bench)[0]
    bench.wait(5.0)
    rest = truth_deg(bench)[0]
    assert moving > 3.0 * 40.0
    assert rest == pytest.approx(moving + 0.1 * 40.0 + 5.0, abs=0.5)  # what was left of the second, and the ramp


@pytest.mark.parametrize(("behaviour", "expected_deg"), [("clamp", 170.0), ("ignore", 0.0)])
def test_a_target_outside_the_limits(behaviour: str, expected_deg: float) -> None:
    bench = Bench(head(out_of_range=behaviour))
    bench.send(1, 0x4B, 36000 - 17500)
    bench.wait(20.0)
    assert truth_deg(bench)[0] == pytest.approx(expected_deg)


def test_a_head_with_stops_goes_the_long_way_round_and_one_without_the_short() -> None:
    for limits, expected_deg in (((-170.0, 170.0), -160.0), (None, 200.0)):
        bench = Bench(head(start_pan_deg=160.0, pan_limits_deg=limits))
        bench.send(1, 0x4B, 16000)  # clockwise 160
        bench.wait(20.0)
        assert truth_deg(bench)[0] == pytest.approx(expected_deg)
        assert read_raw(bench, 0x51) == 16000


def test_set_zero_renames_the_present_angle_and_turns_nothing() -> None:
    bench = Bench(head(start_pan_deg=30.0))
    bench.send(1, 0x49)
    assert read_raw(bench, 0x51) == 0
    bench.send(1, 0x4B, 36000 - 1000)
    bench.wait(5.0)
    assert truth_deg(bench)[0] == pytest.approx(40.0)


def test_presets_are_kept_called_and_cleared_and_34_is_pan_zero() -> None:
    bench = Bench(head(start_pan_deg=30.0, start_tilt_deg=-20.0))
    bench.send(1, 0x03, 7)
    bench.send(1, 0x4B, 0)
    bench.send(1, 0x4D, 0)
    bench.wait(5.0)
    bench.send(1, 0x07, 7)
    bench.wait(5.0)
    assert truth_deg(bench) == pytest.approx((30.0, -20.0))
    bench.send(1, 0x07, 34)
    bench.wait(5.0)
    assert truth_deg(bench) == pytest.approx((0.0, -20.0))
    bench.send(1, 0x05, 7)
    bench.send(1, 0x07, 7)
    bench.wait(5.0)
    assert truth_deg(bench) == pytest.approx((0.0, -20.0))


def test_a_reset_stops_and_deafens() -> None:
    bench = Bench(head(reset_s=2.0))
    bench.send(1, LEFT, 0x2000)
    bench.wait(1.0)
    bench.send(1, 0x0F)
    bench.wait(1.0)
    rest = truth_deg(bench)
    bench.send(1, LEFT, 0x2000)
    assert bench.ask(1, 0x51) == b""
    assert truth_deg(bench) == rest
    bench.wait(3.0)
    assert truth_deg(bench) == (0.0, 0.0), "awake again it drives home"
    assert len(bench.ask(1, 0x51)) == 7


# --- what is reported, and what is true -----------------------------------------------------------------------


def test_backlash_and_zero_error_are_in_the_truth_and_not_in_the_read_back() -> None:
    bench = Bench(head(backlash_deg=0.4, zero_error_deg=(0.1, -0.05)))
    for raw, play_deg in ((36000 - 3000, -0.2), (36000 - 6000, -0.2), (36000 - 3000, 0.2)):
        bench.send(1, 0x4B, raw)
        bench.wait(5.0)
        assert read_raw(bench, 0x51) == raw
        assert truth_deg(bench)[0] == pytest.approx((36000 - raw) / 100.0 + play_deg + 0.1)
    assert truth_deg(bench)[1] == pytest.approx(-0.05)


@given(
    st.sampled_from([-1, 1]),
    st.floats(0.5, 1.5),
    st.floats(-90.0, 90.0),
    st.floats(-170.0, 170.0),
)
def test_the_map_to_raw_and_back_is_that_of_the_settings(
    sign: int, scale: float, offset_deg: float, target_deg: float
) -> None:
    axes = {"pan": {"sign": sign, "scale": scale, "offset_deg": offset_deg}}
    bench = Bench(head(axes=axes, pan_limits_deg=(-180.0 * scale, 180.0 * scale)))
    wanted_raw = round((target_deg * scale - offset_deg) / (sign * scale) * 100.0) % 36000
    bench.send(1, 0x4B, wanted_raw)
    bench.wait(30.0)
    raw = read_raw(bench, 0x51)
    raw_deg = math.remainder(raw / 100.0, 360.0)
    turns = math.remainder(sign * scale * raw_deg + offset_deg - truth_deg(bench)[0], 360.0 * scale)
    assert turns == pytest.approx(0.0, abs=0.01 * scale)
    assert math.remainder(raw - wanted_raw, 36000) == pytest.approx(0.0, abs=1.0)


def test_read_back_is_quantised() -> None:
    bench = Bench(head(start_pan_deg=-12.34, readback_step_deg=0.1))
    assert read_raw(bench, 0x51) == 1230


def test_minus_nothing_reads_as_0_not_36000() -> None:
    assert read_raw(Bench(head(start_pan_deg=0.004)), 0x51) == 0


@pytest.mark.parametrize("fraction", [0.0, 0.25, 1.0])
def test_the_angle_is_sampled_between_the_query_and_the_answer(fraction: float) -> None:
    bench = Bench(head(sample_fraction=fraction, reply_latency_s=0.02, pan_limits_deg=None))
    bench.send(1, RIGHT, 0x3F00)
    bench.wait(2.0)
    query_end_s = bench.now_s + 70 / 9600
    raw = read_raw(bench, 0x51)
    pan_rad, _ = bench.line.true_angles_rad("head", query_end_s + fraction * 0.02)
    assert raw == round(-math.degrees(pan_rad) * 100.0)


def test_without_a_fraction_the_instant_varies_within_the_window_and_with_the_seed_alone() -> None:
    def raws(seed: int) -> list[int]:
        bench = Bench(head(pan_limits_deg=None), seed=seed)
        bench.send(1, RIGHT, 0x3F00)
        bench.wait(2.0)
        return [read_raw(bench, 0x51) for _ in range(20)]

    assert raws(1) == raws(1) != raws(2)
    steps = [math.remainder(b - a, 36000) for a, b in zip(raws(1), raws(1)[1:], strict=False)]
    assert all(abs(step - 2000) <= 40 for step in steps)  # 0.5 s at 40 deg/s, +- 10 ms of sampling
    assert len(set(steps)) > 5
