"""The log in systemd's journal, with fields: ``journalctl -u camrig CAMRIG_DEVICE=pt1``.

The journal's native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL) over its datagram socket: one ``KEY=value`` line a
field, or, where the value has lines of its own, the key, its length as 64 bits little-endian, and the value.
"""

from __future__ import annotations

import logging
import os
import socket
from contextlib import suppress
from pathlib import Path

SOCKET = Path("/run/systemd/journal/socket")
FIELDS = ("device", "target", "state")
"""What a record may carry (``extra=``); in the journal CAMRIG_DEVICE, CAMRIG_TARGET, CAMRIG_STATE."""
_LONGEST = 60_000
"""Characters of a message; a datagram takes a few times as many bytes."""
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))


def journal_behind(fd: int) -> bool:
    """Return whether what is written to ``fd`` goes to the journal, as systemd says in JOURNAL_STREAM."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    with suppress(OSError, ValueError):
        found = os.fstat(fd)
        return (int(device), int(inode)) == (found.st_dev, found.st_ino)
    return False


class JournalHandler(logging.Handler):
    """Sends every record as one datagram; a journal that is away or full holds nobody up."""

    def __init__(self, path: Path = SOCKET) -> None:
        super().__init__()
        self._path = str(path)
        self._channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._channel.setblocking(False)

    def emit(self, record: logging.LogRecord) -> None:
        fields = {
            "MESSAGE": self.format(record)[:_LONGEST],
            "PRIORITY": str(next((number for level, number in _PRIORITIES if record.levelno >= level), 7)),
            "SYSLOG_IDENTIFIER": "camrig",
            "LOGGER": record.name,
            "THREAD_NAME": record.threadName or "",
        }
        own = {f"CAMRIG_{name.upper()}": str(getattr(record, name)) for name in FIELDS if hasattr(record, name)}
        with suppress(OSError):
            self._channel.sendto(b"".join(_field(*item) for item in {**fields, **own}.items()), self._path)

    def close(self) -> None:
        self._channel.close()
        super().close()


def _field(key: str, value: str) -> bytes:
    data = value.encode(errors="replace")
    if b"\n" in data:
        return key.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n"
    return key.encode() + b"=" + data + b"\n"
