"""feeder.py PORT DEVICE WIDTH HEIGHT: a v4l2loopback camera shows pictures from the host, with their true stamps.

A picture is asked for, and comes with how long the host had the question and how old the picture was at the answer.
What of the round trip was not spent there is half of it the answer's way: so the stamp is of this clock, and a
transfer that takes its time does not make the picture younger. Standard library only: it is to start soon, under
emulation too.
"""

import fcntl
import mmap
import os
import pathlib
import struct
import sys
import time

OUTPUT, MMAP = 2, 1
NO_FIELD, SRGB = 1, 8
S_FMT, REQBUFS, QUERYBUF, QBUF, STREAMON = 0xC0D05605, 0xC0145608, 0xC0585609, 0xC058560F, 0x40045612
BUFFERS = 6
"""As many as camrig's driver maps: v4l2loopback numbers those of both ends alike."""
BUFFER = struct.Struct("<5I4xqq16xIIQII8x")
"""struct v4l2_buffer: index, type, bytesused, flags, field, the stamp's s and us, sequence, memory, offset, length."""
HEADER = struct.Struct("<dd")
MOST_UNSURE_S = 0.06
"""A picture whose way here took longer is not shown: its stamp could be wrong by half of that."""


class Camera:
    """The device, as who shows pictures with it sees it."""

    def __init__(self, device: str, width: int, height: int) -> None:
        """Set the format and map the buffers."""
        self._device = os.open(device, os.O_RDWR)
        pixels = struct.pack(
            "<8I", width, height, int.from_bytes(b"GREY", "little"), NO_FIELD, width, width * height, SRGB, 0
        )
        self._call(S_FMT, struct.pack("<I4x", OUTPUT) + pixels.ljust(200, b"\0"))
        self._call(REQBUFS, struct.pack("<5I", BUFFERS, OUTPUT, MMAP, 0, 0))
        self._maps = [self._mapped(index) for index in range(BUFFERS)]
        self._call(STREAMON, struct.pack("<I", OUTPUT))
        self._next = 0

    def show(self, picture: bytes, stamp_s: float) -> None:
        """Hand a picture over to whoever watches."""
        index = self._next
        self._next = (index + 1) % BUFFERS
        self._maps[index][: len(picture)] = picture
        stamp = divmod(round(stamp_s * 1e6), 1_000_000)
        self._call(QBUF, BUFFER.pack(index, OUTPUT, len(picture), 0, NO_FIELD, *stamp, 0, MMAP, 0, 0, 0))

    def _mapped(self, index: int) -> mmap.mmap:
        found = BUFFER.unpack(self._call(QUERYBUF, BUFFER.pack(index, OUTPUT, 0, 0, 0, 0, 0, 0, MMAP, 0, 0, 0)))
        offset, length = found[9], found[10]
        return mmap.mmap(self._device, length, offset=offset)

    def _call(self, number: int, argument: bytes) -> bytes:
        answer = bytearray(argument)
        fcntl.ioctl(self._device, number, answer)
        return bytes(answer)


def main() -> None:
    """Ask for picture after picture and show each."""
    name, device, width, height = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    ports = pathlib.Path("/sys/class/virtio-ports")
    (port,) = (found.name for found in ports.iterdir() if (found / "name").read_text().strip() == name)
    camera = Camera(device, width, height)
    with open(f"/dev/{port}", "r+b", buffering=0) as line:

        def received(count: int) -> bytes:
            data = b""
            while len(data) < count:
                data += line.read(count - len(data))
            return data

        while True:
            asked_s = time.monotonic()
            line.write(b"?")
            had_s, age_s = HEADER.unpack(received(HEADER.size))
            heard_s = time.monotonic()
            picture = received(width * height)
            way_s = heard_s - asked_s - had_s
            print(f"{way_s:.4f}", flush=True)
            if way_s < MOST_UNSURE_S:
                camera.show(picture, heard_s - 0.5 * way_s - age_s)


main()
