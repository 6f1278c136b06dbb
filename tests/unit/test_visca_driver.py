"""The VISCA driver against an emulated line in simulated time: positions, stops, and what goes wrong on a wire."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import numpy as np
import pytest
from scipy import stats

from camrig.errors import LinkLost, NotEnabledError
from camrig.rig import HeadSpec
from camrig_drivers.visca import driver
from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine
from tests.visca_bench import AXES, SPEC, ViscaBench

STOP = bytes.fromhex("81 01 06 01 18 14 03 03 FF")
FAR = (math.radians(150.0), math.radians(-80.0))
NEAR = (math.radians(5.0), math.radians(-8.0))
COUNT_RAD = math.radians(0.075)


def enabled(**emulated: object) -> ViscaBench:
    bench = ViscaBench(**emulated)  # type: ignore[arg-type]
    bench.head.open()
    bench.head.enable()
    return bench


def aims(number: int, seed: int) -> Iterator[tuple[float, float]]:
    rng = random.Random(seed)
    for _ in range(number):
        yield math.radians(rng.uniform(-170.0, 170.0)), math.radians(rng.uniform(-90.0, 30.0))


def orders(bench: ViscaBench) -> list[str]:
    """Return what the head heard, inquiries and cancels left out."""
    bodies = [message[1:-1] for _, message in bench.line.received]
    return ["stop" if body[2] == 0x01 else "move" for body in bodies if body[0] == 0x01 and body[1] == 0x06]


@pytest.mark.parametrize("baud", [9600, 38400])
def test_positions_are_as_good_as_they_claim(baud: int) -> None:
    bench = enabled(baud=baud, seed=1)
    settled, moving = [], []
    for aim in aims(40, seed=baud):
        bench.head.move_to(*aim)
        moving += bench.poll(1.0)
        bench.poll(12.0)
        settled += bench.poll(0.5)
        assert max(abs(a - b) for a, b in zip(aim, bench.truth_rad(), strict=True)) <= 0.51 * COUNT_RAD
    errors = np.array(settled)
    assert np.degrees(np.abs(errors[:, 1:3])).max() <= 0.05
    assert np.mean(np.abs(errors[:, 1:3]) <= 3.0 * errors[:, 3:4]) >= 0.99
    assert len(moving) > 10 * 40  # of a head that moves at 40 deg/s it is known where it is
    assert np.degrees(np.percentile(np.abs(np.array(moving)[:, 1:3]).max(axis=1), 95)) <= 0.4


def test_the_sigma_of_a_head_at_rest_is_neither_too_small_nor_too_large() -> None:
    bench = ViscaBench(seed=5, rest_error_deg=0.0375, readback_sigma_deg=0.0)
    bench.head.open()
    bench.head.enable()
    normalised = []
    for aim in aims(100, seed=6):
        bench.head.move_to(*aim)
        bench.poll(9.0)
        pan, tilt, sigma = bench.poll(0.1)[0][1:]
        normalised.append((pan**2 + tilt**2) / sigma**2)
    low, high = stats.chi2.interval(0.95, 2 * len(normalised))
    assert low <= sum(normalised) <= high


@pytest.mark.parametrize(
    "habit",
    [
        {"overtaking": "queue"},
        {"overtaking": "refuse"},
        {"acknowledges": False},
        {"acknowledges": False, "overtaking": "queue"},
        {"reports": "target"},
        {"out_of_range": "clamp"},
    ],
    ids=str,
)
def test_a_new_target_takes_the_place_of_the_old_whatever_the_head_is_like(habit: dict[str, object]) -> None:
    bench = enabled(**habit)
    for aim in (FAR, (-FAR[0], 0.0), NEAR):
        bench.head.move_to(*aim)
        bench.poll(0.7)
    bench.head.move_to(*NEAR)
    errors = bench.poll(8.0)
    bench.head.move_to(*NEAR)
    errors += bench.poll(8.0)
    assert bench.truth_rad() == pytest.approx(NEAR, abs=COUNT_RAD)
    assert max(max(abs(pan), abs(tilt)) for _, pan, tilt, _ in errors) < math.radians(0.5)


def test_a_head_that_reports_its_target_is_unknown_while_it_moves(caplog: pytest.LogCaptureFixture) -> None:
    bench = enabled(reports="target")
    bench.head.move_to(*FAR)
    assert len(bench.poll(3.0)) <= 1  # before it has begun to move
    assert "reports where it is going to" in caplog.text
    assert len(bench.poll(6.0)) > 10


def test_what_the_head_has_acknowledged_is_not_interrupted_by_being_said_again() -> None:
    bench = enabled()
    for _ in range(8):
        bench.head.move_to(*FAR)
        bench.poll(0.5)
    assert orders(bench) == ["move"]
    bench.poll(4.0)
    bench.head.move_to(*FAR)
    assert orders(bench) == ["move", "move"]


def test_a_command_that_was_lost_is_said_again() -> None:
    bench = enabled()
    bench.line.faults.drop_next(1)
    bench.head.move_to(*NEAR)
    bench.poll(2.1)
    bench.head.move_to(*NEAR)
    bench.poll(2.0)
    assert bench.truth_rad() == pytest.approx(NEAR, abs=COUNT_RAD)


@pytest.mark.parametrize("overtaking", ["replace", "queue"])
def test_the_zoom_goes_on_while_the_head_moves_and_is_ended_by_a_stop(overtaking: str) -> None:
    bench = enabled(zoom=0x4000, zoom_s=6.0, overtaking=overtaking)
    for aim in (FAR, NEAR):
        bench.head.move_to(*aim)
        bench.poll(1.0)
    assert zoom_of(bench) == pytest.approx(0x4000 * 2.1 / 6.0, rel=0.1)
    bench.poll(8.0)
    assert zoom_of(bench) == 0x4000
    assert bench.truth_rad() == pytest.approx(NEAR, abs=COUNT_RAD)
    bench = enabled(zoom=0x4000, zoom_s=6.0, overtaking=overtaking)
    bench.head.move_to(*FAR)
    bench.poll(1.0)
    bench.head.stop()
    bench.poll(1.0)
    stopped_at = zoom_of(bench)
    bench.poll(3.0)
    assert zoom_of(bench) == stopped_at < 0x2000


def zoom_of(bench: ViscaBench) -> int:
    bench.truth_rad()
    return bench.line._bus.heads["pt1"].zoom.at(bench.clock.now_s())


class TestStop:
    """It goes first, ends every motion, and is repeated until the head has said so."""

    def test_it_is_acknowledged_before_anything_else_is_trusted(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.poll(1.0)
        bench.head.stop()
        bench.poll(2.0)
        assert orders(bench) == ["move", "stop", "stop"]
        with pytest.raises(NotEnabledError):
            bench.head.move_to(*NEAR)

    def test_one_that_is_lost_is_said_again(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.poll(1.0)
        bench.line.faults.drop_next(5)  # the stop, both cancels, an inquiry, and the first repetition
        bench.head.stop()
        bench.poll(1.5)
        at_rest = bench.truth_rad()
        bench.poll(1.0)
        assert bench.truth_rad() == at_rest
        assert abs(at_rest[0]) < 0.8 * FAR[0]

    def test_one_that_nobody_acknowledged_is_said_again_when_the_link_is_back(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.poll(0.6)
        bench.transport.cut = True
        bench.head.stop()
        with pytest.raises(LinkLost):
            bench.poll(10.0)
        bench.head.close()
        bench.transport.cut = False
        bench.head.open()
        assert orders(bench) == ["move", "stop"]
        bench.poll(1.0)
        assert orders(bench) == ["move", "stop", "stop"], "once to stop, once to be told so"
        bench.head.close()
        bench.head.open()
        bench.poll(1.0)
        assert orders(bench) == ["move", "stop", "stop"], "it was acknowledged"

    def test_a_head_busy_with_two_commands_of_another_controller_is_stopped(self) -> None:
        bench = enabled(overtaking="queue")
        for message in ("81 01 06 02 18 14 0F 08 00 00 00 00 00 00 FF", "81 01 06 02 18 14 00 07 00 00 00 00 00 00 FF"):
            bench.transport.send(bytes.fromhex(message))
            bench.poll(0.3)
        bench.head.stop()
        bench.poll(1.0)
        at_rest = bench.truth_rad()
        bench.poll(5.0)
        assert bench.truth_rad() == at_rest

    def test_it_leaves_at_once(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        now_s = bench.clock.now_s()
        bench.head.stop()
        assert next(sent_s for sent_s, message in bench.transport.wire if message == STOP) == now_s

    def test_closing_waits_until_it_is_acknowledged(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.head.close()
        assert orders(bench)[-2:] == ["stop", "stop"]

    def test_a_dead_head_does_not_hold_up_closing(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.line.faults.silent = True
        begun_s = bench.clock.now_s()
        bench.head.close()
        assert bench.clock.now_s() - begun_s < 1.5


class TestWire:
    """Nothing false is believed, and silence is named."""

    def test_garbled_answers_do_not_pass_for_motion(self) -> None:
        bench = enabled(seed=3)
        bench.poll(1.0)
        bench.line.faults.garble(0.003)
        errors = bench.poll(120.0)
        assert len(errors) > 300
        assert max(max(abs(pan), abs(tilt)) for _, pan, tilt, _ in errors) <= 2.0 * COUNT_RAD

    def test_a_late_answer_is_nobodys(self) -> None:
        bench = enabled()
        bench.head.move_to(*FAR)
        bench.poll(0.5)
        bench.line.faults.latency_s = 0.25  # longer than the time-out, shorter than the patience after it
        assert bench.head.read(0.3) == ()
        bench.line.faults.latency_s = 0.0
        errors = bench.poll(2.0)
        assert errors
        assert max(abs(pan) for _, pan, _, _ in errors) < math.radians(0.5)

    @pytest.mark.parametrize("cut", [(1, 0), (0, 1), (3, 0), (0, 4)])
    def test_half_answers_are_none(self, cut: tuple[int, int]) -> None:
        bench = enabled()
        bench.line.faults.truncate_reply(last=cut[1], first=cut[0])
        assert bench.head.read(0.3) == ()

    def test_silence_ends_the_link_with_advice(self) -> None:
        bench = enabled()
        bench.line.faults.silent = True
        with pytest.raises(LinkLost, match=r"pt1 at /dev/none, 9600 baud, address 1, left 4 inquiries .* unanswered"):
            bench.poll(5.0)

    def test_standby_is_named(self) -> None:
        with pytest.raises(LinkLost, match="whether it is in standby"):
            ViscaBench(standby=True).head.open()

    def test_a_head_that_does_not_answer_is_stopped_before_it_is_given_up(self) -> None:
        bench = ViscaBench(address=2)
        with pytest.raises(LinkLost, match="does not tell its position"):
            bench.head.open()
        assert bench.transport.wire[-1][1] == STOP

    def test_the_link_is_counted(self) -> None:
        bench = enabled()
        bench.head.move_to(*NEAR)
        bench.poll(1.0)
        bench.line.faults.silent = True
        bench.head.read(0.3)
        found = bench.head.statistics()
        assert found["asked"] == found["answered"] + 1 > 10
        assert (found["silent"], found["moves"], found["garbled"], found["disbelieved"]) == (1, 1, 0, 0)
        assert found["reply_s"] == pytest.approx(0.016, abs=0.002)

    def test_an_echo_is_no_answer(self) -> None:
        bench = enabled()
        bench.line.faults.echo = True
        assert len(bench.head.read(0.3)) == 2


def test_two_heads_share_a_port() -> None:
    line = ViscaLine([ViscaHeadSettings(id="a"), ViscaHeadSettings(id="b", address=2, start_pan_deg=30.0)])
    sections = {
        name: driver.section(port=line.start(), address=k, axes=AXES, reply_timeout_s=0.5)
        for k, name in ((1, "a"), (2, "b"))
    }
    specs = {name: HeadSpec(name, SPEC.kinematics, SPEC.pan_limits_rad, SPEC.tilt_limits_rad, 1.0) for name in sections}
    heads = driver.make({name: (specs[name], sections[name]) for name in sections})
    try:
        for head in heads.values():
            head.open()
        pans_deg = [math.degrees(head.read(0.3)[0].angle_rad) for head in heads.values()]
        heads["a"].close()
        assert heads["b"].read(0.3)
    finally:
        for head in heads.values():
            head.close()
        line.stop()
    assert pans_deg == pytest.approx([0.0, 30.0], abs=0.04)


@pytest.mark.parametrize(("port", "says"), [("/dev/none/such", "does not exist"), ("/dev/null", "is no serial port")])
def test_a_port_that_cannot_be_opened_is_told_in_a_sentence(port: str, says: str) -> None:
    head = driver.make({"pt1": (SPEC, driver.section(port=port, axes=AXES))})["pt1"]
    with pytest.raises(LinkLost, match=f"cannot open serial port {port}: .*{says}"):
        head.open()
