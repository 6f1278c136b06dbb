"""The emulated head's own codec, against vectors that neither side wrote."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_emulators.pelco_d_wire import (
    Command,
    CommandParser,
    checksum,
    extended_reply,
    general_reply,
    query_reply,
)

BYTE_S = 10 / 9600
bodies = st.tuples(st.integers(0, 254), st.binary(min_size=4, max_size=4)).map(
    lambda parts: bytes((parts[0], *parts[1]))
)
frames = bodies.map(lambda body: bytes((0xFF, *body, checksum(body))))


def parse(data: bytes, parser: CommandParser | None = None, start_s: float = 0.0) -> list[Command]:
    parser = parser or CommandParser()
    found = []
    for number, byte in enumerate(data):
        found.append(parser.feed(byte, start_s + number * BYTE_S, start_s + (number + 1) * BYTE_S))
    return [command for command in found if command is not None]


def test_a_command_is_stamped_with_its_first_and_last_bit() -> None:
    (command,) = parse(bytes.fromhex("ff01004b0bb80f"), start_s=2.0)
    assert (command.address, command.opcode, command.value) == (1, 0x4B, 3000)
    assert command.start_s == pytest.approx(2.0)
    assert command.end_s == pytest.approx(2.0 + 7 * BYTE_S)


@given(st.lists(frames, min_size=1, max_size=5))
def test_commands_back_to_back_are_all_heard(sent: list[bytes]) -> None:
    assert [command.raw for command in parse(b"".join(sent))] == sent


@given(st.binary(max_size=40), frames)
def test_after_a_pause_garbage_does_no_harm(garbage: bytes, frame: bytes) -> None:
    parser = CommandParser()
    parse(garbage, parser)
    assert [command.raw for command in parse(frame, parser, start_s=1.0)] == [frame]


@given(st.binary(max_size=40))
def test_garbage_never_raises_and_only_correct_sums_come_out(garbage: bytes) -> None:
    for command in parse(garbage):
        assert command.raw[0] == 0xFF
        assert sum(command.raw[1:6]) & 0xFF == command.checksum
        assert command.raw in garbage


@pytest.mark.parametrize(
    "garbage",
    ["ff", "ffff", "ff01", "ff01004b", "0059814a25", "ff010051000000", "00112233445566"],
)
def test_the_next_command_is_found_in_the_same_stream(garbage: str) -> None:
    stop, query = bytes.fromhex("ff010000000001"), bytes.fromhex("ff010051000052")
    assert [command.raw for command in parse(bytes.fromhex(garbage) + stop + query)] == [stop, query]


def test_half_a_command_is_forgotten_after_the_byte_timeout() -> None:
    parser = CommandParser(byte_timeout_s=0.05)
    stop = bytes.fromhex("ff010000000001")
    assert not parse(stop[:4], parser)
    assert not parse(stop[4:], parser, start_s=1.0)
    assert parser.missing == 7


@pytest.mark.parametrize(
    ("reply", "expected"),
    [
        (extended_reply(1, 0x59, 33098), "ff010059814a25"),
        (extended_reply(1, 0x5B, 4567), "ff01005b11d744"),
        (extended_reply(1, 0x5D, 1200), "ff01005d04b012"),
        (general_reply(1, 0x63, alarms=0x45), "ff0145a8"),
        (general_reply(1, 0x42), "ff010042"),
    ],
)
def test_replies_equal_published_ones(reply: bytes, expected: str) -> None:
    assert reply.hex() == expected


def test_a_query_reply_has_18_bytes_and_sums_the_command_too() -> None:
    reply = query_reply(1, 0x46, b"AB")
    assert len(reply) == 18
    assert reply[:4] == b"\xff\x01AB"
    assert reply[17] == (0x46 + 1 + ord("A") + ord("B")) & 0xFF


def test_every_published_command_is_heard(shared_data: Path) -> None:
    vectors = json.loads((shared_data / "pelco_d_vectors.json").read_text())
    sent = [bytes.fromhex(vector["hex"]) for vector in vectors["commands"]]
    assert len(sent) == 108
    for frame, vector in zip(sent, vectors["commands"], strict=True):
        (command,) = parse(frame)
        assert command.raw == frame
        assert command.address == vector["params"].get("address", command.address)


def test_published_framing_traps_are_no_commands_or_the_right_one(shared_data: Path) -> None:
    traps = json.loads((shared_data / "pelco_d_vectors.json").read_text())["framing_traps"]
    heard = {trap["id"]: [command.raw.hex() for command in parse(bytes.fromhex(trap["hex"]))] for trap in traps}
    assert heard["ff_inside_payload_pan_2_55"] == ["ff01004b00ff4b"]
    assert heard["ff_address_255"] == []  # no head has it
    assert heard["bad_checksum"] == []
    assert heard["truncated_reply_5_bytes"] == []
    assert heard["echo_then_reply"] == ["ff010051000052", "ff010059814a25"]
