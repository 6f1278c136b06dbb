"""The daemon in this process, on fakes: it comes to rest, motion first, whatever ends it."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from pydantic import BaseModel

from camrig.clock import ManualClock
from camrig.config.rig_file import PluginConfig, RigConfig, load_rig
from camrig.config.settings import settings_of
from camrig.errors import HardwareError, InputError
from camrig.geometry.arrays import GreyImage
from camrig.interfaces import Driver, Plugin, Published
from camrig.messages import LinkStatus, TagDetection
from camrig.rig import HeadSpec, Rig
from camrig.runtime.daemon import BEAT_LIMIT_S, Daemon
from camrig.runtime.notify import Notifier
from camrig_emulators.fakes import FakeCamera, FakeDrone, FakeHead
from tests.runtime_parts import until

RIG = """\
rig: fakes
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}
cameras:
  - {id: north, lens: lab, source: {driver: fake, fps: 10}, mount: {head: pt1}}
  - {id: south, lens: lab, source: {driver: fake, fps: 10}, mount: {head: pt2}}
heads:
  - {id: pt1, driver: fake, enable: auto, position_m: [1, 1.5, 2.8], tilt_deg: [-90, 0]}
  - {id: pt2, driver: fake, enable: auto, position_m: [4, 1.5, 2.8], tilt_deg: [-90, 0]}
targets:
  - {id: robot1, tags: [{id: 1, size_m: 0.2}]}
"""

DRONE = """\
drones:
  - {id: d1, driver: fake, box_m: [[1, 1, 1.2], [4, 2, 2.2]]}
