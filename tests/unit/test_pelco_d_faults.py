"""What a head does when its line or itself goes wrong: every case scripted, with what must be seen.

Common to all: no reading is false, the last motion frame is a stop, a motion is sent again only by whoever wants it,
and the head comes back by itself.
"""

from dataclasses import dataclass, field
from typing import Any

import pytest

from camrig.errors import LinkLost
from tests.simulated_line import Service, SimulatedHeads

AIM = (100.0, -60.0)
LASTS_S = 30.0
SPEEDS = {"speeds": {1: 40.0 / 63.0, 63: 40.0}}


@dataclass(frozen=True)
class Case:
    """A script, what the head is like, and what is expected."""

    script: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)
    lost: str | None = None
    """Words of the reason with which its link is lost; None where it is not."""
    unknown: tuple[float, float] | None = None
    """From when to when, in seconds, there is no reading."""
    arrives: bool = True
    strays_deg: float | None = None
    """How far from where it began the head may be at the end."""
    off_deg: float = 0.02
    """How far a reading may be off, beyond three sigmas."""


CASES = {
    "unplugged_and_replugged": Case("at 2 unplug; at 6 replug", lost="it is not there", unknown=(2.2, 6.0)),
    "unplugged_for_long": Case("at 2 unplug; at 20 replug", lost="it is not there", unknown=(2.2, 20.0)),
    "silence": Case("from 2 to 6 silent", lost="nothing came back", unknown=(2.2, 6.0)),
    "a_short_silence_is_no_loss": Case("from 2 to 2.6 silent", unknown=(2.2, 2.6)),
    "garbage": Case("from 2 to 6 swapped", lost="queries in a row unanswered", unknown=(2.2, 6.0)),
    "a_noisy_line": Case("from 0.5 to 20 garble 0.02; from 0.5 to 20 bursts 0.3"),
    "bytes_lost_and_put_in": Case("from 0.5 to 20 lose 0.02; from 0.5 to 20 insert 0.02"),
    "half_frames": Case("from 2 to 5 lost_last 3", lost="what came back is no answer", unknown=(2.2, 5.0)),
    "a_stuck_queue": Case("from 2 to 4 stuck", lost="write timeout", unknown=(2.6, 4.0)),
    "spikes_of_latency": Case("from 1 to 4 latency 0.18", lost="queries in a row unanswered"),
    "answers_cut_at_the_turn_around": Case("from 2 to 5 lost_first 2", lost="no answer", unknown=(2.2, 5.0)),
    "answers_cut_but_completed": Case("from 2 to 5 lost_first 2", keys={"resync_tail": True}),
    "a_full_echo": Case("at 0 echo"),
    "an_echo_in_parts": Case("at 0 echo; at 0 echo_bytes 4"),
    "an_echo_that_comes_late": Case("at 0 echo; at 0 echo_delay 0.02"),
    "an_echo_byte_by_byte": Case("at 0 echo; at 0 splits"),
    "a_brown_out": Case("at 2 on pt1 reset", lost="nothing came back", unknown=(2.2, 7.0)),
    "it_reports_its_target": Case(settings={"reports": "target"}),
    "it_reports_where_it_last_stood": Case(settings={"reports": "frozen"}, off_deg=4.5),
    "old_positions": Case(settings={"update_s": 0.02}, keys={"readback_sigma_deg": 0.5}),
    "it_is_deaf_while_it_talks": Case(settings={"half_duplex": True, "turn_around_s": 0.02}),
    "frames_that_come_too_soon_are_lost": Case(settings={"min_gap_s": 0.04}),
    "commands_are_lost": Case("at 0.3 drop 3; at 3 drop 2"),
    "the_second_frame_ends_the_first": Case(settings={"absolute": "race"}),
    "positions_are_ignored": Case(
        settings={"absolute": "ignored"}, lost="does not move when it is sent", arrives=False
    ),
    "positions_are_ignored_but_speeds_known": Case(
        settings={"absolute": "ignored"}, keys={"axes": {"pan": SPEEDS, "tilt": SPEEDS}}
    ),
    "one_axis_takes_positions": Case(settings={"absolute": "pan"}, keys={"axes": {"pan": SPEEDS, "tilt": SPEEDS}}),
    "a_wrong_sign": Case(
        keys={"grade": "velocity", "axes": {"pan": {**SPEEDS, "drive_sign": 1}, "tilt": SPEEDS}},
        lost="the wrong way",
        arrives=False,
        strays_deg=40.0,  # at 40 deg/s, turned for a second and never again
    ),
    "a_motor_that_does_not_turn": Case(
        settings={"dead_bytes": 62, "speed_curve": "bell"},
        keys={
            "grade": "velocity",
            "axes": {axis: {"speeds": {1: 1.0, 20: 9.0}} for axis in ("pan", "tilt")},
        },
        lost="does not turn when it is driven",
        arrives=False,
    ),
}


