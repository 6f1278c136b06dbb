"""What systemd is told, over a real datagram socket; and a supervisor that is deaf, full or gone harms nobody."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from camrig.runtime.notify import Notifier


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(1.0)
        yield listener


def _everything(notifier: Notifier) -> None:
    notifier.starting("compiling", 90.0)
    notifier.ready()
    notifier.status("tracking: 2 of 3 targets")
    notifier.alive()
    notifier.stopping()


EVERYTHING = [
    b"STATUS=compiling\nEXTEND_TIMEOUT_USEC=90000000",
    b"READY=1",
    b"STATUS=tracking: 2 of 3 targets",
    b"WATCHDOG=1",
    b"STOPPING=1",
]


def test_every_message_is_a_datagram_of_its_own(supervisor: socket.socket) -> None:
    _everything(Notifier(supervisor.getsockname()))
    assert [supervisor.recv(1024) for _ in EVERYTHING] == EVERYTHING


def test_the_address_is_the_one_that_systemd_names(supervisor: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", supervisor.getsockname())
    Notifier().ready()
    assert supervisor.recv(1024) == b"READY=1"


def test_an_abstract_address_is_understood() -> None:
    name = f"camrig-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name}")
        listener.settimeout(1.0)
        Notifier(f"@{name}").alive()
        assert listener.recv(1024) == b"WATCHDOG=1"


def test_without_a_supervisor_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    _everything(Notifier())


def test_a_supervisor_that_is_gone_is_no_error(tmp_path: Path) -> None:
    _everything(Notifier(str(tmp_path / "absent")))


@pytest.mark.timeout(20)
def test_a_supervisor_that_does_not_read_blocks_nobody(supervisor: socket.socket) -> None:
    notifier = Notifier(supervisor.getsockname())
    for _ in range(2000):  # more than any queue of datagrams holds
        notifier.alive()
    assert supervisor.recv(1024) == b"WATCHDOG=1"
