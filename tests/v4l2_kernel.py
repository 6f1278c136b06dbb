"""A kernel with one V4L2 camera, for tests: the ioctl interface of 64-bit Linux, byte by byte.

It knows ``linux/videodev2.h`` by offsets of its own and none of the driver's structures, so that a mistake there
shows. Numbers and habits are those of the real kernel: what a camera forgets when unplugged, who holds its buffers,
which controls an automatic mode governs (as uvcvideo does since 5.16).
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import select
import struct
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

from camrig.clock import ManualClock, RealClock
from camrig.rig import CameraSpec
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.port import Ready
from tests.v4l2_control_bank import USUAL_CONTROLS, Argument, Control, ControlBank

Memory = mmap.mmap

PATH = "/dev/v4l/by-id/usb-camera-video-index0"

MONOTONIC = 0x2000
COPY = 0x4000
START_OF_EXPOSURE = 0x10000
ERROR = 0x40

QUERYCAP, ENUM_FMT, S_FMT = 0x80685600, 0xC0405602, 0xC0D05605
REQBUFS, QUERYBUF, QBUF, DQBUF = 0xC0145608, 0xC0585609, 0xC058560F, 0xC0585611
STREAMON, STREAMOFF, G_PARM, S_PARM = 0x40045612, 0x40045613, 0xC0CC5615, 0xC0CC5616
QUERYMENU, G_EXT_CTRLS, S_EXT_CTRLS = 0xC02C5625, 0xC0205647, 0xC0205648
ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS, QUERY_EXT_CTRL = 0xC02C564A, 0xC034564B, 0xC0E85667

_BUFFER = struct.Struct("<5I4x2q16s2IQ2Ii4x")
_PIX = struct.Struct("<12I")
_CAPTURE = 1
_MMAP = 1


@dataclass
class Habits:
    """What kind of camera it is."""

    formats: dict[str, tuple[tuple[int, int], ...]] = field(
        default_factory=lambda: {"YUYV": ((64, 48), (32, 24)), "MJPG": ((64, 48),)}
    )
    padding_bytes: int = 0
    capabilities: int = 0x85200001
    device_capabilities: int = 0x04200001
    picture_field: int = 1
    rates_fps: tuple[int, ...] = (30, 15)
    knows_rates: bool = True
    controls: tuple[Control, ...] = USUAL_CONTROLS
    clips: tuple[int, ...] = ()
    """Controls that silently take another value than they were set to."""
    buffers: int | None = None
    """How many it makes, whatever is asked."""
    lost_bytes: int = 0
    """How much too short its buffers are."""


@dataclass
class _Buffer:
    memory: mmap.mmap
    stamp_s: float = 0.0
    flags: int = 0
    used: int = 0
    sequence: int = 0


class FakeKernel:
    """An ``IoctlPort``. ``expose`` is the camera's end: it fills the next empty buffer."""

    def __init__(self, habits: Habits | None = None) -> None:
        self.habits = habits or Habits()
        self.calls: list[int] = []
        self.controls = ControlBank(self.habits.controls, self.habits.clips)
        self.faults: dict[int, int] = {}
        """Error numbers by ioctl; each call fails until the fault is removed."""
        self.holder: bool = False
        """Another program streams."""
        self.plugged = True
        self._buffers: list[_Buffer] = []
        self._lock = threading.RLock()
        self._fds: set[int] = set()
        self._mapped: list[mmap.mmap] = []
        self.path = PATH
        """Where the camera is; another after a replug under another number."""
        self.serial = ""
        self.card, self.bus_info = b"Test Camera", b"usb-1.2"
        self.clock: ManualClock | None = None
        """Where given, waiting in vain only moves its time on."""
        self.first: bytes | None = None
        """What it exposes by itself as soon as it streams."""
        self._streamer = -1
        self._plug_in()

    # --- the camera's end -------------------------------------------------------------------------------

    def expose(self, content: bytes, stamp_s: float, flags: int = MONOTONIC, *, lost: int = 0) -> bool:
        """Fill a buffer and count the frame; False where the driver has queued none. ``lost`` frames went before."""
        with self._lock:
            self._sequence += 1 + lost
            if not (self.streaming and self._empty):
                return False
            index = self._empty.popleft()
            self._buffers[index].memory[: len(content)] = content
            self._buffers[index] = replace(
                self._buffers[index], stamp_s=stamp_s, flags=flags, used=len(content), sequence=self._sequence % 2**32
            )
            self._full.append(index)
            self._signal()
            return True

    def count_from(self, sequence: int) -> None:
        self._sequence = sequence - 1

    def unplug(self) -> None:
        with self._lock:
            self.plugged = False
            self._signal()

    def replug(self) -> None:
        self._plug_in()

    def fail(self, error: int) -> None:
        """End streaming as a fatal error does: poll reports a fault, DQBUF the error."""
        with self._lock:
            self.faults[DQBUF] = error
            self._signal()

    @property
    def free(self) -> bool:
        """Nobody holds a descriptor or a mapped buffer."""
        return not self._fds and all(memory.closed for memory in self._mapped)

    @property
    def queued(self) -> int:
        return len(self._empty)

    # --- the driver's end: IoctlPort --------------------------------------------------------------------

    def open(self, path: str) -> int:
        if path not in (self.path, *self.links().get(self.path, ())) or not self.plugged:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
        fd = os.eventfd(0, os.EFD_NONBLOCK)
        self._fds.add(fd)
        return fd

    def ioctl(self, fd: int, request: int, argument: ctypes.Structure | ctypes.c_int32) -> None:
        data = (ctypes.c_char * ctypes.sizeof(argument)).from_buffer(argument)
        with self._lock:
            self.calls.append(request)
            self._streamer = fd if request in (REQBUFS, STREAMON) else self._streamer
            assert fd in self._fds
            assert len(data) == request >> 16 & 0x3FFF
            if not self.plugged:
                raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
            if request in self.faults:
                raise OSError(self.faults[request], os.strerror(self.faults[request]))
            answer = self._answers.get(request)
            error = answer(data) if answer else errno.ENOTTY
        if error:
            raise OSError(error, os.strerror(error))

    def mmap(self, fd: int, length: int, offset: int) -> Memory:
        assert fd in self._fds
        memory = self._buffers[offset // mmap.PAGESIZE].memory
        assert length == len(memory)
        self._mapped.append(memory)
        return memory

    def poll(self, fd: int, wake_fd: int, timeout_s: float) -> Ready:
        poller = select.poll()
        for each in (fd, wake_fd):
            poller.register(each, select.POLLIN)
        found = dict(poller.poll(0.0 if self.clock else timeout_s * 1000.0))
        if self.clock is not None and not found:
            self.clock.advance(timeout_s)
        with self._lock:
            fault = not self.plugged or DQBUF in self.faults
            return Ready(bool(self._full) and not fault, fault, wake_fd in found)

    def nodes(self) -> list[str]:
        return [self.path] if self.plugged else []

    def links(self) -> dict[str, list[str]]:
        return {}

    def usb_serial(self, path: str) -> str:
        assert path == self.path
        return self.serial

    def close(self, fd: int) -> None:
        self._fds.remove(fd)
        os.close(fd)
        if fd == self._streamer:  # whoever has opened it for its controls alone ends nothing
            self._stop()
        if self.free:
            self._buffers = []

    # --- inside -----------------------------------------------------------------------------------------

    def _plug_in(self) -> None:
        self.plugged = True
        self.controls.reset()
        self._pixels, self._size, self.fps = next(iter(self.habits.formats)), (32, 24), self.habits.rates_fps[0]
        self._sequence = -1
        self._buffers = []
        self._stop()

    def _stop(self) -> None:
        self.streaming = False
        self._empty: deque[int] = deque()
        self._full: deque[int] = deque()

    def _signal(self) -> None:
        for fd in self._fds:
            os.eventfd_write(fd, 1)

    @property
    def _answers(self) -> dict[int, Callable[[Argument], int]]:
        return {
            QUERYCAP: self._querycap,
            ENUM_FMT: self._enum_fmt,
            ENUM_FRAMESIZES: self._enum_sizes,
            ENUM_FRAMEINTERVALS: self._enum_rates,
            S_FMT: self._s_fmt,
            G_PARM: self._g_parm,
            S_PARM: self._s_parm,
            REQBUFS: self._reqbufs,
            QUERYBUF: self._querybuf,
            QBUF: self._qbuf,
            DQBUF: self._dqbuf,
            STREAMON: self._streamon,
            STREAMOFF: self._streamoff,
            QUERY_EXT_CTRL: self.controls.query,
            QUERYMENU: self.controls.query_menu,
            G_EXT_CTRLS: self.controls.get,
            S_EXT_CTRLS: self.controls.set,
        }

    def _querycap(self, data: Argument) -> int:
        able, device_able = self.habits.capabilities, self.habits.device_capabilities
        struct.pack_into("<16s32s32s3I", data, 0, b"uvcvideo", self.card, self.bus_info, 0x60100, able, device_able)
        return 0

    def _enum_fmt(self, data: Argument) -> int:
        index, kind = struct.unpack_from("<2I", data)
        if kind != _CAPTURE or index >= len(self.habits.formats):
            return errno.EINVAL
        struct.pack_into("<4s", data, 44, list(self.habits.formats)[index].encode())
        return 0

    def _enum_sizes(self, data: Argument) -> int:
        index, pixels = struct.unpack_from("<I4s", data)
        sizes = self.habits.formats.get(pixels.decode(), ())
        if index >= len(sizes):
            return errno.EINVAL
        struct.pack_into("<3I", data, 8, 1, *sizes[index])
        return 0

    def _enum_rates(self, data: Argument) -> int:
        index, pixels, width, height = struct.unpack_from("<I4s2I", data)
        assert (width, height) in self.habits.formats[pixels.decode()]
        if not self.habits.knows_rates or index >= len(self.habits.rates_fps):
            return errno.EINVAL
        struct.pack_into("<3I", data, 16, 1, 1, self.habits.rates_fps[index])
        return 0

    def _s_fmt(self, data: Argument) -> int:
        """Give what was asked, or the nearest: the first format, the first size."""
        if self.holder or self._buffers:
            return errno.EBUSY
        width, height, pixels, *_ = _PIX.unpack_from(data, 8)
        assert struct.unpack_from("<I", data) == (_CAPTURE,)
        name = pixels.to_bytes(4, "little").decode()
        self._pixels = name if name in self.habits.formats else next(iter(self.habits.formats))
        sizes = self.habits.formats[self._pixels]
        self._size = (width, height) if (width, height) in sizes else sizes[0]
        number = int.from_bytes(self._pixels.encode(), "little")
        _PIX.pack_into(
            data, 8, *self._size, number, self.habits.picture_field, self.line_bytes, self._image_bytes, *[0] * 6
        )
        return 0

    @property
    def line_bytes(self) -> int:
        each = {"YUYV": 2, "GREY": 1, "NV12": 1, "MJPG": 0}[self._pixels]
        return each and self._size[0] * each + self.habits.padding_bytes

    @property
    def _image_bytes(self) -> int:
        lines = self._size[1] * 3 // 2 if self._pixels == "NV12" else self._size[1]
        return (self.line_bytes * lines or 16384) - self.habits.lost_bytes

    def _g_parm(self, data: Argument) -> int:
        if not self.habits.knows_rates:
            return errno.ENOTTY
        struct.pack_into("<4I", data, 4, 0x1000, 0, 1, self.fps)
        return 0

    def _s_parm(self, data: Argument) -> int:
        numerator, denominator = struct.unpack_from("<2I", data, 12)
        self.fps = min(self.habits.rates_fps, key=lambda fps: abs(fps - denominator / numerator))
        return self._g_parm(data)

    def _reqbufs(self, data: Argument) -> int:
        number, kind, memory = struct.unpack_from("<3I", data)
        assert (kind, memory) == (_CAPTURE, _MMAP)
        number = self.habits.buffers or number
        self._buffers = [_Buffer(mmap.mmap(-1, self._image_bytes)) for _ in range(number)]
        struct.pack_into("<I", data, 0, number)
        return 0

    def _querybuf(self, data: Argument) -> int:
        (index,) = struct.unpack_from("<I", data)
        struct.pack_into("<I", data, 64, index * mmap.PAGESIZE)
        struct.pack_into("<I", data, 72, len(self._buffers[index].memory))
        return 0

    def _qbuf(self, data: Argument) -> int:
        (index,) = struct.unpack_from("<I", data)
        assert index < len(self._buffers)
        assert index not in (*self._empty, *self._full), "a buffer was queued twice"
        self._empty.append(index)
        return 0

    def _dqbuf(self, data: Argument) -> int:
        if not self._full:
            return errno.EAGAIN
        index = self._full.popleft()
        found = self._buffers[index]
        seconds, micros = divmod(round(found.stamp_s * 1e6), 1_000_000)
        length = len(found.memory)
        _BUFFER.pack_into(
            data, 0, index, _CAPTURE, found.used, found.flags | 0x1, 1, seconds, micros, bytes(16), found.sequence,
            _MMAP, 0, length, 0, 0,
        )  # fmt: skip
        if not self._full:
            for fd in self._fds:
                os.eventfd_read(fd)
        return 0

    def _streamon(self, data: Argument) -> int:
        assert struct.unpack("<i", data) == (_CAPTURE,)
        self.streaming = True
        if self.first is not None:
            self.expose(self.first, RealClock().now_s())
        return 0

    def _streamoff(self, _: Argument) -> int:
        self._stop()
        return 0


def yuyv(luma: bytes, width: int, padding_bytes: int = 0) -> bytes:
    """Interleave luma with chroma that no test may mistake for it, each line padded."""
    lines = [luma[start : start + width] for start in range(0, len(luma), width)]
    return b"".join(bytes(byte for pixel in line for byte in (pixel, 0xEE)) + b"\xdd" * padding_bytes for line in lines)


def start_self_exposing(spec: CameraSpec, fps: float, stack: ExitStack) -> V4l2Camera:
    """Plug in a camera that exposes at a rate of its own; the stack unplugs it."""
    kernel = FakeKernel(Habits(formats={"GREY": (spec.lens.size_px,)}))
    clock = RealClock()
    stopping = threading.Event()

    def expose_on() -> None:
        width, height = spec.lens.size_px
        while not stopping.wait(1.0 / fps):
            kernel.expose(bytes(width * height), clock.now_s() - 0.02, MONOTONIC | START_OF_EXPOSURE)

    exposing = threading.Thread(target=expose_on, name="self-exposing camera")
    exposing.start()
    stack.callback(exposing.join)
    stack.callback(stopping.set)
    return V4l2Camera(spec, V4l2Section(device=PATH, format="GREY"), clock, kernel)
