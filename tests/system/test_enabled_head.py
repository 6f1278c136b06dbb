"""A head that a command moves is stopped whatever becomes of the command."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys

from camrig.cli.signals import asked_to_stop
from camrig.runtime.enabled_head import enabled
from camrig_emulators.fakes import FakeHead

_DIES = """
import os, signal, sys
from types import SimpleNamespace
from camrig.runtime.enabled_head import enabled
def nothing(): pass
guard = SimpleNamespace(fd=int(sys.argv[1]), stop_bytes=b"STOP")
head = SimpleNamespace(open=nothing, enable=nothing, stop=nothing, close=nothing, guard=lambda: guard)
with enabled("pt1", head):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_it_is_stopped_though_the_command_is_killed() -> None:
    reader, writer = os.pipe()
    try:
        died = subprocess.run([sys.executable, "-c", _DIES, str(writer)], pass_fds=[writer], timeout=30.0, check=False)
        assert died.returncode == -signal.SIGKILL
        assert select.select([reader], [], [], 5.0)[0]
        assert os.read(reader, 4) == b"STOP"
    finally:
        os.close(reader)
        os.close(writer)


def test_it_is_stopped_once_where_all_goes_well(fake_head: FakeHead) -> None:
    with enabled("pt1", fake_head):
        assert fake_head.enabled
    assert [aim for _, aim in fake_head.commands] == [None]


def test_a_terminal_that_goes_asks_for_the_end_unless_that_is_ignored() -> None:
    with asked_to_stop() as asked:
        os.kill(os.getpid(), signal.SIGHUP)
        assert asked.wait(5.0)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with asked_to_stop() as asked:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not asked.is_set()
    finally:
        signal.signal(signal.SIGHUP, before)
