"""The open device of a UVC head and its controls, found and held against the rig's limits."""

from __future__ import annotations

import errno
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal

from camrig.errors import HardwareError
from camrig.rig import HeadSpec
from camrig_drivers.uvc.axis import Axis
from camrig_drivers.uvc.section import UvcSection
from camrig_drivers.v4l2.finder import Finder
from camrig_drivers.v4l2.node import ControlInfo, Node

_CAMERA_CLASS = 0x009A0900  # V4L2_CID_CAMERA_CLASS_BASE
PAN_ABSOLUTE, TILT_ABSOLUTE, ZOOM_ABSOLUTE = _CAMERA_CLASS + 8, _CAMERA_CLASS + 9, _CAMERA_CLASS + 13
PAN_SPEED, TILT_SPEED = _CAMERA_CLASS + 32, _CAMERA_CLASS + 33

Angles = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Device:
    """What is open; whatever fails here is an OSError."""

    node: Node
    pan: Axis
    tilt: Axis
    zoom: ControlInfo | None
    speeds: tuple[ControlInfo, ...]
    """Of pan and tilt, on the few devices that have them: setting 0 ends a motion."""

    @property
    def axes(self) -> tuple[Axis, Axis]:
        return self.pan, self.tilt

    def angles_rad(self) -> Angles:
        """Return what the controls hold."""
        pan, tilt = (axis.angle_rad(self.node.value(axis.control)) for axis in self.axes)
        return pan, tilt

    def send(self, values: tuple[int, int]) -> None:
        """Set both controls."""
        for axis, value in zip(self.axes, values, strict=True):
            self.node.set_value(axis.control, value)

    def halt(self) -> None:
        """Set both speeds to 0, where there are any."""
        for speed in self.speeds:
            self.node.set_value(speed, 0)


def open_device(finder: Finder, label: str, spec: HeadSpec, section: UvcSection) -> Device:
    """Open a device under whatever number it has now, and find its controls; moves nothing.

    Raises OSError where it cannot be opened, LinkLost where it is not plugged in, HardwareError where it is no pan-tilt
    head or cannot do what is asked.
    """
    with ExitStack() as undo:
        node, _ = finder.open()
        undo.callback(node.close)
        device = Device(
            node,
            _axis("pan", node, label, spec, section),
            _axis("tilt", node, label, spec, section),
            _zoom(node, label, section),
            tuple(speed for each in (PAN_SPEED, TILT_SPEED) if (speed := _control(node, each)) is not None),
        )
        undo.pop_all()
    return device


def _axis(name: Literal["pan", "tilt"], node: Node, label: str, spec: HeadSpec, section: UvcSection) -> Axis:
    control = _control(node, PAN_ABSOLUTE if name == "pan" else TILT_ABSOLUTE)
    if control is None:
        raise HardwareError(f"{label} has no control {name}_absolute: it is no pan-tilt head")
    limits_rad = spec.pan_limits_rad if name == "pan" else spec.tilt_limits_rad
    axis = Axis(name, getattr(section.axes, name), limits_rad, control, section.readback_sigma_deg)
    axis.check_limits(label)
    return axis


def _zoom(node: Node, label: str, section: UvcSection) -> ControlInfo | None:
    if section.zoom is None:
        return None
    zoom = _control(node, ZOOM_ABSOLUTE)
    if zoom is None or not zoom.minimum <= section.zoom <= zoom.maximum:
        can = f"zooms from {zoom.minimum} to {zoom.maximum}" if zoom else "has no control zoom_absolute"
        raise HardwareError(f"{label} {can}; zoom {section.zoom} is not possible")
    return zoom


def _control(node: Node, control_id: int) -> ControlInfo | None:
    try:
        return node.control(control_id)
    except OSError as error:
        if error.errno == errno.EINVAL:
            return None
        raise
