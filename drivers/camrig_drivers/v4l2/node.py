"""One open device node: the ioctls as typed calls. Whatever fails is an OSError."""

from __future__ import annotations

import errno
import mmap
from ctypes import c_int32, pointer
from dataclasses import dataclass
from fractions import Fraction

from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.port import IoctlPort, Ready

_MAX_RATE_DENOMINATOR = 1001  # 30000/1001 is the longest rate in use


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a device says it is, and whether it can stream pictures."""

    card: str
    bus_info: str
    is_camera: bool
    serial: str = ""
    """Of the USB device; many have none."""

    def __str__(self) -> str:
        return f"{self.card} at {self.bus_info}"


@dataclass(frozen=True, slots=True)
class PictureFormat:
    """The format of the pictures; ``line_bytes`` is 0 for compressed ones."""

    pixels: str
    size_px: tuple[int, int]
    line_bytes: int
    progressive: bool

    def __str__(self) -> str:
        return f"{self.size_px[0]}x{self.size_px[1]} {self.pixels}"


@dataclass(frozen=True, slots=True)
class ControlInfo:
    """A control as the device describes it; ``name`` is the kernel's own."""

    id: int
    kind: int
    name: str
    minimum: int
    maximum: int
    step: int
    flags: int


@dataclass(frozen=True, slots=True)
class Filled:
    """A buffer that the device has filled."""

    index: int
    used_bytes: int
    flags: int
    stamp_s: float
    sequence: int


