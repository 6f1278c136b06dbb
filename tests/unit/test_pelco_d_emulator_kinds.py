"""Heads differ: each way in which an emulated one can be unlike the others."""

import math

import pytest

from camrig_emulators.pelco_d_bench import Bench
from tests.head_on_bench import DOWN, LEFT, RIGHT, STOP, head, read_raw, truth_deg

FULL = 0x3F00


def turned_deg(bench: Bench, bits: int, value: int, seconds: float = 2.0) -> float:
    before = truth_deg(bench)
    bench.send(1, bits, value)
    bench.wait(seconds)
    after = truth_deg(bench)
    return max(abs(a - b) for a, b in zip(after, before, strict=True))


def test_broadcasts_and_domes_that_obey_every_address() -> None:
    for hears_zero, hears_all, address, obeys in (
        (False, False, 0, False),
        (True, False, 0, True),
        (True, False, 7, False),
        (False, True, 7, True),
    ):
        bench = Bench(head(hears_zero=hears_zero, hears_all=hears_all))
        bench.send(address, RIGHT, FULL)
        bench.wait(1.0)
        assert (truth_deg(bench)[0] != 0.0) is obeys


def test_speed_0_with_a_direction_stops_or_creeps() -> None:
    assert turned_deg(Bench(head()), LEFT, 0) == 0.0
    assert turned_deg(Bench(head(speed_zero="creep", start_latency_s=0.0)), LEFT, 0) == pytest.approx(
        80.0 / 65.0, abs=0.01
    )


@pytest.mark.parametrize(
    ("turbo_byte", "byte", "speed_deg_s"), [(0x40, 0x40, 150), (0xFF, 0xFF, 150), (None, 0xFF, 40)]
)
def test_turbo_is_40_or_ff_or_none(turbo_byte: int | None, byte: int, speed_deg_s: float) -> None:
    bench = Bench(head(turbo_byte=turbo_byte, pan_limits_deg=None, acceleration_deg_s2=1e6, start_latency_s=0.0))
    assert turned_deg(bench, LEFT, byte << 8, 1.0) == pytest.approx(speed_deg_s, rel=0.02)


def test_curves_of_speed_and_bytes_that_turn_nothing() -> None:
    turned = [turned_deg(Bench(head(speed_curve=curve)), LEFT, 0x2000) for curve in ("linear", "geometric", "bell")]
    assert turned[0] > 5.0 * turned[1] > 0.0
    assert turned[0] > 5.0 * turned[2] > 0.0
    assert turned_deg(Bench(head(dead_bytes=20)), LEFT, 0x1400) == 0.0


def test_zoom_slows_jogs_and_takes_time() -> None:
    bench = Bench(head(zoom_slows=0.9, zoom_limit=0x8540, zoom_s=3.0))
    bench.send(1, 0x4F, 0xFFFF)
    bench.wait(1.5)
    assert 0x3000 < read_raw(bench, 0x55) < 0x8540
    bench.wait(3.0)
    assert read_raw(bench, 0x55) == 0x8540
    assert turned_deg(bench, LEFT, FULL) < 10.0


def test_5f_is_magnification_or_focus() -> None:
    bench = Bench(head())
    bench.send(1, 0x5F, 500)
    bench.wait(5.0)
    assert read_raw(bench, 0x61) == pytest.approx(500, abs=1)
    bench = Bench(head(opcode_5f="focus"))
    bench.send(1, 0x5F, 500)
    assert read_raw(bench, 0x61) == 500
    assert read_raw(bench, 0x55) == 0


def test_a_stray_bit_switches_the_camera_off() -> None:
    bench = Bench(head())
    device = bench.line._bus.heads["head"]
    bench.send(1, LEFT, 0x1000, command1=0x08)
    bench.wait(0.2)
    assert not device.camera_on
    bench.send(1, STOP, command1=0x88)
    bench.wait(0.2)
    assert device.camera_on


def test_it_may_overshoot_and_stop_a_little_off() -> None:
    bench = Bench(head(overshoot_deg=1.0, stop_error_deg=0.2), seed=3)
    bench.send(1, 0x4B, 3000)
    furthest = 0.0
    for _ in range(60):
        bench.wait(0.05)
        furthest = min(furthest, truth_deg(bench)[0])
    assert furthest < -30.7
    assert 0.0 < abs(truth_deg(bench)[0] + 30.0) <= 0.2


