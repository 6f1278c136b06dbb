"""Random bytes into every parser: no exception, and no position that nobody sent."""

import random
from pathlib import Path

import pytest

from camrig_drivers.pelco_d.codec import Axis, Command, Echo, Extended, Op, Request, encode, find_reply
from camrig_drivers.pelco_d.commands import STOP, extended, query_position
from camrig_emulators.pelco_d_wire import CommandParser

REQUESTS = [
    Request(1, query_position(Axis.PAN)),
    Request(254, query_position(Axis.TILT)),
    Request(1, STOP),
    Request(7, extended(Op.QUERY_DEVICE)),
]
LIKELY = bytes((0xFF, 0x01, 0x00, 0x59, 0x5B, 0xFE, 0x45))


def noise(rng: random.Random, count: int) -> bytes:
    """Return random bytes; every other time of those alone that frames are made of."""
    return rng.randbytes(count) if rng.random() < 0.5 else bytes(rng.choices(LIKELY, k=count))


def feed(count: int, seed: int) -> int:
    """Feed ``count`` bytes to the driver's parser in chunks of an exchange; return how many replies it believed."""
    rng, believed = random.Random(seed), 0
    while count > 0:
        received = noise(rng, rng.randrange(1, 64))
        count -= len(received)
        request = rng.choice(REQUESTS)
        final = rng.random() < 0.5
        reply = find_reply(received, request, echo=rng.choice(list(Echo)), resync_tail=False, final=final)
        if isinstance(reply, Extended):
            believed += 1
            answer = encode(request.address, Command(0, int(reply.op), reply.data1, reply.data2))
            assert answer in received, "a position that is not in what was received"
    return believed


def feed_emulator(count: int, seed: int) -> None:
    rng, parser, now_s, heard = random.Random(seed), CommandParser(), 0.0, bytearray()
    for byte in noise(rng, count):
        now_s += 0.001
        heard = heard[-6:] + bytes((byte,))
        command = parser.feed(byte, now_s - 0.001, now_s)
        assert command is None or (len(command.raw) == 7 and sum(command.raw[1:6]) & 0xFF == command.raw[6])


CORPUS = Path(__file__).with_name("pelco_d_corpus.txt")
"""What coverage-guided fuzzing (atheris) kept, in hex: the first byte chooses the question, the rest is received."""


def test_what_fuzzing_found_worth_keeping() -> None:
    entries = [bytes.fromhex(line) for line in CORPUS.read_text().split()]
    assert len(entries) > 40
    for entry in entries:
        request, echo = REQUESTS[entry[0] & 3], list(Echo)[(entry[0] >> 2) % 3]
        for final in (False, True):
            reply = find_reply(entry[1:], request, echo=echo, resync_tail=bool(entry[0] & 64), final=final)
            if isinstance(reply, Extended) and not reply.degraded:
                assert encode(request.address, Command(0, int(reply.op), reply.data1, reply.data2)) in entry[1:]


def test_a_hundred_thousand_random_bytes() -> None:
    feed(100_000, 1)
    feed_emulator(50_000, 2)
    feed_emulator(50_000, 3)


@pytest.mark.slow
def test_ten_million_random_bytes_into_each_parser() -> None:
    feed(10_000_000, 4)
    for seed in range(10):
        feed_emulator(1_000_000, seed)