class Node:
    """An open device node."""

    def __init__(self, port: IoctlPort, path: str) -> None:
        self.path = path
        self._port = port
        self._fd = port.open(path)

    def close(self) -> None:
        """Close the descriptor; once only."""
        self._port.close(self._fd)

    # --- what it is ---------------------------------------------------------------------------------------

    def identity(self) -> Identity:
        found = abi.Capability()
        self.ask(abi.VIDIOC_QUERYCAP, found)
        able = found.device_caps if found.capabilities & abi.CAP_DEVICE_CAPS else found.capabilities
        needed = abi.CAP_VIDEO_CAPTURE | abi.CAP_STREAMING
        serial = self._port.usb_serial(self.path)
        return Identity(_text(found.card), _text(found.bus_info), able & needed == needed, serial)

    # --- format and rate --------------------------------------------------------------------------------

    def set_format(self, pixels: str, size_px: tuple[int, int]) -> PictureFormat:
        """Ask for a format; return what the device gives, which may be another."""
        asked = abi.Format(type=abi.BUF_TYPE_VIDEO_CAPTURE)
        asked.fmt.pix = abi.PixFormat(
            width=size_px[0], height=size_px[1], pixelformat=abi.fourcc(pixels), field=abi.FIELD_NONE
        )
        self.ask(abi.VIDIOC_S_FMT, asked)
        given = asked.fmt.pix
        return PictureFormat(
            abi.fourcc_name(given.pixelformat),
            (given.width, given.height),
            given.bytesperline,
            given.field in (abi.FIELD_ANY, abi.FIELD_NONE),
        )

    def set_rate(self, fps: float | None) -> float | None:
        """Ask for a frame rate, or leave it; return what the device says it will be, None where it does not."""
        parm = abi.StreamParm(type=abi.BUF_TYPE_VIDEO_CAPTURE)
        try:
            self.ask(abi.VIDIOC_G_PARM, parm)
            if fps is not None and parm.parm.capture.capability & abi.CAP_TIMEPERFRAME:
                rate = Fraction(fps).limit_denominator(_MAX_RATE_DENOMINATOR)
                parm.parm.capture.timeperframe = abi.Fraction(rate.denominator, rate.numerator)
                self.ask(abi.VIDIOC_S_PARM, parm)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):  # the device knows no rates
                return None
            raise
        interval = parm.parm.capture.timeperframe
        if not interval.numerator or not interval.denominator:
            return None
        return float(interval.denominator / interval.numerator)

    # --- streaming --------------------------------------------------------------------------------------

    def request_buffers(self, number: int) -> int:
        """Ask for buffers; return how many the device made, which may be more or fewer."""
        request = abi.RequestBuffers(count=number, type=abi.BUF_TYPE_VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)
        self.ask(abi.VIDIOC_REQBUFS, request)
        return int(request.count)

    def map_buffer(self, index: int) -> mmap.mmap:
        """Map one of the requested buffers; it holds a descriptor of the device until it is closed."""
        buffer = _buffer(index)
        self.ask(abi.VIDIOC_QUERYBUF, buffer)
        return self._port.mmap(self._fd, buffer.length, buffer.m.offset)

    def queue(self, index: int) -> None:
        """Hand an empty buffer to the device."""
        self.ask(abi.VIDIOC_QBUF, _buffer(index))

    def dequeue(self) -> Filled | None:
        """Take the oldest filled buffer; None where there is none. Never blocks."""
        buffer = _buffer(0)
        try:
            self.ask(abi.VIDIOC_DQBUF, buffer)
        except BlockingIOError:
            return None
        stamp_s = buffer.timestamp.tv_sec + 1e-6 * buffer.timestamp.tv_usec
        return Filled(buffer.index, buffer.bytesused, buffer.flags, stamp_s, buffer.sequence)

    def stream_on(self) -> None:
        self.ask(abi.VIDIOC_STREAMON, c_int32(abi.BUF_TYPE_VIDEO_CAPTURE))

    def stream_off(self) -> None:
        self.ask(abi.VIDIOC_STREAMOFF, c_int32(abi.BUF_TYPE_VIDEO_CAPTURE))

    def poll(self, wake_fd: int, timeout_s: float) -> Ready:
        return self._port.poll(self._fd, wake_fd, timeout_s)

    # --- controls ---------------------------------------------------------------------------------------

    def control(self, control_id: int) -> ControlInfo:
        """Describe a control; with CTRL_FLAG_NEXT_CTRL the one after it."""
        found = abi.QueryExtCtrl(id=control_id)
        self.ask(abi.VIDIOC_QUERY_EXT_CTRL, found)
        return ControlInfo(
            found.id, found.type, _text(found.name), found.minimum, found.maximum, found.step, found.flags
        )

    def menu_item(self, control: ControlInfo, index: int) -> str | None:
        """Name an item of a menu; None where the menu leaves that number out."""
        item = abi.QueryMenu(id=control.id, index=index)
        try:
            self.ask(abi.VIDIOC_QUERYMENU, item)
        except OSError as error:
            if error.errno == errno.EINVAL:
                return None
            raise
        return str(item.item.value) if control.kind == abi.CTRL_TYPE_INTEGER_MENU else _text(item.item.name)

    def value(self, control: ControlInfo) -> int:
        """Read a control."""
        one = abi.ExtControl(id=control.id)
        self.ask(abi.VIDIOC_G_EXT_CTRLS, abi.ExtControls(count=1, controls=pointer(one)))
        return int(one.u.value64 if control.kind == abi.CTRL_TYPE_INTEGER64 else one.u.value)

    def set_value(self, control: ControlInfo, value: int) -> None:
        """Set a control."""
        one = abi.ExtControl(id=control.id)
        if control.kind == abi.CTRL_TYPE_INTEGER64:
            one.u.value64 = value
        else:
            one.u.value = value
        self.ask(abi.VIDIOC_S_EXT_CTRLS, abi.ExtControls(count=1, controls=pointer(one)))

    def ask(self, request: int, argument: abi.Argument) -> None:
        """Make an ioctl call; an error's ``filename`` is the name of the call."""
        try:
            self._port.ioctl(self._fd, request, argument)
        except OSError as error:
            error.filename = abi.NAMES[request]
            raise


def _buffer(index: int) -> abi.Buffer:
    return abi.Buffer(index=index, type=abi.BUF_TYPE_VIDEO_CAPTURE, memory=abi.MEMORY_MMAP)


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace")
