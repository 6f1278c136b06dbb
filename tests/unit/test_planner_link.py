"""The planner's process seen from the control thread: it answers, it is replaced when it dies, it leaves nothing."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from camrig.clock import ManualClock
from camrig.errors import HardwareError
from camrig.messages import HeadAim, PlannerAnswer, PlanRequest, PlanTarget, RigPlan, ScanPlan, ScanRequest
from camrig.optimise import PlannerSettings
from camrig.runtime.planner_link import ANSWER_LIMIT_S, PlannerLink
from tests.runtime_parts import one_head_rig, until

START_TIMEOUT_S = 20.0
"""A process that imports scipy on a busy machine."""


@pytest.fixture
def planner() -> Iterator[PlannerLink]:
    link = PlannerLink(one_head_rig(), PlannerSettings())
    yield link
    link.close()


def request(request_id: int) -> PlanRequest:
    aims = {"north": HeadAim(0.0, -1.0)}
    return PlanRequest(request_id, 5.0, (PlanTarget("robot1", (3.0, 2.0, 0.0), 0.2),), aims, ("north",), 0.2)


def answer(planner: PlannerLink) -> PlannerAnswer:
    answers: list[PlannerAnswer] = []

    def came() -> bool:
        found = planner.poll()
        answers.extend([] if found is None else [found])
        return bool(answers)

    until(came, START_TIMEOUT_S)
    return answers[0]


def children() -> set[int]:
    tasks = Path("/proc/self/task").glob("*/children")
    return {int(pid) for task in tasks for pid in task.read_text().split()}


def kill_planner() -> int:
    """Kill the only child there is, and wait until it is dead."""
    (pid,) = children()
    os.kill(pid, signal.SIGKILL)
    until(lambda: Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z")
    return pid


def test_plans_and_scans_are_answered_by_the_process(planner: PlannerLink) -> None:
    assert planner.idle
    assert planner.poll() is None
    planner.submit(request(7))
    assert not planner.idle
    plan = answer(planner)
    assert isinstance(plan, RigPlan)
    assert (plan.request_id, plan.stamp_s) == (7, 5.0)
    assert plan.targets["robot1"].seen_by == ("north",)
    assert planner.idle
    planner.submit(ScanRequest(8, 6.0, {"north": HeadAim(0.0, -1.0)}, ("north",), 0.5))
    scan = answer(planner)
    assert isinstance(scan, ScanPlan)
    assert scan.request_id == 8
    assert scan.stops


def test_a_planner_killed_while_it_owes_an_answer_still_answers(planner: PlannerLink) -> None:
    planner.submit(request(1))
    first = kill_planner()  # it is still importing
    plan = answer(planner)
    assert plan.request_id == 1
    assert first not in children()
    assert planner.idle


def test_a_planner_killed_while_idle_takes_the_next_request(planner: PlannerLink) -> None:
    kill_planner()
    assert planner.poll() is None
    assert planner.idle
    planner.submit(request(2))
    assert answer(planner).request_id == 2


def test_a_planner_that_hangs_is_replaced_and_its_request_answered() -> None:
    clock = ManualClock()
    link = PlannerLink(one_head_rig(), PlannerSettings(), clock)
    try:
        link.submit(request(5))
        (hung,) = children()
        os.kill(hung, signal.SIGSTOP)
        clock.advance(ANSWER_LIMIT_S + 1.0)
        assert answer(link).request_id == 5
        assert hung not in children()
    finally:
        link.close()


def test_a_request_that_kills_every_planner_ends_the_rig(planner: PlannerLink) -> None:
    planner.submit(request(3))
    for _ in range(2):
        kill_planner()
        assert planner.poll() is None
    kill_planner()
    with pytest.raises(HardwareError, match=r"died \(exit code -9\) 3 times over one request"):
        planner.poll()


def test_closing_ends_the_process_even_in_the_midst_of_a_request_and_twice(planner: PlannerLink) -> None:
    planner.submit(request(4))
    began_s = time.monotonic()
    planner.close()
    planner.close()
    assert children() == set()
    assert time.monotonic() - began_s < 0.5


DAEMON = """\
import sys, time
from camrig.optimise import PlannerSettings
from camrig.runtime.planner_link import PlannerLink
from tests.runtime_parts import one_head_rig
link = PlannerLink(one_head_rig(), PlannerSettings())
print(open("/proc/thread-self/children").read(), flush=True)
time.sleep(60.0)
"""


def test_a_planner_that_hears_nothing_ends_with_a_daemon_that_was_killed() -> None:
    """As one does that is deep in a search: until it is gone, systemd starts no other daemon."""
    with subprocess.Popen([sys.executable, "-c", DAEMON], stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        planner = int(daemon.stdout.readline())
        until(lambda: _ignores(planner, signal.SIGTERM), START_TIMEOUT_S)  # the last that it does before it serves
        os.kill(planner, signal.SIGSTOP)
        daemon.kill()
    until(lambda: not _runs(planner))


def _ignores(pid: int, number: signal.Signals) -> bool:
    found = re.search(r"^SigIgn:\s*([0-9a-f]+)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> (number - 1) & 1)


def _runs(pid: int) -> bool:
    """Tell whether there is such a process, and not only what it ended with, which nobody has asked for yet."""
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
