"""The emulated VISCA head, byte by byte in simulated time: what it obeys, what it answers and when."""

from __future__ import annotations

import math

import pytest

from camrig.clock import ManualClock
from camrig.errors import InputError
from camrig_emulators.faults import Faults
from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine, ViscaUdpHead
from camrig_emulators.visca_udp import ViscaDatagrams

PEER = ("127.0.0.1", 5)
ABSOLUTE_10_DEG = "81 01 06 02 18 14 0F 0F 07 0B 00 00 00 00 FF"  # -133 counts of 0.075 deg
STOP = "81 01 06 01 18 14 03 03 FF"
WHERE = "81 09 06 12 FF"


class Wire:
    """A master of a stepped line at 9600 baud."""

    def __init__(self, *heads: ViscaHeadSettings) -> None:
        self.clock = ManualClock()
        self.line = ViscaLine(heads, clock=self.clock)

    def say(self, text: str, wait_s: float = 0.1, baud: int = 9600) -> str:
        """Write bytes, let time pass, return what came as hexadecimal words."""
        self.line.receive(bytes.fromhex(text), self.clock.now_s(), baud)
        return self.wait(wait_s)

    def wait(self, wait_s: float) -> str:
        until_s, heard = self.clock.now_s() + wait_s, b""
        while (next_s := self.line.next_s()) is not None and next_s <= until_s:
            self.clock.advance(max(0.0, next_s - self.clock.now_s()))
            heard += self.line.transmit(self.clock.now_s(), 9600)
        self.clock.advance(until_s - self.clock.now_s())
        return heard.hex(" ").upper()

    def pan_deg(self, name: str = "head") -> float:
        return math.degrees(self.line.true_angles_rad(name, self.clock.now_s())[0])


def head(name: str = "head", **changed: object) -> ViscaHeadSettings:
    return ViscaHeadSettings.model_validate({"id": name, "reply_latency_s": 0.01, **changed})


def test_a_position_is_acknowledged_reached_and_completed() -> None:
    wire = Wire(head())
    assert wire.say(ABSOLUTE_10_DEG) == "90 41 FF"
    assert wire.wait(3.0) == "90 51 FF"
    assert wire.pan_deg() == pytest.approx(9.975)
    assert wire.say(WHERE) == "90 50 0F 0F 07 0B 00 00 00 00 FF"


def test_bytes_take_their_time() -> None:
    wire = Wire(head())
    asked_s = wire.clock.now_s()
    wire.say(WHERE)
    (heard_s, _), (answered_s, _) = wire.line.received[0], wire.line.sent[0]
    assert heard_s == pytest.approx(asked_s + 50 / 9600)
    assert answered_s == pytest.approx(heard_s + 0.01 + 110 / 9600)


def test_a_drive_goes_on_until_it_is_stopped() -> None:
    wire = Wire(head(pan_limits_deg=(-300.0, 300.0), max_speed_deg_s=10.0))
    assert wire.say("81 01 06 01 18 14 01 03 FF", 10.0) == "90 41 FF 90 51 FF"
    assert wire.pan_deg() == pytest.approx(100.0, abs=2.0)
    wire.say(STOP, 1.0)
    at_rest_deg = wire.pan_deg()
    wire.wait(5.0)
    assert wire.pan_deg() == at_rest_deg


def test_a_third_command_finds_no_socket_and_a_cancel_frees_one() -> None:
    wire = Wire(head(overtaking="queue"))
    assert wire.say(ABSOLUTE_10_DEG) == "90 41 FF"
    assert wire.say(ABSOLUTE_10_DEG) == "90 42 FF"
    assert wire.say(STOP) == "90 60 03 FF"
    assert wire.say("81 21 FF") == "90 61 04 FF"
    assert wire.say("81 21 FF") == "90 61 05 FF"


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        ("81 01 06 02 18 14 07 0F 0F 0F 00 00 00 00 FF", "90 61 41 FF"),  # far outside
        ("81 01 06 02 18 14 0F 0F 07 0B FF", "90 60 02 FF"),
        ("81 01 77 FF", "90 60 02 FF"),
        ("81 09 77 FF", "90 60 02 FF"),
        ("81 " + "01 " * 20 + "FF", "90 60 01 FF"),
        ("82 09 06 12 FF", ""),
        ("09 06 12 FF", ""),
        ("81 09 04 00 FF", "90 50 02 FF"),
        ("81 01 04 47 00 01 00 00 FF", "90 41 FF 90 51 FF"),
        ("81 01 00 01 FF", "90 50 FF"),
    ],
)
def test_answers(sent: str, answer: str) -> None:
    assert Wire(head()).say(sent, 0.2) == answer


