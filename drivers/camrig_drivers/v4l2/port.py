"""The seam between this driver and the kernel: five system calls, and what the file system tells of devices."""

from __future__ import annotations

import fcntl
import math
import mmap
import os
import select
from contextlib import suppress
from pathlib import Path
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

    def nodes(self) -> list[str]:
        """List the nodes of all video devices, in the order of their numbers."""
        ...

    def links(self) -> dict[str, list[str]]:
        """Return the names that udev gave each node, by id before by path."""
        ...

    def usb_serial(self, path: str) -> str:
        """Return the serial number of the USB device behind a node; empty where there is none."""
        ...


class KernelPort:
    """The real ones, on the devices under ``dev`` and what ``sys`` tells of them."""

    def __init__(self, dev: Path = Path("/dev"), sys: Path = Path("/sys")) -> None:
        self._dev = dev
        self._sys = sys

    def nodes(self) -> list[str]:
        return sorted(map(str, self._dev.glob("video[0-9]*")), key=lambda path: int(path.rpartition("video")[2]))

    def links(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for folder in ("by-id", "by-path"):
            for link in sorted((self._dev / "v4l" / folder).glob("*")):
                found.setdefault(str(link.resolve()), []).append(str(link))
        return found

    def usb_serial(self, path: str) -> str:
        interface = self._sys / "class/video4linux" / Path(os.path.realpath(path)).name / "device"
        with suppress(OSError):
            return (interface.resolve().parent / "serial").read_text().strip()
        return ""

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
