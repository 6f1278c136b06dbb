"""A device's thread: it comes back from a lost link, ends with its input, and keeps the exception that is a bug."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from camrig.clock import Clock, ManualClock, RealClock
from camrig.errors import EndOfInput, HardwareError, LinkLoss, LinkLost
from camrig.messages import LinkReport, LinkStatus
from camrig.runtime import worker as worker_module
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.worker import FIRST_RETRY_S, Worker
from tests.runtime_parts import nothing, until

UP, LOST, CLOSED = LinkStatus.UP, LinkStatus.LOST, LinkStatus.CLOSED


def failing(error: BaseException) -> Callable[[], None]:
    """Return what raises ``error``."""

    def fail() -> None:
        raise error

    return fail


@dataclass
class ScriptedJob:
    """Does what its scripts say, one step a call, then blocks in ``turn`` until woken; ``calls`` logs what was when."""

    opens: list[Callable[[], None]] = field(default_factory=list)
    turns: list[Callable[[], None]] = field(default_factory=list)
    closing: Callable[[], None] = nothing
    name: str = "north"
    calls: list[tuple[str, float]] = field(default_factory=list)
    blocked: threading.Event = field(default_factory=threading.Event)
    woken: threading.Event = field(default_factory=threading.Event)

    def open(self) -> None:
        self._note("open")
        self._next(self.opens)()

    def turn(self) -> None:
        self._note("turn")
        if not self.turns:
            self.blocked.set()
            assert self.woken.wait(10.0), "nobody woke the job"
            return
        self._next(self.turns)()

    def close(self) -> None:
        self._note("close")
        self.closing()

    def wake(self) -> None:
        self.woken.set()

    def names(self) -> list[str]:
        return [name for name, _ in self.calls]

    def _note(self, what: str) -> None:
        self.calls.append((what, RealClock().now_s()))

    @staticmethod
    def _next(script: list[Callable[[], None]]) -> Callable[[], None]:
        return script.pop(0) if script else nothing


@dataclass
class Running:
    """A worker under test, and everything that it has reported."""

    worker: Worker
    box: Mailbox[LinkReport]
    failures: list[str]
    reports: list[LinkReport] = field(default_factory=list)

    def statuses(self) -> list[LinkStatus]:
        self.reports += self.box.take_all()
        return [report.status for report in self.reports]

    def stop(self) -> bool:
        self.worker.request_stop()
        return self.worker.join(2.0)


@contextmanager
def running(job: ScriptedJob, clock: Clock | None = None) -> Iterator[Running]:
    box: Mailbox[LinkReport] = Mailbox(64)
    failures: list[str] = []
    found = Running(Worker(job, clock or RealClock(), box, lambda: failures.append("failed")), box, failures)
    found.worker.start()
    try:
        yield found
    finally:
        assert found.stop()


def test_its_thread_bears_the_devices_name() -> None:
    job = ScriptedJob()
    with running(job):
        until(job.blocked.is_set)
        assert "north" in {thread.name for thread in threading.enumerate()}


def test_a_lost_link_is_reopened() -> None:
    job = ScriptedJob(turns=[nothing, failing(LinkLost("unplugged"))])
    with running(job) as found:
        until(job.blocked.is_set)
        assert found.statuses() == [UP, LOST, UP]
        assert found.reports[1] == LinkReport("north", LOST, found.reports[1].stamp_s, "unplugged", LinkLoss.FAILED)
        assert job.names() == ["open", "turn", "turn", "close", "open", "turn"]
    assert found.statuses() == [UP, LOST, UP, CLOSED]
    assert job.names()[-1] == "close"
    assert found.failures == []
    assert found.worker.failed is None
    assert not found.worker.ended


def test_it_tries_again_ever_later_and_soon_again_once_it_was_up() -> None:
    silent = LinkLost("does not answer")
    job = ScriptedJob(opens=[failing(silent), failing(silent), nothing, nothing], turns=[nothing, failing(silent)])
    with running(job) as found:
        until(job.blocked.is_set)
        assert found.statuses() == [LOST, LOST, UP, LOST, UP]
    tried_s = [stamp_s for name, stamp_s in job.calls if name == "open"]
    first_s, second_s, third_s = (later - earlier for earlier, later in pairwise(tried_s))
    assert first_s >= FIRST_RETRY_S
    assert second_s >= 2.0 * FIRST_RETRY_S
    assert FIRST_RETRY_S <= third_s < 4.0 * FIRST_RETRY_S


def test_the_wait_between_two_tries_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "FIRST_RETRY_S", 0.001)
    monkeypatch.setattr(worker_module, "LAST_RETRY_S", 0.004)
    job = ScriptedJob(opens=[failing(LinkLost("silent"))] * 30)
    with running(job):  # doubled 30 times, the wait would be 12 days
        until(job.blocked.is_set)


def test_a_stop_does_not_wait_for_the_next_try(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "FIRST_RETRY_S", 60.0)
    job = ScriptedJob(opens=[failing(LinkLost("silent"))])
    with running(job) as found:
        until(lambda: found.statuses() == [LOST])
        assert found.stop()
    assert job.names() == ["open", "close", "close"]
    assert found.statuses() == [LOST, CLOSED]


@pytest.mark.parametrize("where", ["opens", "turns"])
def test_an_unexpected_exception_is_kept_and_reported_and_the_device_closed(
    where: str, caplog: pytest.LogCaptureFixture
) -> None:
    bug = RuntimeError("a bug")
    job = ScriptedJob(**{where: [failing(bug)]})  # type: ignore[arg-type]
    with running(job) as found:
        assert found.worker.join(2.0)
        assert found.worker.failed is bug
        assert found.failures == ["failed"]
        assert job.names()[-1] == "close"
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None
    assert record.exc_info[1] is bug


def test_a_device_that_is_not_what_was_configured_is_one_sentence_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    wrong = HardwareError("camera north delivers 640 x 480, not 1280 x 720")
    with running(ScriptedJob(opens=[failing(wrong)])) as found:
        assert found.worker.join(2.0)
    assert found.worker.failed is wrong
    assert found.failures == ["failed"]
    (record,) = caplog.records
    assert record.getMessage() == "north: camera north delivers 640 x 480, not 1280 x 720"
    assert not record.exc_info


def test_a_device_that_cannot_be_closed_is_a_failure_too() -> None:
    bug = OSError("no such descriptor")
    job = ScriptedJob(closing=failing(bug))
    with running(job) as found:
        until(job.blocked.is_set)
        assert found.stop()
        assert found.worker.failed is bug
        assert found.failures == ["failed"]


def test_the_end_of_a_recording_ends_it_without_a_failure() -> None:
    job = ScriptedJob(turns=[nothing, failing(EndOfInput())])
    with running(job) as found:
        assert found.worker.join(2.0)
        assert found.worker.ended
        assert found.worker.failed is None
        assert found.failures == []
        assert found.statuses() == [UP, CLOSED]
        assert found.reports[-1].reason == "end of input"
        assert job.names() == ["open", "turn", "turn", "close"]


def test_a_stop_ends_a_blocked_one_at_once() -> None:
    job = ScriptedJob()
    with running(job) as found:
        until(job.blocked.is_set)
        assert not found.worker.join(0.01)
        assert found.stop()
        assert found.statuses() == [UP, CLOSED]
        assert found.reports[-1].reason == "stopped"


def test_one_that_was_never_started_can_be_stopped() -> None:
    job = ScriptedJob()
    worker = Worker(job, RealClock(), Mailbox(1), nothing)
    worker.request_stop()
    assert worker.join(0.0)
    assert job.names() == []


def test_it_beats_with_every_turn() -> None:
    clock = ManualClock(start_s=100.0)
    go = [threading.Event(), threading.Event()]
    job = ScriptedJob(turns=[lambda: _waited(go[0]), lambda: _waited(go[1])])
    with running(job, clock) as found:
        until(lambda: job.names() == ["open", "turn"])
        clock.advance(5.0)
        assert found.worker.beat_s == 100.0  # a turn that hangs does not beat
        go[0].set()
        until(lambda: job.names() == ["open", "turn", "turn"])
        assert found.worker.beat_s == 105.0
        clock.advance(1.0)
        go[1].set()
        until(job.blocked.is_set)
        assert found.worker.beat_s == 106.0


def _waited(event: threading.Event) -> None:
    assert event.wait(10.0)


def test_a_device_is_lent_for_a_while_and_opened_again() -> None:
    job, clock = ScriptedJob(), ManualClock()
    with running(job, clock) as found:
        until(job.blocked.is_set)
        found.worker.lend(10.0)
        until(lambda: found.statuses() == [UP, CLOSED])
        assert found.reports[1].reason == worker_module.LENT
        assert job.names() == ["open", "turn", "close"]
        found.worker.lend(20.0)  # renewed
        clock.advance(15.0)
        time.sleep(0.3)
        assert found.statuses() == [UP, CLOSED]
        job.woken.clear()
        clock.advance(10.0)
        until(lambda: found.statuses() == [UP, CLOSED, UP])


def test_a_worker_that_is_to_end_does_not_wait_for_what_it_lent() -> None:
    job = ScriptedJob()
    with running(job) as found:
        until(job.blocked.is_set)
        found.worker.lend(1e12)
        until(lambda: found.statuses() == [UP, CLOSED])