def served(case: Case) -> tuple[SimulatedHeads, Service]:
    rig = SimulatedHeads(keys=case.keys, script=case.script, seed=4, **case.settings)
    return rig, rig.serve(LASTS_S, *AIM)


@pytest.mark.parametrize("name", list(CASES))
def test_the_pose_is_true_or_unknown_and_the_head_comes_back(name: str) -> None:
    case = CASES[name]
    begun_s = 100.0
    rig, service = served(case)
    assert rig.worst_error_deg(service.readings) <= case.off_deg
    if case.lost is None:
        assert service.losses == []
    else:
        assert any(case.lost in reason for _, reason in service.losses), service.losses
    if case.unknown is not None:
        first_s, last_s = (begun_s + second for second in case.unknown)
        assert [reading for reading in service.readings if first_s < reading.stamp_s < last_s] == []
    if case.arrives:
        assert service.readings[-1].stamp_s > begun_s + LASTS_S - 1.0
        assert rig.truth_deg() == pytest.approx(AIM, abs=0.11)
    if case.strays_deg is not None:
        assert max(map(abs, rig.truth_deg())) <= case.strays_deg
    rig.settle()
    motions = rig.motions()
    assert motions[-1] == "stop"


def test_a_runaway_head_whose_stop_was_lost_is_stopped_once_its_line_is_back_and_no_more() -> None:
    rig = SimulatedHeads(keys=CASES["a_wrong_sign"].keys)
    rig.head.open()
    rig.head.enable()
    rig.move(*AIM)
    with pytest.raises(LinkLost, match="the wrong way"):
        rig.poll(5.0)
    rig.line.faults.unplug()
    rig.head.close()
    rig.line.faults.replug()
    assert rig.motions()[-1] != "stop"
    with pytest.raises(LinkLost, match="stays stopped until the rig is started or reloaded"):
        rig.head.open()
    rig.settle()
    assert rig.motions()[-1] == "stop"


@pytest.mark.parametrize("settings", [{"head_baud": 4800}, {"head_address": 9}])
def test_a_head_at_another_baud_or_address_is_a_lost_link_that_says_where(settings: dict[str, Any]) -> None:
    rig = SimulatedHeads(keys={"address": settings.get("head_address", 1)}, driver_baud=settings.get("head_baud"))
    service = rig.serve(10.0, *AIM)
    assert service.readings == []
    assert len(service.losses) > 2
    address, baud = settings.get("head_address", 1), settings.get("head_baud", 9600)
    assert f"head pt1 at address {address} on /sim, {baud} baud, does not answer" in service.losses[0][1]
    assert set(rig.motions()) <= {"stop"}


def test_two_heads_with_one_address_give_no_position() -> None:
    rig = SimulatedHeads(2, same_address=True)
    service = rig.serve(10.0, *AIM)
    assert service.readings == []
    assert "no other head has its address" in service.losses[0][1]
    assert set(rig.motions()) <= {"stop"}


def test_a_line_under_another_name_is_opened_by_its_own() -> None:
    """Ports are opened by name on every attempt: the one of /dev/serial/by-id stays whatever the kernel calls it."""
    rig = SimulatedHeads(script="at 2 unplug; at 5 replug")
    service = rig.serve(12.0, *AIM)
    assert len(service.opened_s) == 2
    assert service.opened_s[1] >= 105.0


def test_after_a_loss_the_first_frame_is_a_stop_and_nothing_is_replayed() -> None:
    rig = SimulatedHeads(script="at 1 unplug; at 4 replug")
    rig.head.open()
    rig.head.enable()
    rig.move(*AIM)
    with pytest.raises(Exception, match="not there"):
        rig.poll(3.0)
    rig.head.close()
    heard = len(rig.line.received)
    rig.time.sleep_s(3.5)
    rig.head.open()
    rig.poll(2.0)
    frames = [frame for _, frame in rig.line.received[heard:]]
    assert frames[0] == bytes.fromhex("ff010000000001")
    assert all(frame[2:6] == bytes(4) or frame[3] in (0x51, 0x53) for frame in frames)
