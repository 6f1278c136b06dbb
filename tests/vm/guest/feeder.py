"""feeder.py PORT DEVICE WIDTH HEIGHT: whatever comes over a line from the host is shown by a v4l2loopback camera.

Standard library only: it is to start soon, under emulation too.
"""

import fcntl
import pathlib
import struct
import sys

VIDIOC_S_FMT = 0xC0D05605
OUTPUT = 2
NO_FIELD = 1
SRGB = 8


def main() -> None:
    """Set the format and pass on frame after frame."""
    name, device, width, height = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    ports = pathlib.Path("/sys/class/virtio-ports")
    (port,) = (found.name for found in ports.iterdir() if (found / "name").read_text().strip() == name)
    grey = int.from_bytes(b"GREY", "little")
    with open(f"/dev/{port}", "rb", buffering=width * height) as line, open(device, "wb", buffering=0) as camera:
        pixels = struct.pack("<8I", width, height, grey, NO_FIELD, width, width * height, SRGB, 0)
        fcntl.ioctl(camera, VIDIOC_S_FMT, bytearray(struct.pack("<I4x", OUTPUT) + pixels.ljust(200, b"\0")))
        while frame := line.read(width * height):
            camera.write(frame)


main()
