"""vivid, the kernel's driver of virtual cameras: what its instances are called, and telling them what to do."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from camrig.clock import RealClock
from camrig.errors import LinkLost
from camrig.geometry.lens import BrownLens
from camrig.messages import Frame
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from camrig_drivers.v4l2.controls import find_controls
from camrig_drivers.v4l2.node import Node
from camrig_drivers.v4l2.port import KernelPort

DRIVER = Path("/sys/bus/platform/drivers/vivid")
DEVICE = "vivid.0"
PLUGGED_IN = (DRIVER / DEVICE).exists()

PORT = KernelPort()
INSTANCES = 3
FULL_RATE_FPS = 25
RUN_S = float(os.environ.get("CAMRIG_VIVID_S", "60"))
"""How long the run without a gap lasts."""
FULL_RANGE = ("GREY", "Y10", "Y12", "Y16", "Y16-BE")
"""All others are of studio range: black is 16, white 235."""
PATTERN, GRAY_RAMP, COLOUR_BARS = 0xF0F000, 20, 0
OSD, NO_OSD = 0xF0F001, 2
STAMPS, END_OF_FRAME, START_OF_EXPOSURE = 0xF0F018, 0, 1
DROPPED, DISCONNECT, ERROR_FLAG, REQBUFS, QBUF, STREAMON, FATAL = 0xF0F040, *range(0xF0F041, 0xF0F047)


def bus(instance: int) -> str:
    return f"platform:vivid-{instance:03d}"


def path_of(instance: int) -> str:
    """Return the node that an instance has now."""
    for path in PORT.nodes():
        node = Node(PORT, path)
        identity = node.identity()
        node.close()
        if identity.bus_info == bus(instance):
            return path
    raise AssertionError(f"no node of {bus(instance)}")


def tell(instance: int, control_id: int, value: int = 1) -> None:
    """Set a control of the device, as an operator beside the driver would."""
    node = Node(PORT, path_of(instance))
    node.set_value(node.control(control_id), value)
    node.close()


def held(instance: int, name: str) -> int:
    node = Node(PORT, path_of(instance))
    value = node.value(find_controls(node)[name])
    node.close()
    return value


def camera(
    instance: int = 0, size_px: tuple[int, int] = (320, 180), readout_s: float = 0.0, /, **section: object
) -> V4l2Camera:
    lens = BrownLens(size_px, (300.0, 300.0), (160.0, 90.0))
    wanted: dict[str, object] = {"device": f"bus={bus(instance)}", "fps": FULL_RATE_FPS, **section}
    spec = CameraSpec(f"vivid{instance}", lens, FreeMount(), readout_s)
    return V4l2Camera(spec, V4l2Section.model_validate(wanted), RealClock(), PORT)


@contextmanager
def opened(made: V4l2Camera) -> Iterator[V4l2Camera]:
    made.open()
    try:
        yield made
    finally:
        made.close()


def frame_of(made: V4l2Camera) -> Frame:
    frame = made.read(5.0)
    assert frame is not None
    return frame


def lost(act: Callable[[], object]) -> LinkLost:
    with pytest.raises(LinkLost) as caught:
        act()
    return caught.value


def lost_while_reading(made: V4l2Camera) -> LinkLost:
    def read_on() -> None:
        until_s = time.monotonic() + 10.0
        while time.monotonic() < until_s:
            made.read(1.0)

    return lost(read_on)