def test_a_zoom_takes_its_time_and_a_socket() -> None:
    wire = Wire(head(zoom_s=2.0))
    assert wire.say("81 01 04 47 02 00 00 00 FF", 0.5) == "90 41 FF"
    assert wire.say("81 22 FF 81 21 FF", 0.1) == "90 62 05 FF 90 61 04 FF"
    assert wire.say("81 01 04 47 01 00 00 00 FF", 1.5) == "90 41 FF 90 51 FF"
    assert wire.say("81 09 04 47 FF", 0.1) == "90 50 01 00 00 00 FF"


def test_a_chain_is_numbered_and_answers_by_address() -> None:
    wire = Wire(head("a", address=5), head("b", address=6, start_pan_deg=7.5))
    assert wire.say("88 30 01 FF") == "88 30 03 FF"
    assert wire.say("82 09 06 12 FF") == "A0 50 0F 0F 09 0C 00 00 00 00 FF"


def test_in_standby_it_refuses() -> None:
    wire = Wire(head(standby=True))
    assert (wire.say(WHERE), wire.say(ABSOLUTE_10_DEG)) == ("90 60 41 FF", "90 61 41 FF")


def test_at_another_baud_rate_it_hears_noise() -> None:
    wire = Wire(head())
    assert wire.say(WHERE, baud=38400) == ""
    assert wire.say(WHERE) != ""


@pytest.mark.parametrize(
    "heads", [[head(), head()], [head("a"), head("b", baud=38400)]], ids=["two of one id", "two bauds"]
)
def test_heads_that_clash_are_refused(heads: list[ViscaHeadSettings]) -> None:
    with pytest.raises(InputError):
        ViscaLine(heads)
    with pytest.raises(InputError, match="address 1"):
        ViscaUdpHead(head(address=2))


class TestSonysHeader:
    """Sequence numbers on UDP."""

    def _say(self, device: ViscaDatagrams, text: str, now_s: float = 0.0) -> list[str]:
        said = device.receive(now_s, PEER, bytes.fromhex(text)) + device.poll(now_s + 0.02)
        return [data.hex(" ").upper() for _, data in said]

    def test_replies_carry_the_number_of_what_they_answer(self) -> None:
        device = ViscaDatagrams(head(), Faults(), sony=True)
        assert self._say(device, "01 10 00 05 00 00 00 07 " + WHERE) == [
            "01 11 00 0B 00 00 00 07 90 50 00 00 00 00 00 00 00 00 FF"
        ]

    def test_a_number_that_does_not_grow_is_refused_until_a_reset(self) -> None:
        device = ViscaDatagrams(head(), Faults(), sony=True)
        self._say(device, "01 10 00 05 00 00 00 07 " + WHERE)
        assert self._say(device, "01 10 00 05 00 00 00 07 " + WHERE) == ["02 01 00 02 00 00 00 07 0F 01"]
        assert self._say(device, "02 00 00 01 00 00 00 00 01") == ["02 01 00 01 00 00 00 00 01"]
        assert len(self._say(device, "01 10 00 05 00 00 00 01 " + WHERE)) == 1

    @pytest.mark.parametrize("text", ["", "01", "01 10 00 09 00 00 00 01 81", "77 77 00 01 00 00 00 01 81"])
    def test_nonsense_does_nothing(self, text: str) -> None:
        device = ViscaDatagrams(head(), Faults(), sony=True)
        self._say(device, text)
        assert not device.received