def test_lost_steps_worm_and_a_shift_at_reset_are_in_the_truth_alone() -> None:
    bench = Bench(head(stall_loss_deg=0.5, worm_error_deg=0.1, worm_period_deg=4.0, pan_limits_deg=(-10.0, 10.0)))
    bench.send(1, RIGHT, FULL)
    bench.wait(3.0)
    bench.send(1, 0x4B, 100)
    bench.wait(3.0)
    assert read_raw(bench, 0x51) == 100
    assert truth_deg(bench)[0] == pytest.approx(-1.0 + 0.5 - 0.1 * math.sin(math.tau / 4.0), abs=1e-6)
    bench = Bench(head(reset_s=1.0, reset_shift_deg=0.7))
    bench.send(1, 0x0F)
    bench.wait(2.0)
    assert read_raw(bench, 0x51) == 0
    assert truth_deg(bench)[0] == pytest.approx(0.7)


@pytest.mark.parametrize(("reports", "moving", "resting"), [("target", 9000, 9000), ("frozen", 0, 9000)])
def test_it_may_report_its_target_or_where_it_last_stood(reports: str, moving: int, resting: int) -> None:
    bench = Bench(head(reports=reports))
    bench.send(1, 0x4B, 9000)
    bench.wait(0.5)
    assert read_raw(bench, 0x51) == moving
    bench.wait(5.0)
    assert read_raw(bench, 0x51) == resting


def test_old_positions_36000_for_0_and_no_negative_ones() -> None:
    assert read_raw(Bench(head(full_turn_as_36000=True)), 0x51) == 36000
    assert read_raw(Bench(head(wraps=False, start_tilt_deg=10.0)), 0x53) == 0
    bench = Bench(head(update_s=0.5))
    bench.send(1, LEFT, FULL)
    bench.wait(0.6)
    assert len({read_raw_now(bench) for _ in range(4)}) <= 2


def read_raw_now(bench: Bench) -> int:
    reply = bench.ask(1, 0x51, within_s=0.05)
    return reply[4] << 8 | reply[5]


@pytest.mark.parametrize(
    ("absolute", "pan", "tilt"),
    [
        ("both", True, True),
        ("pan", True, False),
        ("tilt", False, True),
        ("ignored", False, False),
        ("race", False, True),
    ],
)
def test_positions_may_be_taken_by_one_axis_by_none_or_in_a_race(absolute: str, pan: bool, tilt: bool) -> None:
    bench = Bench(head(absolute=absolute))
    bench.send(1, 0x4B, 9000)
    bench.wait(0.3)
    bench.send(1, 0x4D, 4500)
    bench.wait(5.0)
    pan_deg, tilt_deg = truth_deg(bench)
    assert (pan_deg == pytest.approx(-90.0), tilt_deg == pytest.approx(-45.0)) == (pan, tilt)


def test_beyond_straight_down_it_may_flip() -> None:
    bench = Bench(head(auto_flip=True, pan_limits_deg=None))
    bench.send(1, 0x4D, 12000)
    bench.wait(8.0)
    assert (read_raw(bench, 0x51), read_raw(bench, 0x53)) == (18000, 6000)


def test_a_pan_without_stops_may_never_go_through_0() -> None:
    bench = Bench(head(pan_limits_deg=None, pan_travel="direct"))
    bench.send(1, 0x4B, 35000)
    bench.wait(1.0)
    assert truth_deg(bench)[0] < -20.0, "the long way round"


def test_own_sums_and_alarms() -> None:
    bench = Bench(head(answers="full", own_sum=True), script="at 0 alarm 3")
    assert bench.ask(1, 0x0D).hex() == "ff010405"
    bench.send(1, 0x19, 3)
    bench.wait(0.2)
    assert bench.ask(1, 0x0D).hex() == "ff010001"


def test_while_it_answers_a_half_duplex_head_is_deaf() -> None:
    for half_duplex, moved in ((True, False), (False, True)):
        bench = Bench(head(half_duplex=half_duplex, turn_around_s=0.01))
        bench.send(1, 0x51)
        bench.wait(0.020)  # the question is over, the answer under way
        bench.send(1, DOWN, 0x003F)
        bench.wait(1.0)
        assert (truth_deg(bench)[1] != 0.0) is moved


def test_echoes_splits_bursts_lost_and_inserted_bytes_and_swapped_wires() -> None:
    query, answer = "ff010051000052", "ff01005900005a"
    for script, heard in (
        ("at 0 echo", query + answer),
        ("at 0 echo; at 0 echo_bytes 3", query[:6] + answer),
        ("at 0 echo; at 0 echo_delay 0.1", answer + query),
        ("at 0 splits", answer),
    ):
        bench = Bench(head(), script=script)
        bench.wait(0.01)
        assert bench.ask(1, 0x51).hex() == heard
    assert Bench(head(), script="at 0 bursts 1").ask(1, 0x51).hex().endswith(answer)
    assert len(Bench(head(lost_first=2)).ask(1, 0x51)) == 5
    assert Bench(head(), script="at 0 lose 1").ask(1, 0x51) == b""
    assert Bench(head(), script="at 0 swapped").ask(1, 0x51) == b""
