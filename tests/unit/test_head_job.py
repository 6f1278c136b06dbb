"""What a head's worker does: nothing moves before it is enabled, and a stop has the last word."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from camrig.clock import ManualClock
from camrig.errors import HardwareError, LinkLost
from camrig.interfaces import Guard
from camrig.messages import AxisReading, HeadAim
from camrig.rig import HeadSpec
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.head_job import HeadJob
from camrig_emulators.fakes import FakeHead
from tests.runtime_parts import in_a_thread, nothing, until

ASIDE, BELOW = HeadAim(0.5, -0.5), HeadAim(0.0, -1.5)


@pytest.fixture
def guardian() -> Iterator[GuardianLink]:
    link = GuardianLink()
    yield link
    link.close()


def head_job(head: FakeHead, guardian: GuardianLink, *, auto: bool = False) -> HeadJob:
    return HeadJob("pt1", head, guardian, auto_enable=auto)


@pytest.fixture
def job(fake_head: FakeHead, guardian: GuardianLink) -> Iterator[HeadJob]:
    """Return an open job of a head that nobody has enabled."""
    found = head_job(fake_head, guardian)
    found.open()
    yield found
    found.close()


def moves(head: FakeHead) -> list[HeadAim | None]:
    return [aim for _, aim in head.commands]


def test_nothing_moves_before_it_is_enabled(job: HeadJob, fake_head: FakeHead) -> None:
    job.commands.put(ASIDE)
    job.turn()
    assert moves(fake_head) == []
    assert not job.enabled
    assert not fake_head.enabled
    assert {reading.axis for reading in job.readings.take_all()} == {"pan", "tilt"}


def test_a_command_made_before_enabling_is_dropped_and_the_next_is_obeyed(job: HeadJob, fake_head: FakeHead) -> None:
    job.commands.put(ASIDE)
    job.resume()
    job.turn()
    assert job.enabled
    assert moves(fake_head) == []
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head) == [BELOW]


def test_one_that_starts_by_itself_is_enabled_with_its_first_turn_and_not_by_opening(
    fake_head: FakeHead, guardian: GuardianLink
) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    assert not fake_head.enabled
    assert not job.enabled
    job.turn()
    assert fake_head.enabled
    assert job.enabled
    job.close()


def test_only_the_newest_command_is_sent(job: HeadJob, fake_head: FakeHead) -> None:
    job.resume()
    job.turn()
    job.commands.put(ASIDE)
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head) == [BELOW]


def test_a_stop_disables_and_clears_what_waits(job: HeadJob, fake_head: FakeHead) -> None:
    job.resume()
    job.turn()
    job.commands.put(ASIDE)
    stopper = threading.Thread(target=job.stop)
    stopper.start()
    stopper.join()
    assert not job.enabled
    job.turn()
    job.turn()
    assert moves(fake_head) == [None]
    assert not fake_head.enabled


@dataclass
class Meanwhile:
    """A head to which another thread does something just before or after it is enabled; ``wire`` is its port."""

    head: FakeHead
    before: Callable[[], None] = nothing
    after: Callable[[], None] = nothing
    wire: int = -1

    def enable(self) -> None:
        in_a_thread(self.before)
        self.head.enable()
        in_a_thread(self.after)

    def open(self) -> None:
        self.head.open()

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        self.head.move_to(pan_rad, tilt_rad)

    def read(self, timeout_s: float) -> tuple[()]:
        return ()

    def guard(self) -> Guard:
        return Guard(self.wire, b"stop") if self.wire >= 0 else self.head.guard()

    def stop(self) -> None:
        self.head.stop()

    def close(self) -> None:
        self.head.close()


@pytest.mark.parametrize("moment", ["before", "after"])
def test_a_stop_in_the_midst_of_enabling_has_the_last_word(
    fake_head: FakeHead, guardian: GuardianLink, moment: str
) -> None:
    head = Meanwhile(fake_head)
    job = HeadJob("pt1", head, guardian, auto_enable=True)
    setattr(head, moment, job.stop)
    job.open()
    job.turn()
    assert not job.enabled
    assert not fake_head.enabled
    job.commands.put(ASIDE)
    job.turn()
    assert set(moves(fake_head)) == {None}
    job.close()


def test_a_head_held_and_resumed_in_the_midst_of_enabling_moves_again(
    fake_head: FakeHead, guardian: GuardianLink
) -> None:
    head = Meanwhile(fake_head)
    job = HeadJob("pt1", head, guardian, auto_enable=True)

    def hold_and_resume() -> None:
        job.stop()
        job.resume()

    head.after = hold_and_resume
    job.open()
    job.turn()
    head.after = nothing
    for _ in range(3):
        job.commands.put(ASIDE)
        job.turn()
    assert moves(fake_head)[-1] == ASIDE
    job.close()


def test_no_move_follows_a_stop_however_the_threads_meet(job: HeadJob, fake_head: FakeHead) -> None:
    ending = threading.Event()

    def work() -> None:
        while not ending.is_set():
            job.commands.put(ASIDE)
            job.turn()
            job.readings.clear()

    worker = threading.Thread(target=work)
    worker.start()
    try:
        for _ in range(100):
            before = len(fake_head.commands)
            job.resume()
            until(lambda before=before: ASIDE in moves(fake_head)[before:])  # type: ignore[misc]
            job.stop()
            stopped = len(fake_head.commands)
            time.sleep(0.001)
            assert ASIDE not in moves(fake_head)[stopped:]
    finally:
        ending.set()
        worker.join()


def test_nothing_commanded_before_a_lost_link_is_replayed(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    job.turn()
    fake_head.faults.unplug()
    job.commands.put(ASIDE)
    with pytest.raises(LinkLost):
        job.turn()
    job.commands.put(ASIDE)  # control has not heard of it yet
    job.close()
    assert not job.enabled
    fake_head.faults.replug()
    job.open()
    job.commands.put(ASIDE)  # nor of the new link
    job.turn()
    job.turn()
    assert ASIDE not in moves(fake_head)
    assert job.enabled
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head)[-1] == BELOW
    job.close()


def test_a_head_held_while_its_link_was_lost_stays_held(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    job.turn()
    fake_head.faults.unplug()
    with pytest.raises(LinkLost):
        job.turn()
    job.close()
    job.stop()
    fake_head.faults.replug()
    job.open()
    job.commands.put(ASIDE)
    job.turn()
    assert not job.enabled
    assert ASIDE not in moves(fake_head)
    job.close()


def test_the_guardian_stops_an_open_head_when_the_daemon_dies(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian)
    job.open()
    guardian.close()
    assert fake_head.guarded() == b"stop" * 3
    job.close()


def test_the_guardian_lets_go_of_a_closed_head(fake_head: FakeHead, guardian: GuardianLink) -> None:
    reader, writer = os.pipe()
    job = HeadJob("pt1", Meanwhile(fake_head, wire=writer), guardian, auto_enable=True)
    job.open()
    job.turn()
    job.close()
    guardian.close()
    os.close(writer)
    assert os.read(reader, 64) == b""
    os.close(reader)


def test_a_head_is_not_served_without_its_guardian(fake_head: FakeHead, guardian: GuardianLink) -> None:
    guardian.close()
    job = head_job(fake_head, guardian, auto=True)
    with pytest.raises(HardwareError, match=r"guardian process is gone .*'pt1' must not be enabled"):
        job.open()
    job.close()


class Measured(FakeHead):
    """A head whose driver takes what anchors show of its angles."""

    def __init__(self, spec: HeadSpec) -> None:
        super().__init__(spec)
        self.told: list[AxisReading] = []

    def correct(self, reading: AxisReading) -> None:
        self.told.append(reading)


def test_what_anchors_show_of_it_reaches_the_driver_that_wants_it(guardian: GuardianLink, fake_head: FakeHead) -> None:
    head = Measured(fake_head.spec)
    job = head_job(head, guardian)
    job.open()
    shown = AxisReading("pt1", "pan", 0.3, 1.0, 0.001, 0.0005)
    job.seen.put(shown)
    job.turn()
    job.turn()
    assert head.told == [shown]
    job.seen.put(shown)
    job.close()
    job.open()  # what was seen before a link was lost tells nothing of the head that came back
    job.turn()
    assert head.told == [shown]
    job.close()


def test_a_driver_that_measures_itself_is_left_alone(job: HeadJob) -> None:
    job.seen.put(AxisReading("pt1", "pan", 0.3, 1.0, 0.001, 0.0005))
    job.turn()
    assert len(job.seen.take_all()) == 0


class TestOperatorsAim:
    """An operator sends a head somewhere; plans keep off it until it is resumed."""

    def test_it_moves_a_head_that_nobody_resumed_and_plans_do_not_move_it(
        self, job: HeadJob, fake_head: FakeHead
    ) -> None:
        job.aim(ASIDE)
        job.turn()
        job.commands.put(BELOW)
        job.turn()
        assert moves(fake_head) == [ASIDE]
        assert (job.enabled, job.follows_plans, job.aimed) == (True, False, ASIDE)

    def test_resume_gives_it_back_without_what_plans_wanted_before(self, job: HeadJob, fake_head: FakeHead) -> None:
        job.aim(ASIDE)
        job.turn()
        job.commands.put(BELOW)
        job.resume()
        job.turn()
        assert moves(fake_head) == [ASIDE]
        assert (job.follows_plans, job.aimed) == (True, None)

    def test_a_stop_ends_it(self, job: HeadJob, fake_head: FakeHead) -> None:
        job.aim(ASIDE)
        job.stop()
        job.turn()
        assert moves(fake_head) == [None]
        assert (job.enabled, job.aimed) == (False, None)

    def test_after_a_lost_link_it_is_not_replayed_and_plans_still_keep_off(
        self, job: HeadJob, fake_head: FakeHead
    ) -> None:
        job.aim(ASIDE)
        job.close()
        job.open()
        for _ in range(3):
            job.commands.put(BELOW)
            job.turn()
        assert moves(fake_head) == []
        assert (job.enabled, job.follows_plans, job.aimed) == (True, False, ASIDE)

    def test_one_that_did_not_go_through_does_not_count_as_told(self, job: HeadJob, fake_head: FakeHead) -> None:
        job.aim(ASIDE)
        job.turn()
        job.aim(BELOW)
        fake_head.stop()  # a stop of another thread, between the order and the wire
        job.turn()
        assert moves(fake_head) == [ASIDE, None]
        job.turn()
        assert moves(fake_head) == [ASIDE, None, BELOW]

    def test_it_is_told_again_while_the_head_is_not_there_but_not_for_ever(
        self, job: HeadJob, fake_head: FakeHead, manual_clock: ManualClock
    ) -> None:
        fake_head.faults.drop_next(100)
        job.aim(ASIDE)
        for turn in range(8):
            job.turn()
            manual_clock.advance(1.0)
            if turn == 3:
                fake_head.faults.drop_next(0)
        assert moves(fake_head) == [ASIDE]
        job.aim(BELOW)
        fake_head.faults.drop_next(100)
        for _ in range(30):
            job.turn()
            manual_clock.advance(1.0)
        fake_head.faults.drop_next(0)
        job.turn()
        assert moves(fake_head) == [ASIDE]

    def test_polls_and_answers_are_counted(self, job: HeadJob, fake_head: FakeHead) -> None:
        job.turn()
        fake_head.faults.silent = True
        job.turn()
        assert job.statistics() == {"polls": 2, "answers": 1}


def test_a_head_that_was_lent_is_stopped_when_it_is_taken_back(job: HeadJob, fake_head: FakeHead) -> None:
    job.lend()
    job.close()
    job.open()
    assert moves(fake_head) == [None]
    job.close()
    job.open()
    assert moves(fake_head) == [None]
