"""A reload: the file is checked first and the running rig kept where it has faults; heads stand still in between."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from camrig.config.rig_file import load_rig
from camrig.errors import HardwareError
from camrig.messages import FlightState
from camrig.runtime.daemon import Daemon
from camrig.runtime.last_run import last_run
from camrig.runtime.operator import Operator
from camrig.runtime.operator_client import ask
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_status import RecentEvents
from camrig.runtime.reload import Run
from camrig_emulators.fakes import FakeDrone
from tests.daemon_on_fakes import RIG, Log, at_rest, has_moved
from tests.runtime_parts import until

DRONE = """\
drones:
  - {id: d1, driver: fake, box_m: [[1, 1, 1.2], [4, 2, 2.2]]}
"""
SKY = "  - {id: sky, lens: lab, source: {driver: fake}, mount: {drone: d1}}\n"
WITH_DRONE = RIG.replace("heads:\n", SKY + "heads:\n", 1) + DRONE


class Bench:
    """A rig's file, the run of it in a thread, and every daemon that was started."""

    def __init__(self, folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.file = folder / "rig.yaml"
        self.file.write_text(text)
        self.daemons: list[Daemon] = []
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.listener.bind(str(folder / "notify"))
        self.listener.setblocking(False)
        self.said: list[str] = []
        monkeypatch.setenv("NOTIFY_SOCKET", self.listener.getsockname())
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(str(folder / "operator"))
        self.run = Run(self.file, load_rig(self.file), [Log()], self._serving, kept_in=folder)

    def _serving(self, daemon: Daemon) -> AbstractContextManager[None]:
        self.daemons.append(daemon)
        return serving(self.socket.dup(), Operator(daemon, RecentEvents()), daemon.request_stop)

    @property
    def kept(self) -> str:
        """What a stop would go by after the daemon's death."""
        ran = last_run(self.file, [self.file.parent])
        return ran.text if ran is not None else ""

    @property
    def daemon(self) -> Daemon:
        until(lambda: bool(self.daemons), 20.0)
        return self.daemons[-1]

    def notified(self, text: str) -> bool:
        """Tell whether systemd was told so since the start or the last ``forget``."""
        while True:
            try:
                self.said.append(self.listener.recv(4096).decode())
            except BlockingIOError:
                return any(text in message for message in self.said)

    def reload(self, text: str) -> None:
        self.notified("")
        self.said.clear()
        self.file.write_text(text)
        self.run.request_reload()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], AbstractContextManager[Bench]]:

    @contextmanager
    def running(text: str) -> Iterator[Bench]:
        found = Bench(tmp_path, text, monkeypatch)
        thread = threading.Thread(target=found.run.until, args=(float("inf"),))
        thread.start()
        try:
            yield found
        finally:
            found.run.request_stop()
            thread.join(20.0)
            found.listener.close()
            found.socket.close()
            assert not thread.is_alive()

    return running


