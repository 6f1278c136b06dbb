"""Several fake V4L2 cameras on one computer, each under a node that may change at every replug."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
from dataclasses import dataclass, field

from camrig_drivers.v4l2.port import Ready
from tests.v4l2_kernel import FakeKernel, Habits


@dataclass
class Hub:
    """An ``IoctlPort`` that passes each call on to the camera it is meant for."""

    cameras: list[FakeKernel]
    names: dict[str, list[str]] = field(default_factory=dict)
    """What udev calls each node."""
    denied: set[str] = field(default_factory=set)
    """Nodes that this user may not open."""
    _by_fd: dict[int, FakeKernel] = field(default_factory=dict)

    def open(self, path: str) -> int:
        node = next((node for node, names in self.names.items() if path in names), path)
        if node in self.denied:
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        camera = next((camera for camera in self.cameras if camera.plugged and camera.path == node), None)
        if camera is None:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
        fd = camera.open(node)
        self._by_fd[fd] = camera
        return fd

    def ioctl(self, fd: int, request: int, argument: ctypes.Structure | ctypes.c_int32) -> None:
        self._by_fd[fd].ioctl(fd, request, argument)

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        return self._by_fd[fd].mmap(fd, length, offset)

    def poll(self, fd: int, wake_fd: int, timeout_s: float) -> Ready:
        return self._by_fd[fd].poll(fd, wake_fd, timeout_s)

    def close(self, fd: int) -> None:
        self._by_fd.pop(fd).close(fd)

    def nodes(self) -> list[str]:
        return sorted(camera.path for camera in self.cameras if camera.plugged)

    def links(self) -> dict[str, list[str]]:
        return self.names

    def usb_serial(self, path: str) -> str:
        return next((camera.serial for camera in self.cameras if camera.plugged and camera.path == path), "")


def camera_at(node: str, bus_info: str, *, serial: str = "", habits: Habits | None = None) -> FakeKernel:
    """Return a plugged-in camera that exposes its first picture by itself."""
    kernel = FakeKernel(habits)
    kernel.path, kernel.bus_info, kernel.serial = node, bus_info.encode(), serial
    return kernel
