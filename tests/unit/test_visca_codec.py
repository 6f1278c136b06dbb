"""VISCA's bytes against what manuals print, and the parsers against anything."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_drivers.visca import codec
from camrig_drivers.visca.codec import Acknowledged, Completed, Digits, Kind, Refused, Splitter

SIGNED = Digits()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (codec.absolute(0x8DB, -0x190, (0x18, 0x14), SIGNED), "81 01 06 02 18 14 00 08 0D 0B 0F 0E 07 00 FF"),
        (codec.absolute(-0x12345, 1, (1, 1), Digits(pan=5)), "81 01 06 02 01 01 0E 0D 0C 0B 0B 00 00 00 01 FF"),
        (codec.stop((0x18, 0x14)), "81 01 06 01 18 14 03 03 FF"),
        (codec.cancel(2), "81 22 FF"),
        (codec.zoom_to(0x4000), "81 01 04 47 04 00 00 00 FF"),
        (codec.INQUIRE_PAN_TILT, "81 09 06 12 FF"),
        (codec.INQUIRE_ZOOM, "81 09 04 47 FF"),
    ],
)
def test_messages_are_those_of_the_manuals(body: bytes, expected: str) -> None:
    assert codec.message(1, body) == bytes.fromhex(expected)


def test_an_address_is_in_the_first_byte() -> None:
    assert codec.message(7, codec.cancel(1)).hex() == "8721ff"


@pytest.mark.parametrize(
    ("raw", "reply"),
    [
        ("90 41 FF", Acknowledged(1, 1)),
        ("F0 52 FF", Completed(7, 2)),
        ("90 50 00 08 0D 0B 0F 0E 07 00 FF", Completed(1, 0, bytes.fromhex("00080d0b0f0e0700"))),
        ("A0 60 02 FF", Refused(2, 0, 2)),
        ("90 61 41 FF", Refused(1, 1, 0x41)),
        ("88 30 02 FF", None),  # an answer to everybody: the chain was numbered
        ("90 38 FF", None),  # the chain has changed
        ("81 09 06 12 FF", None),  # an echo
        ("91 41 FF", None),
        ("90 FF", None),
        ("90 41", None),
        ("90 60 02 03 FF", None),
        ("", None),
    ],
)
def test_replies(raw: str, reply: codec.Reply | None) -> None:
    assert codec.parse(bytes.fromhex(raw)) == reply


def test_a_refusal_says_why() -> None:
    assert str(Refused(1, 1, 0x41)) == "not executable"
    assert str(Refused(1, 1, 0x77)) == "error 77"


@pytest.mark.parametrize(
    ("content", "digits", "counts"),
    [
        ("00080d0b0f0e0700", SIGNED, (0x8DB, -0x190)),
        ("08000000070f0f0f", SIGNED, (-32768, 32767)),
        ("080000000f0f0f0f", Digits(signed=False), (32768, 65535)),
        ("0e0d0c0b0b00000001", Digits(pan=5), (-0x12345, 1)),
        ("00080d0b0f0e07", SIGNED, None),
        ("00080d0b0f0e1700", SIGNED, None),
    ],
)
def test_positions(content: str, digits: Digits, counts: tuple[int, int] | None) -> None:
    assert codec.pan_tilt(bytes.fromhex(content), digits) == counts


@given(st.data(), st.integers(4, 5), st.integers(4, 5), st.booleans())
def test_positions_survive_the_wire(data: st.DataObject, pan: int, tilt: int, signed: bool) -> None:
    digits = Digits(pan, tilt, signed)
    counts = (data.draw(st.integers(*digits.range(pan))), data.draw(st.integers(*digits.range(tilt))))
    body = codec.absolute(counts[0], counts[1], (1, 1), digits)
    assert codec.pan_tilt(body[5:], digits) == counts


@given(st.lists(st.binary(max_size=12).map(lambda body: body.replace(b"\xff", b"") + b"\xff"), max_size=8), st.data())
def test_a_stream_is_cut_into_its_messages_however_it_arrives(messages: list[bytes], data: st.DataObject) -> None:
    stream, splitter, found = b"".join(messages), Splitter(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += splitter.feed(stream[:size])
        stream = stream[size:]
    assert found == messages


@given(st.binary(max_size=64))
def test_after_any_noise_the_next_message_but_one_is_read(noise: bytes) -> None:
    answer = bytes.fromhex("9050 00080d0b 0f0e0700 ff")
    assert Splitter().feed(noise + answer + answer)[-1] == answer


def _false_positions(bytes_read: int, seed: int) -> int:
    """Feed noise to the parsers; count what passes for a position of head 1."""
    rng, splitter, found = random.Random(seed), Splitter(), 0
    for _ in range(bytes_read // 1000):
        noise = rng.randbytes(1000)
        codec.undatagram(noise[:40])
        for raw in splitter.feed(noise):
            reply = codec.parse(raw)
            if isinstance(reply, Completed) and reply.address == 1:
                found += codec.pan_tilt(reply.content, SIGNED) is not None
    return found


def test_noise_is_no_position() -> None:
    assert _false_positions(200_000, seed=1) == 0


@pytest.mark.slow
def test_ten_million_bytes_of_noise_are_no_position() -> None:
    assert _false_positions(10_000_000, seed=2) == 0


def test_sonys_header() -> None:
    reset = codec.datagram(Kind.CONTROL, 1, codec.RESET_SEQUENCE)
    assert reset == bytes.fromhex("02 00 00 01 00 00 00 01 01")
    asked = codec.datagram(Kind.INQUIRY, (1 << 32) + 5, codec.message(1, codec.INQUIRE_PAN_TILT))
    assert asked == bytes.fromhex("01 10 00 05 00 00 00 05 81 09 06 12 FF")
    assert codec.undatagram(bytes.fromhex("01 11 00 03 00 00 00 05 90 41 FF")) == (
        Kind.REPLY,
        5,
        bytes.fromhex("9041ff"),
    )


@given(st.binary(max_size=40))
def test_no_datagram_is_more_than_unreadable(data: bytes) -> None:
    found = codec.undatagram(data)
    assert found is None or codec.datagram(*found) == data