def test_faults_are_said_and_the_rig_runs_on(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        first = rig.daemon
        until(lambda: has_moved(first, "pt1"), 20.0)
        rig.reload(
            RIG.replace("tilt_deg: [-90, 0]", "tilt_deg: [0, -90]").replace("rig: fakes", "rig: fakes\nextra: 1")
        )
        until(lambda: rig.notified("READY=1"))
        assert rig.notified("RELOADING=1\nMONOTONIC_USEC=")
        assert rig.notified("reload refused")
        assert not rig.notified("STOPPING=1")
        (status,) = {message for message in rig.said if "reload refused" in message}
        assert "tilt_deg" in status
        assert "extra" in status
        assert "\n" not in status
        assert rig.daemons == [first]
        assert not at_rest(first)
        assert rig.kept == RIG
    assert rig.kept == "", "it came to rest"


def test_another_rigs_file_is_refused(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        first = rig.daemon
        rig.reload(RIG.replace("rig: fakes", "rig: others"))
        until(lambda: rig.notified("reload refused"))
        assert rig.daemons == [first]


def test_a_good_file_is_run_with_the_heads_stopped_between(
    bench: Callable[[str], AbstractContextManager[Bench]],
) -> None:
    with bench(RIG) as rig:
        first = rig.daemon
        until(lambda: has_moved(first, "pt1") and has_moved(first, "pt2"), 20.0)
        rig.reload(RIG.replace("id: robot1", "id: robot2"))
        until(lambda: len(rig.daemons) == 2, 20.0)
        assert at_rest(first)
        assert set(rig.daemon.config.rig.targets) == {"robot2"}
        assert "robot2" in rig.kept
        assert ask(rig.file.with_name("operator"), {"command": "status"})["rig"] == "fakes"
        assert rig.notified("READY=1")
        assert not rig.notified("STOPPING=1")
        until(lambda: has_moved(rig.daemon, "pt1"), 20.0)


def test_what_an_operator_holds_stays_held(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        until(lambda: has_moved(rig.daemon, "pt1") and has_moved(rig.daemon, "pt2"), 20.0)
        rig.daemon.hold()
        rig.daemon.resume(["pt2"])
        rig.reload(RIG)
        until(lambda: len(rig.daemons) == 2, 20.0)
        until(lambda: has_moved(rig.daemon, "pt2"), 20.0)
        assert rig.daemon.view().enabled == {"pt2"}
        assert not has_moved(rig.daemon, "pt1")


def test_a_rig_that_does_not_start_gives_way_to_the_one_before(
    bench: Callable[[str], AbstractContextManager[Bench]], tmp_path: Path
) -> None:
    with bench(RIG) as rig:
        rig.daemon  # noqa: B018 - wait for it
        rig.reload(RIG + f"outputs: [{{driver: jsonl, path: {tmp_path}/none/such}}]\n")
        until(lambda: len(rig.daemons) == 2, 20.0)
        until(lambda: rig.notified("reload failed"))
        assert not rig.notified("STOPPING=1")
        assert rig.daemon.config.outputs == ()


def test_a_rig_whose_devices_turn_out_to_be_others_gives_way_to_the_one_before(
    bench: Callable[[str], AbstractContextManager[Bench]],
) -> None:
    south = "source: {driver: fake, fps: 10}, mount: {head: pt2}"
    with bench(RIG) as rig:
        first = rig.daemon
        rig.reload(RIG.replace(south, "source: {driver: v4l2, device: /dev/null}, mount: {head: pt2}"))
        until(lambda: len(rig.daemons) == 3, 30.0)
        until(lambda: rig.notified("reload failed"))
        assert not rig.notified("STOPPING=1")
        assert rig.daemon.config == first.config


def test_a_held_head_stays_held_under_another_name(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        rig.daemon.hold()
        rig.daemon.resume(["pt2"])
        rig.reload(RIG.replace("pt1", "pan1"))
        until(lambda: len(rig.daemons) == 2, 20.0)
        assert {name: job.held for name, job in rig.daemon.devices.heads.items()} == {"pan1": True, "pt2": False}


def test_no_reload_while_a_drone_is_in_the_air(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(WITH_DRONE) as rig:
        first = rig.daemon
        first.arm("d1")
        until(lambda: first.control.state.flight.get("d1") not in (None, FlightState.UNKNOWN, FlightState.GROUND), 20.0)
        rig.reload(WITH_DRONE)
        until(lambda: rig.notified("d1 in the air: land before a reload"))
        assert rig.daemons == [first]
        assert isinstance(first.devices.drones["d1"].drone, FakeDrone)
        first.devices.drones["d1"].drone.faults.unplug()
        until(lambda: first.control.state.flight["d1"] is FlightState.UNKNOWN)
        rig.reload(WITH_DRONE)
        until(lambda: rig.notified("READY=1"))
        assert rig.notified("d1 in the air: land before a reload")
        assert first.successor is None


def test_no_reload_while_another_program_has_a_head(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        first = rig.daemon
        first.lend("pt1", 30.0)
        rig.reload(RIG)
        until(lambda: rig.notified("north, pt1 lent to another program: reload when it has given them back"))
        assert first.lend("pt1", 30.0, renew=True) == {"pt1", "north"}, "whoever has it notices nothing"
        first.lend("pt1", 0.0)
        rig.reload(RIG)
        until(lambda: len(rig.daemons) == 2, 20.0)
        assert rig.daemon.held == {"pt1"}
        with pytest.raises(HardwareError, match="reloaded or stopped: ask again"):
            first.lend("pt1", 30.0)


def test_the_watchdog_is_fed_while_workers_end(bench: Callable[[str], AbstractContextManager[Bench]]) -> None:
    with bench(RIG) as rig:
        workers = len(rig.daemon.devices.heads) + len(rig.daemon.devices.cameras)
        rig.run.request_stop()
        until(lambda: rig.notified("STOPPING=1"))
        ending = rig.said.index("STOPPING=1")
        until(lambda: rig.notified("STOPPING=1") and rig.said[ending:].count("WATCHDOG=1") >= workers)