"""
SKY = "  - {id: sky, lens: lab, source: {driver: fake}, mount: {drone: d1}}\n"


def _nothing(*_: object) -> None:
    """Do nothing."""


@dataclass
class Log:
    """A sink that keeps what it is given, and does what a test wants done as it is opened, written to and closed."""

    opening: Callable[[Rig], None] = _nothing
    each: Callable[[Published], None] = _nothing
    closing: Callable[[], None] = _nothing
    published: list[Published] = field(default_factory=list)
    closed_s: float | None = None

    def open(self, rig: Rig) -> None:
        self.opening(rig)

    def write(self, published: Published) -> None:
        self.published.append(published)
        self.each(published)

    def close(self) -> None:
        self.closed_s = time.monotonic()
        self.closing()

    def said(self) -> list[str]:
        return [f"{event.about}: {event.text}" for published in self.published for event in published.events]


def _load(folder: Path, text: str) -> RigConfig:
    path = folder / "rig.yaml"
    path.write_text(text)
    return load_rig(path)


@pytest.fixture
def config(tmp_path: Path) -> RigConfig:
    return _load(tmp_path, RIG)


@pytest.fixture
def daemon(config: RigConfig) -> Iterator[Daemon]:
    """Return a started daemon on fakes."""
    found = Daemon(config, settings_of(config), extra_sinks=[Log()])
    found.start()
    yield found
    found.stop()


def head(daemon: Daemon, name: str) -> FakeHead:
    found = daemon.devices.heads[name].head
    assert isinstance(found, FakeHead)
    return found


def log(daemon: Daemon) -> Log:
    (found,) = daemon.extra_sinks
    assert isinstance(found, Log)
    return found


def has_moved(daemon: Daemon, name: str) -> bool:
    return any(aim is not None for _, aim in head(daemon, name).commands)


def supervising(daemon: Daemon) -> threading.Thread:
    """Supervise in a thread, as the main one does."""
    thread = threading.Thread(target=daemon.supervise)
    thread.start()
    return thread


def at_rest(daemon: Daemon) -> bool:
    """Tell whether a stop was the last that both heads were told."""
    fakes = [head(daemon, name) for name in ("pt1", "pt2")]
    return all(not fake.enabled and fake.commands[-1][1] is None for fake in fakes)


def test_it_scans_by_itself_and_comes_to_rest_when_asked(daemon: Daemon) -> None:
    main = supervising(daemon)
    until(lambda: has_moved(daemon, "pt1") and has_moved(daemon, "pt2"), 20.0)
    assert daemon.status_line() == "scanning: 0 of 1 targets"
    asked_s = time.monotonic()
    daemon.request_stop()
    main.join(1.0)
    assert not main.is_alive()
    daemon.stop()
    assert time.monotonic() - asked_s < 2.0
    assert at_rest(daemon)
    time.sleep(0.3)  # a ramp down takes this long
    now_s = time.monotonic()
    assert head(daemon, "pt1").true_angles_rad(now_s) == head(daemon, "pt1").true_angles_rad(now_s + 60.0)
    daemon.stop()  # twice is allowed


def test_motion_ends_before_anything_else_does(daemon: Daemon) -> None:
    until(lambda: has_moved(daemon, "pt1") and has_moved(daemon, "pt2"), 20.0)
    daemon.stop()
    orders = [order for name in ("pt1", "pt2") for order in head(daemon, name).commands]
    stopped_s = min(stamp_s for stamp_s, aim in orders if aim is None)
    assert max(stamp_s for stamp_s, aim in orders if aim is not None) < stopped_s + 0.05
    ended = [report for report in daemon.control.links.take_all() if report.status is LinkStatus.CLOSED]
    both_s = max(min(stamp_s for stamp_s, aim in head(daemon, name).commands if aim is None) for name in ("pt1", "pt2"))
    assert all(report.stamp_s > both_s for report in ended)
    closed_s = log(daemon).closed_s
    assert closed_s is not None
    assert both_s < closed_s


def test_a_drone_climbs_when_armed_alone_and_holds_at_the_end(tmp_path: Path) -> None:
    config = _load(tmp_path, RIG.replace("heads:\n", SKY + "heads:\n", 1) + DRONE)
    daemon = Daemon(config, settings_of(config))
    daemon.start()
    fake = daemon.devices.drones["d1"].drone
    assert isinstance(fake, FakeDrone)
    until(lambda: daemon.control.link_states.get("d1") is LinkStatus.UP)
    assert fake.T_world_body()[2, 3] == 0.0
    daemon.arm("d1")
    until(lambda: fake.T_world_body()[2, 3] > 0.1)
    daemon.stop()
    height_m = fake.T_world_body()[2, 3]
    time.sleep(0.1)
    assert fake.T_world_body()[2, 3] == height_m


def test_holding_stops_the_heads_and_leaves_the_rest_at_work(daemon: Daemon) -> None:
    until(lambda: has_moved(daemon, "pt1"), 20.0)
    assert daemon.hold() == {}
    assert at_rest(daemon)
    held = len(head(daemon, "pt1").commands)
    ticks = len(log(daemon).published)
    until(lambda: len(log(daemon).published) > ticks + 20)
    assert len(head(daemon, "pt1").commands) == held
    assert daemon.view().enabled == frozenset()
    daemon.resume(["pt1"])
    until(lambda: daemon.view().enabled == {"pt1"})
    until(lambda: head(daemon, "pt1").commands[-1][1] is not None, 10.0)
    assert not head(daemon, "pt2").enabled


def test_it_ends_by_itself_when_every_recording_has_ended(daemon: Daemon) -> None:
    main = supervising(daemon)
    _end(daemon, "north")
    main.join(1.0)  # longer than the last detections are waited for
    assert main.is_alive()  # the other still delivers
    _end(daemon, "south")
    main.join(2.0)
    assert not main.is_alive()
    daemon.stop()
    assert at_rest(daemon)
    assert "north: link closed end of input" in log(daemon).said()


def _end(daemon: Daemon, camera: str) -> None:
    found = daemon.devices.cameras[camera].camera
    assert isinstance(found, FakeCamera)
    found.end()


def test_it_ends_at_the_time_it_is_given(daemon: Daemon) -> None:
    began_s = time.monotonic()
    daemon.supervise(began_s + 0.3)
    assert 0.3 <= time.monotonic() - began_s < 0.3 + 0.5
    assert not daemon.stop_requested


def test_a_lost_link_is_planned_around_and_comes_back(daemon: Daemon) -> None:
    until(lambda: daemon.control.link_states.get("pt1") is LinkStatus.UP)
    head(daemon, "pt1").faults.unplug()
    until(lambda: daemon.control.link_states.get("pt1") is LinkStatus.LOST)
    assert daemon.status_line() == "scanning: 0 of 1 targets; lost: pt1"
    until(lambda: "pt1: link lost: head pt1: the fake is unplugged" in log(daemon).said())
    head(daemon, "pt1").faults.replug()
    until(lambda: daemon.control.link_states.get("pt1") is LinkStatus.UP)
    until(lambda: daemon.view().enabled == {"pt1", "pt2"})


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


def _kill(program: str) -> None:
    tasks = Path("/proc/self/task").glob("*/children")
    pids = [pid for task in tasks for pid in task.read_text().split()]
    (found,) = [int(pid) for pid in pids if program in Path(f"/proc/{pid}/cmdline").read_text()]
    os.kill(found, signal.SIGKILL)
    until(lambda: Path(f"/proc/{found}/cmdline").read_text() == "")


# --- failures -------------------------------------------------------------------------------------------------


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
