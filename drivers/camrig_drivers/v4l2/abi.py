"""The part of Linux's V4L2 interface that camrig uses, as ``linux/videodev2.h`` lays it out.

ctypes gives every structure the size it has on this machine, and the ioctl numbers follow from the sizes. On 32 bit the
buffer's stamp is the old pair of ``long``, which the kernel goes on to accept.
Sections cited: Linux Media Infrastructure userspace API, part I (Video for Linux).
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_int64, c_long, c_uint8, c_uint32, c_uint64, c_ulong

BUF_TYPE_VIDEO_CAPTURE = 1
MEMORY_MMAP = 1
FIELD_ANY = 0
FIELD_NONE = 1

CAP_VIDEO_CAPTURE = 0x00000001
CAP_STREAMING = 0x04000000
CAP_DEVICE_CAPS = 0x80000000
CAP_TIMEPERFRAME = 0x1000

BUF_FLAG_ERROR = 0x00000040
BUF_FLAG_TIMESTAMP_MASK = 0x0000E000
BUF_FLAG_TIMESTAMP_MONOTONIC = 0x00002000
BUF_FLAG_TSTAMP_SRC_MASK = 0x00070000
BUF_FLAG_TSTAMP_SRC_EOF = 0x00000000
BUF_FLAG_TSTAMP_SRC_SOE = 0x00010000

TYPE_DISCRETE = 1

CTRL_TYPE_INTEGER = 1
CTRL_TYPE_BOOLEAN = 2
CTRL_TYPE_MENU = 3
CTRL_TYPE_INTEGER64 = 5
CTRL_TYPE_INTEGER_MENU = 9

CTRL_FLAG_DISABLED = 0x0001
CTRL_FLAG_READ_ONLY = 0x0004
CTRL_FLAG_INACTIVE = 0x0010
CTRL_FLAG_WRITE_ONLY = 0x0040
CTRL_FLAG_NEXT_CTRL = 0x80000000


class Capability(ctypes.Structure):
    """struct v4l2_capability."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FmtDesc(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FrmSizeEnum(ctypes.Structure):
    """struct v4l2_frmsizeenum; ``size`` is (width, height), or the lowest, highest and step of each."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("size", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class FrmIvalEnum(ctypes.Structure):
    """struct v4l2_frmivalenum; ``interval`` is (numerator, denominator), or the lowest, highest and step."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("interval", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format."""

    _fields_ = (
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("colorspace", c_uint32),
        ("priv", c_uint32),
        ("flags", c_uint32),
        ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32),
        ("xfer_func", c_uint32),
    )


class _FormatUnion(ctypes.Union):
    """Pointers among the members that we do not use align it to the machine's word."""

    _fields_ = (("pix", PixFormat), ("raw_data", c_uint8 * 200), ("aligned", c_ulong))


class Format(ctypes.Structure):
    """struct v4l2_format."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class Fraction(ctypes.Structure):
    """struct v4l2_fract."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class CaptureParm(ctypes.Structure):
    """struct v4l2_captureparm."""

    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    )


class _ParmUnion(ctypes.Union):
    _fields_ = (("capture", CaptureParm), ("raw_data", c_uint8 * 200))


class StreamParm(ctypes.Structure):
    """struct v4l2_streamparm."""

    _fields_ = (("type", c_uint32), ("parm", _ParmUnion))


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class TimeVal(ctypes.Structure):
    """struct timeval."""

    _fields_ = (("tv_sec", c_long), ("tv_usec", c_long))


class _BufferMemory(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong))


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp", TimeVal),
        ("timecode", c_uint32 * 4),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _BufferMemory),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int64),
        ("maximum", c_int64),
        ("step", c_uint64),
        ("default_value", c_int64),
        ("flags", c_uint32),
        ("elem_size", c_uint32),
        ("elems", c_uint32),
        ("nr_of_dims", c_uint32),
        ("dims", c_uint32 * 4),
        ("reserved", c_uint32 * 32),
    )


