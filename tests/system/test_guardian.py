"""The guardian stops what the daemon held when the daemon's end closes, and leaves alone what was released."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from camrig.interfaces import Guard
from camrig.runtime.guardian_link import GuardianLink
from tests.runtime_parts import until


@dataclass
class Port:
    """A pipe that stands for a serial port: what the guardian writes can be read."""

    reader: int
    writer: int

    def written(self, timeout_s: float) -> bytes:
        found = b""
        while select.select([self.reader], [], [], timeout_s)[0]:
            found += os.read(self.reader, 4096)
        return found


@pytest.fixture
def port() -> Iterator[Port]:
    reader, writer = os.pipe()
    yield Port(reader, writer)
    os.close(reader)
    os.close(writer)


def test_a_held_head_is_stopped_when_the_daemon_goes_away(port: Port) -> None:
    guardian = GuardianLink()
    guardian.hold("pt1", Guard(port.writer, b"STOP"))
    assert guardian.alive()
    guardian.close()
    assert port.written(0.0) == b"STOP" * 3


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGABRT, signal.SIGHUP], ids=lambda sent: sent.name)
def test_it_outlives_what_systemd_sends_to_the_whole_service(port: Port, sent: signal.Signals) -> None:
    guardian = GuardianLink()
    guardian.hold("pt1", Guard(port.writer, b"STOP"))
    until(lambda: ignores(guardian.pid, sent))  # it is up
    os.kill(guardian.pid, sent)
    assert guardian.alive()
    guardian.close()
    assert port.written(0.0) == b"STOP" * 3


def ignores(pid: int, sent: signal.Signals) -> bool:
    status = Path(f"/proc/{pid}/status").read_text()
    (mask,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigIgn:"))
    return bool(int(mask, 16) >> (sent - 1) & 1)


def test_a_released_head_is_left_alone(port: Port) -> None:
    guardian = GuardianLink()
    guardian.hold("pt1", Guard(port.writer, b"STOP"))
    guardian.release("pt1")
    guardian.close()
    assert port.written(0.0) == b""


def test_holding_again_after_a_reconnect_replaces_the_port(port: Port) -> None:
    reader, writer = os.pipe()
    guardian = GuardianLink()
    guardian.hold("pt1", Guard(writer, b"OLD"))
    guardian.hold("pt1", Guard(port.writer, b"NEW"))
    guardian.close()
    os.close(writer)
    assert os.read(reader, 16) == b""
    assert port.written(0.0) == b"NEW" * 3
    os.close(reader)


def test_a_blocked_port_does_not_keep_the_others_from_their_stop(port: Port) -> None:
    blocked_reader, blocked = os.pipe()
    os.set_blocking(blocked, False)
    with suppress(BlockingIOError):
        while True:
            os.write(blocked, b"x" * 65536)
    guardian = GuardianLink()
    guardian.hold("blocked", Guard(blocked, b"STOP"))
    guardian.hold("pt1", Guard(port.writer, b"STOP"))
    guardian.close()
    assert port.written(0.0) == b"STOP" * 3
    os.close(blocked)
    os.close(blocked_reader)
