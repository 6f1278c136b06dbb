"""The daemon in this process, on fakes: it works, and it comes to rest, motion first, whatever ends it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from camrig.config.settings import settings_of
from camrig.errors import InputError
from camrig.messages import LinkStatus
from camrig.runtime.daemon import Daemon
from camrig_emulators.fakes import FakeCamera, FakeDrone
from tests.daemon_on_fakes import RIG, at_rest, has_moved, head, load, log, supervising
from tests.runtime_parts import until

DRONE = """\
drones:
  - {id: d1, driver: fake, box_m: [[1, 1, 1.2], [4, 2, 2.2]]}
"""
SKY = "  - {id: sky, lens: lab, source: {driver: fake}, mount: {drone: d1}}\n"


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
    config = load(tmp_path, RIG.replace("heads:\n", SKY + "heads:\n", 1) + DRONE)
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


def test_a_head_and_its_camera_are_lent_while_the_others_work_on(daemon: Daemon) -> None:
    def links_are(status: LinkStatus, *names: str) -> bool:
        return all(daemon.control.link_states.get(name) is status for name in names)

    until(lambda: links_are(LinkStatus.UP, "pt1", "pt2", "north", "south"))
    assert daemon.lend("pt1", 30.0) == {"pt1", "north"}
    until(lambda: links_are(LinkStatus.CLOSED, "pt1", "north"))
    frames = daemon.devices.cameras["south"].frames
    until(lambda: daemon.devices.cameras["south"].frames > frames + 3)
    assert links_are(LinkStatus.UP, "pt2", "south")
    assert daemon.lend("pt1", 30.0, renew=True) == {"pt1", "north"}
    before = len(head(daemon, "pt1").commands)
    assert daemon.hold() == {}
    with pytest.raises(InputError, match="pt1 is not lent any more"):
        daemon.lend("pt1", 30.0, renew=True)
    until(lambda: links_are(LinkStatus.UP, "pt1", "north"))
    assert [aim for _, aim in head(daemon, "pt1").commands[before:]] == [None, None]  # held, and opened again
    assert daemon.devices.heads["pt1"].held
    assert not head(daemon, "pt1").enabled


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
