"""Numbers and sizes against those that a C compiler finds in linux/videodev2.h on 64-bit Linux."""

import ctypes
import sys

import pytest

from camrig_drivers.v4l2 import abi

only_64_bit = pytest.mark.skipif(sys.maxsize < 2**32, reason="the numbers are those of 64-bit Linux")

NUMBERS = {
    "VIDIOC_QUERYCAP": 0x80685600,
    "VIDIOC_ENUM_FMT": 0xC0405602,
    "VIDIOC_S_FMT": 0xC0D05605,
    "VIDIOC_REQBUFS": 0xC0145608,
    "VIDIOC_QUERYBUF": 0xC0585609,
    "VIDIOC_QBUF": 0xC058560F,
    "VIDIOC_DQBUF": 0xC0585611,
    "VIDIOC_STREAMON": 0x40045612,
    "VIDIOC_STREAMOFF": 0x40045613,
    "VIDIOC_G_PARM": 0xC0CC5615,
    "VIDIOC_S_PARM": 0xC0CC5616,
    "VIDIOC_QUERYMENU": 0xC02C5625,
    "VIDIOC_G_EXT_CTRLS": 0xC0205647,
    "VIDIOC_S_EXT_CTRLS": 0xC0205648,
    "VIDIOC_ENUM_FRAMESIZES": 0xC02C564A,
    "VIDIOC_ENUM_FRAMEINTERVALS": 0xC034564B,
    "VIDIOC_QUERY_EXT_CTRL": 0xC0E85667,
}


@only_64_bit
def test_ioctl_numbers_are_the_kernels() -> None:
    assert {name: value for name, value in vars(abi).items() if name.startswith("VIDIOC_")} == NUMBERS


@only_64_bit
@pytest.mark.parametrize(
    ("structure", "member", "offset"),
    [
        (abi.Capability, "device_caps", 88),
        (abi.FmtDesc, "pixelformat", 44),
        (abi.FrmSizeEnum, "size", 12),
        (abi.Format, "fmt", 8),
        (abi.PixFormat, "bytesperline", 16),
        (abi.StreamParm, "parm", 4),
        (abi.CaptureParm, "timeperframe", 8),
        (abi.Buffer, "timestamp", 24),
        (abi.Buffer, "sequence", 56),
        (abi.Buffer, "m", 64),
        (abi.Buffer, "length", 72),
        (abi.QueryExtCtrl, "minimum", 40),
        (abi.QueryExtCtrl, "flags", 72),
        (abi.QueryMenu, "item", 8),
        (abi.ExtControl, "u", 12),
        (abi.ExtControls, "controls", 24),
    ],
)
def test_members_lie_where_the_kernel_looks(structure: type[ctypes.Structure], member: str, offset: int) -> None:
    assert getattr(structure, member).offset == offset


def test_the_packed_structures_have_no_padding() -> None:
    assert ctypes.sizeof(abi.ExtControl) == 20
    assert ctypes.sizeof(abi.QueryMenu) == 44


def test_pixel_formats_are_four_characters() -> None:
    assert abi.fourcc("YUYV") == 0x56595559
    assert abi.fourcc_name(0x59455247) == "GREY"
    assert abi.fourcc_name(abi.fourcc("Y16 ")) == "Y16"
    assert abi.fourcc_name(abi.fourcc("Y16 ") | 1 << 31) == "Y16-BE"
    assert len(abi.fourcc_name(0x00FF80FE)) > 0