class _MenuUnion(ctypes.Union):
    _pack_ = 1
    _fields_ = (("name", c_char * 32), ("value", c_int64))


class QueryMenu(ctypes.Structure):
    """struct v4l2_querymenu (packed)."""

    _pack_ = 1
    _fields_ = (("id", c_uint32), ("index", c_uint32), ("item", _MenuUnion), ("reserved", c_uint32))


class _ControlUnion(ctypes.Union):
    _pack_ = 1
    _fields_ = (("value", c_int32), ("value64", c_int64))


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control (packed)."""

    _pack_ = 1
    _fields_ = (("id", c_uint32), ("size", c_uint32), ("reserved2", c_uint32), ("u", _ControlUnion))


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls; ``which`` 0 is the current value."""

    _fields_ = (
        ("which", c_uint32),
        ("count", c_uint32),
        ("error_idx", c_uint32),
        ("request_fd", c_int32),
        ("reserved", c_uint32),
        ("controls", ctypes.POINTER(ExtControl)),
    )


Argument = ctypes.Structure | c_int32  # what an ioctl takes and fills in

_WRITE, _READ = 1, 2
_BIG_ENDIAN = 1 << 31


def _ioc(direction: int, number: int, argument: type[Argument]) -> int:
    """Return an ioctl's number (asm-generic/ioctl.h): direction, size of the argument, 'V', number."""
    return (direction << 30) | (ctypes.sizeof(argument) << 16) | (ord("V") << 8) | number


VIDIOC_QUERYCAP = _ioc(_READ, 0, Capability)
VIDIOC_ENUM_FMT = _ioc(_READ | _WRITE, 2, FmtDesc)
VIDIOC_S_FMT = _ioc(_READ | _WRITE, 5, Format)
VIDIOC_REQBUFS = _ioc(_READ | _WRITE, 8, RequestBuffers)
VIDIOC_QUERYBUF = _ioc(_READ | _WRITE, 9, Buffer)
VIDIOC_QBUF = _ioc(_READ | _WRITE, 15, Buffer)
VIDIOC_DQBUF = _ioc(_READ | _WRITE, 17, Buffer)
VIDIOC_STREAMON = _ioc(_WRITE, 18, c_int32)
VIDIOC_STREAMOFF = _ioc(_WRITE, 19, c_int32)
VIDIOC_G_PARM = _ioc(_READ | _WRITE, 21, StreamParm)
VIDIOC_S_PARM = _ioc(_READ | _WRITE, 22, StreamParm)
VIDIOC_QUERYMENU = _ioc(_READ | _WRITE, 37, QueryMenu)
VIDIOC_G_EXT_CTRLS = _ioc(_READ | _WRITE, 71, ExtControls)
VIDIOC_S_EXT_CTRLS = _ioc(_READ | _WRITE, 72, ExtControls)
VIDIOC_ENUM_FRAMESIZES = _ioc(_READ | _WRITE, 74, FrmSizeEnum)
VIDIOC_ENUM_FRAMEINTERVALS = _ioc(_READ | _WRITE, 75, FrmIvalEnum)
VIDIOC_QUERY_EXT_CTRL = _ioc(_READ | _WRITE, 103, QueryExtCtrl)
NAMES = {number: name for name, number in globals().items() if name.startswith("VIDIOC_")}


def fourcc(name: str) -> int:
    """Return the number of a pixel format's name: up to four characters, with ``-BE`` behind where big-endian."""
    characters, dash, _ = name.partition("-BE")
    return int.from_bytes(characters.ljust(4).encode("ascii"), "little") | (_BIG_ENDIAN if dash else 0)


def fourcc_name(number: int) -> str:
    """Return the name of a pixel format; bit 31 marks big-endian formats."""
    characters = (number & ~_BIG_ENDIAN).to_bytes(4, "little").decode("ascii", "replace").strip()
    return f"{characters}-BE" if number & _BIG_ENDIAN else characters
