"""Ends a blocked ``poll`` from another thread."""

from __future__ import annotations

import os
import threading
from contextlib import suppress


class Waker:
    """An event with a descriptor. The lock keeps a late ``wake`` from writing into a descriptor used anew."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.fd = -1

    def open(self) -> None:
        with self._lock:
            self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def wake(self) -> None:
        """Set the event; nothing while closed. Any thread."""
        with self._lock:
            if self.fd >= 0:
                os.eventfd_write(self.fd, 1)

    def clear(self) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(self.fd)

    def close(self) -> None:
        with self._lock:
            if self.fd >= 0:
                os.close(self.fd)
            self.fd = -1
