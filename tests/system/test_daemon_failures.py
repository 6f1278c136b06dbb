"""What breaks in a daemon: its processes, its workers, its outputs. The rig comes to rest, and the cause is told."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from pydantic import BaseModel

from camrig.clock import ManualClock
from camrig.config.rig_file import PluginConfig, RigConfig
from camrig.config.settings import settings_of
from camrig.errors import HardwareError, InputError
from camrig.geometry.arrays import GreyImage
from camrig.interfaces import Driver, Plugin, Published
from camrig.messages import TagDetection
from camrig.rig import HeadSpec, Rig
from camrig.runtime.daemon import BEAT_LIMIT_S, Daemon
from camrig.runtime.notify import Notifier
from camrig_emulators.fakes import FakeHead
from tests.daemon_on_fakes import Log, at_rest, has_moved, head, supervising
from tests.runtime_parts import until


def test_a_planner_that_is_killed_does_not_end_the_scan(daemon: Daemon) -> None:
    _kill("planner_process")
    until(lambda: has_moved(daemon, "pt1"), 20.0)
    daemon.supervise(time.monotonic())  # nothing failed


def test_without_a_guardian_nothing_goes_on(daemon: Daemon) -> None:
    _kill("guardian.py")
    with pytest.raises(HardwareError, match="the guardian process is gone"):
        daemon.supervise(time.monotonic() + 5.0)
    daemon.stop()
    assert at_rest(daemon)


def _is_dead(process: int) -> bool:
    """Tell whether a process is a zombie, or was reaped already: the daemon may be quicker than we are."""
    try:
        return Path(f"/proc/{process}/cmdline").read_text() == ""
    except FileNotFoundError:
        return True


def _kill(program: str) -> None:
    tasks = Path("/proc/self/task").glob("*/children")
    pids = [pid for task in tasks for pid in task.read_text().split()]
    (found,) = [int(pid) for pid in pids if program in Path(f"/proc/{pid}/cmdline").read_text()]
    os.kill(found, signal.SIGKILL)
    until(lambda: _is_dead(found))


class Nothing(BaseModel):
    """The section of what a test plugs in."""


class Broken(RuntimeError):  # noqa: N818 - what it stands for is a bug, of no kind of its own
    """A bug."""


@dataclass
class BrokenDetector:
    """Fails at its fourth picture."""

    seen: int = 0

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        self.seen += image.size > 0
        if self.seen > 3:
            raise Broken("in the detector")
        return ()


@dataclass
class BrokenStop:
    """A head that cannot be stopped, at all."""

    head: FakeHead

    def __getattr__(self, name: str) -> object:
        return getattr(self.head, name)

    def stop(self) -> None:
        raise Broken("in stop")


def _fail_after(ticks: int) -> Callable[[Published], None]:
    left = iter(range(ticks))

    def fail(published: Published) -> None:
        if next(left, None) is None:
            raise Broken(f"in a sink, at {published.stamp_s}")

    return fail


def _run_until_it_fails(daemon: Daemon) -> None:
    try:
        daemon.start()
        daemon.supervise(time.monotonic() + 10.0)
    finally:
        daemon.stop()


def test_a_failing_sink_ends_the_rig_with_its_own_exception(config: RigConfig) -> None:
    good = Log()
    daemon = Daemon(config, settings_of(config), extra_sinks=[good, Log(each=_fail_after(10))])
    with pytest.raises(Broken, match="in a sink"):
        _run_until_it_fails(daemon)
    assert at_rest(daemon)
    assert good.closed_s is not None


def test_a_failing_worker_ends_the_rig_with_its_own_exception(config: RigConfig) -> None:
    detector = PluginConfig("broken", Plugin(Nothing, lambda _: BrokenDetector()), Nothing())
    daemon = Daemon(replace(config, detector=detector), settings_of(config))
    with pytest.raises(Broken, match="in the detector"):
        _run_until_it_fails(daemon)
    assert at_rest(daemon)


def test_a_head_that_cannot_be_stopped_does_not_keep_the_others_from_their_stop(config: RigConfig) -> None:
    def make(heads: Mapping[str, tuple[HeadSpec, object]]) -> dict[str, object]:
        fakes = config.devices["heads"]["pt1"].driver.make(heads)
        return {"pt1": BrokenStop(fakes["pt1"]), "pt2": fakes["pt2"]}

    driver: Driver[HeadSpec, object] = Driver(section=Nothing, make=make)
    heads = {name: replace(device, driver=driver) for name, device in config.devices["heads"].items()}
    daemon = Daemon(replace(config, devices={**config.devices, "heads": heads}), settings_of(config))
    daemon.start()
    until(lambda: daemon.view().enabled == {"pt1", "pt2"})
    assert daemon.hold() == {"pt1": "in stop"}
    assert not head(daemon, "pt2").enabled
    assert head(daemon, "pt2").commands[-1][1] is None
    daemon.stop()


def test_an_output_that_cannot_be_opened_ends_the_start_and_nothing_has_moved(config: RigConfig) -> None:
    def refuse(rig: Rig) -> None:
        raise InputError(f"output of {rig.name} cannot be written")

    good = Log()
    daemon = Daemon(config, settings_of(config), extra_sinks=[good, Log(opening=refuse)])
    with pytest.raises(InputError, match="output of fakes cannot be written"):
        daemon.start()
    assert good.closed_s is not None
    assert {aim for name in ("pt1", "pt2") for _, aim in head(daemon, name).commands} <= {None}


def test_a_sink_that_cannot_be_closed_leaves_nothing_else_open(config: RigConfig) -> None:
    def fail() -> None:
        raise Broken("in close")

    good = Log()
    daemon = Daemon(config, settings_of(config), extra_sinks=[good, Log(closing=fail)])
    daemon.start()
    with pytest.raises(Broken, match="in close"):
        daemon.stop()
    assert good.closed_s is not None  # and the leak check finds neither planner nor guardian


def test_the_watchdog_is_fed_only_while_every_thread_beats(config: RigConfig, tmp_path: Path) -> None:
    clock, gate, blocked = ManualClock(time.monotonic()), threading.Event(), threading.Event()

    def block(_: Published) -> None:
        if not gate.is_set():
            blocked.set()
            gate.wait(20.0)

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(tmp_path / "notify"))
        supervisor.settimeout(2.0)
        notifier = Notifier(supervisor.getsockname())
        daemon = Daemon(config, settings_of(config), [Log(each=block)], clock=clock, notifier=notifier)
        gate.set()
        daemon.start()
        main = supervising(daemon)
        try:
            assert supervisor.recv(1024).startswith(b"STATUS=loading machine code")
            assert supervisor.recv(1024) == b"READY=1"
            assert _told(supervisor, turns=1) == ["alive"]
            gate.clear()
            assert blocked.wait(5.0)  # control hangs in an output; every device's thread works on
            clock.advance(BEAT_LIMIT_S + 1.0)
            assert _told(supervisor, turns=5)[-3:] == ["silent"] * 3
            gate.set()
            assert _told(supervisor, turns=3)[-1:] == ["alive"]
        finally:
            gate.set()
            daemon.request_stop()
            main.join()
            daemon.stop()
        assert supervisor.recv(1024) == b"STOPPING=1"


def _told(supervisor: socket.socket, turns: int) -> list[str]:
    """Return for so many turns of supervision, each of which ends with a status, whether the watchdog was fed."""
    told: list[str] = []
    fed = False
    while len(told) < turns:
        message = supervisor.recv(1024)
        fed = fed or message == b"WATCHDOG=1"
        if message.startswith(b"STATUS="):
            told.append("alive" if fed else "silent")
            fed = False
    return told
