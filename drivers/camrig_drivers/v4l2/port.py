"""The seam between this driver and the kernel: five system calls."""

from __future__ import annotations

import fcntl
import math
import mmap
import os
import select
from typing import NamedTuple, Protocol

from camrig_drivers.v4l2.abi import Argument


class Ready(NamedTuple):
    """What ``poll`` found."""

    frame: bool
    fault: bool
    woken: bool


class IoctlPort(Protocol):
    """The system calls; every failure is an OSError with its errno."""

    def open(self, path: str) -> int:
        """Open a device node, non-blocking; return its descriptor."""
        ...

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """Make one ioctl call; what the kernel answers is in ``argument``."""
        ...

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        """Map one buffer of the device."""
        ...

    def poll(self, fd: int, wake_fd: int, timeout_s: float) -> Ready:
        """Block until there is a frame or a fault, ``wake_fd`` is readable or the time is up."""
        ...

    def close(self, fd: int) -> None:
        """Close a descriptor; the device is free once its buffers are unmapped too."""
        ...


class KernelPort:
    """The real ones."""

    def open(self, path: str) -> int:
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        while True:  # a control transfer over USB can be interrupted by a signal
            try:
                fcntl.ioctl(fd, request, argument, True)
            except InterruptedError:
                continue
            return

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def poll(self, fd: int, wake_fd: int, timeout_s: float) -> Ready:
        poller = select.poll()
        poller.register(fd, select.POLLIN)
        poller.register(wake_fd, select.POLLIN)
        events = dict(poller.poll(math.ceil(timeout_s * 1000.0)))
        device = events.get(fd, 0)
        fault = bool(device & (select.POLLERR | select.POLLHUP | select.POLLNVAL))
        return Ready(bool(device & select.POLLIN), fault, wake_fd in events)

    def close(self, fd: int) -> None:
        os.close(fd)
