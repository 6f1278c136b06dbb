"""What passes over an emulated line and when, its faults, and the settings it refuses; in simulated time."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from camrig.errors import InputError
from camrig_emulators.pelco_d_bench import Bench
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine
from tests.head_on_bench import LEFT, RIGHT, STOP, head, read_raw, truth_deg

# --- the line -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("baud", "frame_s"), [(2400, 0.0291667), (9600, 0.0072917)])
def test_a_query_and_its_answer_take_their_time_on_the_wire(baud: int, frame_s: float) -> None:
    bench = Bench(head(baud=baud, reply_latency_s=0.01))
    bench.send(1, 0x51)
    ((stamp_s, reply),) = bench.run(1.0)
    assert len(reply) == 7
    assert stamp_s == pytest.approx(2.0 * frame_s + 0.01, abs=1e-6)
    assert bench.line.received[0][0] == pytest.approx(frame_s, abs=1e-6)


def test_a_command_counts_from_its_last_byte_and_queues_behind_what_was_written_before() -> None:
    bench = Bench(head(baud=2400, start_latency_s=0.0))
    for _ in range(10):
        bench.send(1, STOP)
    bench.send(1, LEFT, 0x3F00)
    bench.wait(11 * 70 / 2400)
    assert truth_deg(bench)[0] == 0.0
    bench.wait(0.1)
    assert truth_deg(bench)[0] > 0.0


def test_other_addresses_are_heard_on_the_line_and_ignored_by_the_head() -> None:
    bench = Bench(head())
    bench.send(2, LEFT, 0x3F00)
    assert bench.ask(2, 0x51) == b""
    assert truth_deg(bench) == (0.0, 0.0)
    assert [frame[1] for _, frame in bench.line.received] == [2, 2]


def test_two_heads_share_a_line() -> None:
    bench = Bench(head("a", address=1), head("b", address=2, start_pan_deg=10.0))
    bench.send(2, 0x4B, 4500)
    bench.wait(5.0)
    assert (read_raw(bench, 0x51, address=1), read_raw(bench, 0x51, address=2)) == (0, 4500)
    assert truth_deg(bench, "a") == (0.0, 0.0)


def test_heads_with_one_address_collide_into_noise() -> None:
    bench = Bench(head("a"), head("b", start_pan_deg=10.0))
    reply = bench.ask(1, 0x51)
    assert len(reply) == 14
    assert bytes.fromhex("ff010059") not in reply


@pytest.mark.parametrize(
    ("answers", "to_motion", "to_query", "to_dummy"),
    [("none", 0, 0, 0), ("general", 4, 4, 4), ("queries", 0, 7, 0), ("full", 4, 7, 4)],
)
def test_what_is_answered(answers: str, to_motion: int, to_query: int, to_dummy: int) -> None:
    bench = Bench(head(answers=answers))
    assert len(bench.ask(1, 0x4B)) == to_motion
    assert len(bench.ask(1, 0x51)) == to_query
    assert len(bench.ask(1, 0x0D)) == to_dummy


def test_a_general_answer_sums_the_command() -> None:
    bench = Bench(head(answers="full"))
    bench.send(1, RIGHT, 0x3F00)
    assert bench.wait(0.1).hex() == "ff010042"


def test_opcode_45_is_answered_whatever_the_address() -> None:
    bench = Bench(head(address=9))
    assert [len(bench.ask(address, 0x45)) for address in (9, 1)] == [18, 18]


def test_commands_without_the_gap_go_unheard() -> None:
    bench = Bench(head(min_gap_s=0.05))
    bench.send(1, LEFT, 0x3F00)
    bench.send(1, STOP)
    bench.wait(1.0)
    assert truth_deg(bench)[0] > 0.0
    bench.send(1, STOP)
    bench.wait(1.0)
    rest = truth_deg(bench)
    bench.wait(5.0)
    assert truth_deg(bench) == rest


def test_another_baud_is_noise_both_ways() -> None:
    bench = Bench(head())
    query = bytes.fromhex("ff010051000052")
    bench.write(query, baud=2400)
    bench.wait(1.0)
    assert bench.line.received == []
    bench.write(query)
    ((_, noise),) = bench.run(1.0, baud=2400)
    assert len(noise) == 7
    assert noise[:4] != query[:4]


# --- faults ---------------------------------------------------------------------------------------------------


def test_silence_of_the_line_and_of_one_head() -> None:
    bench = Bench(head("a", address=1), head("b", address=2))
    bench.line.head_faults["a"].silent = True
    assert [len(bench.ask(address, 0x51)) for address in (1, 2)] == [0, 7]
    bench.line.faults.silent = True
    assert [len(bench.ask(address, 0x51)) for address in (1, 2)] == [0, 0]
    bench.line.faults.clear()
    bench.line.head_faults["a"].clear()
    assert [len(bench.ask(address, 0x51)) for address in (1, 2)] == [7, 7]


def test_a_silent_head_still_obeys() -> None:
    bench = Bench(head())
    bench.line.faults.silent = True
    bench.send(1, 0x4B, 3000)
    bench.wait(5.0)
    assert truth_deg(bench)[0] == pytest.approx(-30.0)


def test_frozen_read_back_stands_still_while_the_head_moves() -> None:
    bench = Bench(head())
    assert read_raw(bench, 0x51) == 0
    bench.line.faults.freeze = True
    bench.send(1, 0x4B, 3000)
    bench.wait(5.0)
    assert read_raw(bench, 0x51) == 0
    bench.line.faults.freeze = False
    assert read_raw(bench, 0x51) == 3000


def test_dropped_commands_are_on_the_wire_and_without_effect() -> None:
    bench = Bench(head())
    bench.line.faults.drop_next(2)
    assert [len(bench.ask(1, 0x51)) for _ in range(3)] == [0, 0, 7]
    assert len(bench.line.received) == 3


def test_latency_delays_answers_and_echo_comes_before_them() -> None:
    bench = Bench(head(reply_latency_s=0.01))
    bench.line.faults.latency_s = 0.1
    bench.line.faults.echo = True
    bench.send(1, 0x51)
    (echo_s, echo), (reply_s, reply) = bench.run(1.0)
    assert echo.hex() == "ff010051000052"
    assert echo_s == pytest.approx(70 / 9600)
    assert len(reply) == 7
    assert reply_s == pytest.approx(140 / 9600 + 0.11)


@pytest.mark.parametrize(("last", "first", "expected"), [(3, 0, "ff010059"), (0, 2, "005900005a"), (9, 0, "")])
def test_answers_are_cut(last: int, first: int, expected: str) -> None:
    bench = Bench(head())
    bench.line.faults.truncate_reply(last, first)
    assert bench.ask(1, 0x51).hex() == expected


def test_an_answer_that_lost_its_beginning_ends_when_it_would_have() -> None:
    bench = Bench(head(reply_latency_s=0.01))
    bench.line.faults.truncate_reply(0, first=2)
    bench.send(1, 0x51)
    ((stamp_s, reply),) = bench.run(1.0)
    assert len(reply) == 5
    assert stamp_s == pytest.approx(140 / 9600 + 0.01)


def test_a_garbled_line_spoils_most_exchanges_and_recovers() -> None:
    bench = Bench(head(), seed=3)
    bench.line.faults.garble(0.3)
    replies = [bench.ask(1, 0x51) for _ in range(50)]
    assert sum(reply == bytes.fromhex("ff01005900005a") for reply in replies) < 10
    bench.line.faults.garble(0.0)
    assert bench.ask(1, 0x51) == bytes.fromhex("ff01005900005a")


def test_what_is_under_way_is_lost_with_the_port_and_motion_goes_on() -> None:
    bench = Bench(head())
    bench.send(1, LEFT, 0x1000)
    bench.wait(1.0)
    bench.send(1, STOP)
    bench.line.cut()
    before = truth_deg(bench)[0]
    bench.wait(1.0)
    assert truth_deg(bench)[0] == pytest.approx(before + 40.0 * 16 / 63)
    assert bench.line.next_s() is None


# --- settings -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"address": 0}, "address"),
        ({"address": 255}, "address"),
        ({"baud": 1200}, "baud"),
        ({"start_pan_deg": 171.0}, "outside pan_limits_deg"),
        ({"start_tilt_deg": 21.0}, "outside tilt_limits_deg"),
        ({"speed": 3}, "speed"),
        ({"max_speed_deg_s": math.nan}, "max_speed_deg_s"),
    ],
)
def test_impossible_heads_are_refused(changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PelcoDHeadSettings.model_validate({"id": "head", **changed})


def test_heads_that_clash_on_a_line_are_refused() -> None:
    with pytest.raises(InputError, match="one baud"):
        PelcoDLine([head("a"), head("b", baud=2400)])
    with pytest.raises(InputError, match="ids of their own"):
        PelcoDLine([head("a"), head("a", address=2)])
