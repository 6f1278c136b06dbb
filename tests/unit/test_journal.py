"""The log as the journal takes it: datagrams of fields, over a real socket."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from camrig.outputs.journal import JournalHandler, journal_behind


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "socket"))
        listener.settimeout(1.0)
        yield listener


@pytest.fixture
def log(journal: socket.socket) -> Iterator[logging.Logger]:
    logger, handler = logging.getLogger("journal-test"), JournalHandler(Path(journal.getsockname()))
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
    logger.addHandler(handler)
    yield logger
    logger.removeHandler(handler)
    handler.close()


def _fields(datagram: bytes) -> dict[str, str]:
    found = {}
    while datagram:
        line, _, rest = datagram.partition(b"\n")
        key, equals, value = line.partition(b"=")
        if not equals:
            length = int.from_bytes(rest[:8], "little")
            value, rest = rest[8 : 8 + length], rest[8 + length + 1 :]
        found[key.decode()] = value.decode()
        datagram = rest
    return found


def test_a_record_has_its_message_priority_and_own_fields(journal: socket.socket, log: logging.Logger) -> None:
    log.warning("%s: link lost", "pt1", extra={"device": "pt1", "state": "lost"})
    found = _fields(journal.recv(65536))
    assert found["MESSAGE"] == "pt1: link lost"
    assert found["PRIORITY"] == "4"
    assert (found["CAMRIG_DEVICE"], found["CAMRIG_STATE"]) == ("pt1", "lost")
    assert "CAMRIG_TARGET" not in found
    assert found["SYSLOG_IDENTIFIER"] == "camrig"


def test_what_has_lines_of_its_own_stays_one_field(journal: socket.socket, log: logging.Logger) -> None:
    log.error("first\nPRIORITY=0\nlast é", extra={"target": "robot1"})
    found = _fields(journal.recv(65536))
    assert found["MESSAGE"] == "first\nPRIORITY=0\nlast é"
    assert (found["PRIORITY"], found["CAMRIG_TARGET"]) == ("3", "robot1")


def test_a_journal_that_is_full_or_gone_holds_nobody_up(journal: socket.socket, log: logging.Logger) -> None:
    for _ in range(2000):
        log.info("much")
    journal.close()
    log.info("gone")


def test_the_journal_is_recognised_behind_a_descriptor(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    with (tmp_path / "stream").open("w") as stream:
        found = os.fstat(stream.fileno())
        assert not journal_behind(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        assert journal_behind(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino + 1}")
        assert not journal_behind(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", "nonsense")
        assert not journal_behind(stream.fileno())
