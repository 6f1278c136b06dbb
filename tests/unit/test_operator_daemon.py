"""What the daemon does with an operator's orders to its heads: fakes in memory, its real jobs, no threads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from camrig.clock import ManualClock
from camrig.config.rig_file import load_rig
from camrig.config.settings import settings_of
from camrig.messages import HeadAim
from camrig.runtime.control import Devices
from camrig.runtime.daemon import Daemon
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.head_job import HeadJob
from camrig_emulators.fakes import FakeHead

RIG = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [640, 360], fx: 450, fy: 450, cx: 320, cy: 180}
cameras:
  - {id: north, lens: lab, source: {driver: fake}, mount: {head: pt1}}
  - {id: south, lens: lab, source: {driver: fake}, mount: {head: pt2}}
heads:
  - {id: pt1, driver: fake, enable: auto, position_m: [1, 1, 2.8]}
  - {id: pt2, driver: fake, position_m: [4, 1, 2.8]}
"""
AIM = HeadAim(1.0, -0.5)


class Bench:
    """A daemon's heads, their turns taken by hand."""

    def __init__(self, file: Path, guardian: GuardianLink) -> None:
        file.write_text(RIG)
        config = load_rig(file)
        self.clock = ManualClock(10.0)
        self.fakes = {name: FakeHead(spec, clock=self.clock) for name, spec in config.rig.heads.items()}
        self.jobs = {
            name: HeadJob(name, fake, guardian, config.rig.heads[name].auto_enable) for name, fake in self.fakes.items()
        }
        self.daemon = Daemon(config, settings_of(config), clock=self.clock)
        self.daemon.devices = Devices({}, self.jobs, {})

    def command_all(self) -> set[str]:
        """Let the control thread command every head and the workers work; return the heads that obeyed."""
        before = {name: len(fake.commands) for name, fake in self.fakes.items()}
        for job in self.jobs.values():
            job.turn()
            job.commands.put(AIM)
            job.turn()
        return {name for name, fake in self.fakes.items() if AIM in [aim for _, aim in fake.commands[before[name] :]]}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    guardian = GuardianLink()
    bench = Bench(tmp_path / "rig.yaml", guardian)
    for job in bench.jobs.values():
        job.open()
    yield bench
    for job in bench.jobs.values():
        job.close()
    guardian.close()


def test_a_head_that_is_not_enabled_by_its_file_waits_for_resume(bench: Bench) -> None:
    assert bench.command_all() == {"pt1"}
    bench.daemon.resume(["pt2"])
    assert bench.command_all() == {"pt1", "pt2"}


def test_hold_stops_every_head_until_it_is_resumed_by_name(bench: Bench) -> None:
    bench.daemon.resume(["pt1", "pt2"])
    assert bench.command_all() == {"pt1", "pt2"}
    assert bench.daemon.hold() == {}
    assert all(fake.commands[-1][1] is None for fake in bench.fakes.values())
    assert bench.command_all() == set()
    bench.daemon.resume(["pt1"])
    assert bench.command_all() == {"pt1"}


def test_what_was_commanded_before_a_hold_is_not_obeyed_after_resume(bench: Bench) -> None:
    bench.command_all()
    bench.jobs["pt1"].commands.put(AIM)
    bench.daemon.hold()
    bench.jobs["pt1"].commands.put(AIM)  # the control thread had decided it before the hold
    bench.daemon.resume(["pt1"])
    bench.jobs["pt1"].turn()
    assert bench.fakes["pt1"].commands[-1][1] is None


def test_nothing_is_held_before_anything_is_built(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(RIG)
    config = load_rig(file)
    assert Daemon(config, settings_of(config)).hold() == {}


def test_an_aimed_head_goes_there_and_no_plan_moves_it_before_resume(bench: Bench) -> None:
    aside = HeadAim(0.2, -0.3)
    bench.daemon.aim("pt2", aside)  # held until now
    assert bench.command_all() == {"pt1"}
    assert [aim for _, aim in bench.fakes["pt2"].commands] == [aside]
    assert bench.jobs["pt2"].enabled
    bench.daemon.resume(["pt2"])
    assert bench.command_all() == {"pt1", "pt2"}


def test_hold_ends_an_aim(bench: Bench) -> None:
    bench.daemon.aim("pt1", HeadAim(0.2, -0.3))
    bench.daemon.hold()
    assert bench.command_all() == set()
    assert [aim for _, aim in bench.fakes["pt1"].commands] == [None]
