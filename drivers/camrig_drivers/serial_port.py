"""One open serial port, whose every trouble is a LinkLost."""

from __future__ import annotations

import errno
import fcntl
import os
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

import serial

from camrig.errors import LinkLost

_WRITE_TIMEOUT_S = 0.5
_ADVICE = {
    errno.ENOENT: "it does not exist; check the cable and the name, best one of /dev/serial/by-id",
    errno.EACCES: "permission denied; add this user to the port's group (dialout on Debian) and log in again",
    errno.EPERM: "permission denied; add this user to the port's group (dialout on Debian) and log in again",
    errno.EAGAIN: "another program holds it; stop that program",
    errno.EBUSY: "another program holds it; stop that program",
    errno.ENOTTY: "it is no serial port; check the name",
}


class SerialPort(Protocol):
    """What a line is spoken through: ``Port``, or a simulated one; every method as there."""

    @property
    def path(self) -> str: ...

    @property
    def fd(self) -> int: ...

    @property
    def is_open(self) -> bool: ...

    def write(self, frame: bytes) -> None: ...

    def read(self, size: int, timeout_s: float) -> bytes: ...

    def discard_input(self) -> None: ...

    def wake(self) -> None: ...

    def close(self) -> None: ...


class Port:
    """A serial port at 8N1, ours alone, without input or output of its own until asked.

    Opening raises LinkLost with what to do about it. A failed read or write raises LinkLost and is final.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        try:
            self._serial = serial.Serial(path, baud, timeout=0.0, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
        except (OSError, termios.error, ValueError) as error:  # a SerialException is an OSError, termios.error is not
            raise LinkLost(f"cannot open serial port {path}: {_advice(error)}") from error
        # An adapter may hold bytes back for 16 ms, and with them their stamps; a pty cannot be asked.
        with suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    @property
    def fd(self) -> int:
        """The descriptor, for a guardian; raises LinkLost once closed."""
        if self._serial.fd is None:
            raise LinkLost(f"serial port {self.path} is closed")
        return int(self._serial.fd)

    @property
    def is_open(self) -> bool:
        return bool(self._serial.is_open)

    def write(self, frame: bytes) -> None:
        """Hand a whole frame to the line; raises LinkLost where it does not take it within 0.5 s."""
        with self._link("writing"):
            self._serial.write(frame)

    def write_some(self, data: bytes) -> int:
        """Hand to the line what it takes now; return how many bytes that was. Raises LinkLost."""
        with self._link("writing"), suppress(BlockingIOError):
            return os.write(self.fd, data)
        return 0

    def read(self, size: int, timeout_s: float) -> bytes:
        """Block until ``size`` bytes came, ``timeout_s`` has passed or ``wake``; return what came."""
        with self._link("reading"):
            self._serial.timeout = timeout_s
            return bytes(self._serial.read(size))

    def discard_input(self) -> None:
        """Forget everything received and not yet read."""
        with self._link("reading"):
            self._serial.reset_input_buffer()

    def wake(self) -> None:
        """Make a blocked ``read`` (or else the next one) return at once; any thread."""
        self._serial.cancel_read()

    def close(self) -> None:
        """Release the port; twice is allowed."""
        if not self._serial.is_open:
            return
        # Closing alone keeps the lock while a guardian process holds a copy of the descriptor.
        with suppress(OSError):
            fcntl.flock(self.fd, fcntl.LOCK_UN)
        self._serial.close()

    @contextmanager
    def _link(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (OSError, termios.error) as error:
            raise LinkLost(f"serial port {self.path} was lost while {doing}: {error}") from error


def _advice(error: Exception) -> str:
    """Say what to do; pyserial hides the errno of a failed termios call in the error's context."""
    for cause in (error, error.__context__):
        if cause is not None and cause.args and cause.args[0] in _ADVICE:
            return _ADVICE[cause.args[0]]
    return str(error)
