"""The controls of a fake V4L2 camera, byte by byte: see ``v4l2_kernel``."""

from __future__ import annotations

import ctypes
import errno
import struct
from dataclasses import dataclass

_CONTROL = struct.Struct("<II32sqqQqI")
_POINTER = struct.Struct("<Q")
_NEXT = 0x80000000
_READ_ONLY = 0x04
_INACTIVE = 0x10

Argument = ctypes.Array[ctypes.c_char]
"""The bytes of an ioctl's argument, read and filled in."""

INTEGER, BOOLEAN, MENU, BUTTON, INTEGER64, CLASS, INTEGER_MENU = 1, 2, 3, 4, 5, 6, 9
AUTO_EXPOSURE, EXPOSURE = 0x9A0901, 0x9A0902


@dataclass(frozen=True)
class Control:
    """A control: its ``value`` when plugged in, and the control that governs it unless that is ``freed_by``."""

    id: int
    name: str
    kind: int
    low: int
    high: int
    step: int = 1
    value: int = 0
    flags: int = 0
    items: tuple[tuple[int, str], ...] = ()
    governed_by: int = 0
    freed_by: int = 0


USUAL_CONTROLS = (
    Control(0x980001, "User Controls", CLASS, 0, 0, flags=0x44),
    Control(0x980900, "Brightness", INTEGER, -64, 64),
    Control(0x980913, "Gain", INTEGER, 0, 100, step=5, governed_by=AUTO_EXPOSURE, freed_by=1),
    Control(0x980924, "Power Line Frequency", MENU, 0, 2, items=((0, "Disabled"), (1, "50 Hz"), (2, "60 Hz"))),
    Control(0x98A001, "Reset", BUTTON, 0, 0),
    Control(0x98A002, "Serial Number", INTEGER64, 0, 1 << 40, value=1 << 33, flags=0x04),
    Control(0x98A003, "Link Frequency", INTEGER_MENU, 0, 1, items=((0, "450000000"), (1, "900000000"))),
    Control(0x98A004, "Broken", INTEGER, 0, 1, flags=0x01),
    Control(
        AUTO_EXPOSURE,
        "Auto Exposure",
        MENU,
        0,
        3,
        value=3,
        items=((1, "Manual Mode"), (3, "Aperture Priority Mode")),
    ),
    Control(EXPOSURE, "Exposure Time, Absolute", INTEGER, 1, 5000, value=156, governed_by=AUTO_EXPOSURE, freed_by=1),
    Control(0x9A090C, "Focus, Automatic Continuous", BOOLEAN, 0, 1, value=1),
)


class ControlBank:
    """Answers the four ioctls of controls, for one control at a time."""

    def __init__(self, controls: tuple[Control, ...], clips: tuple[int, ...]) -> None:
        self.controls = controls
        self.clips = clips
        self.values_set: list[tuple[str, int]] = []
        self.reset()

    def reset(self) -> None:
        """Forget, as a camera without power does."""
        self._values = {control.id: control.value for control in self.controls}

    def preset(self, name: str, value: int) -> None:
        """Set what an automatic mode has found, or an operator has left."""
        self._values |= {control.id: value for control in self.controls if control.name == name}

    def held(self, name: str) -> int:
        return next(self._values[control.id] for control in self.controls if control.name == name)

    def _find(self, control_id: int) -> Control | None:
        return next((control for control in self.controls if control.id == control_id), None)

    def _flags(self, control: Control) -> int:
        governor = self._values.get(control.governed_by, control.freed_by)
        return control.flags | (0 if governor == control.freed_by else _INACTIVE)

    def query(self, data: Argument) -> int:
        (asked,) = struct.unpack_from("<I", data)
        if asked & _NEXT:
            later = [control.id for control in self.controls if control.id > asked & ~_NEXT]
            asked = min(later, default=0)
        control = self._find(asked)
        if control is None:
            return errno.EINVAL
        name = control.name.encode()
        _CONTROL.pack_into(
            data, 0, control.id, control.kind, name, control.low, control.high, control.step, 0, self._flags(control)
        )
        return 0

    def query_menu(self, data: Argument) -> int:
        control_id, index = struct.unpack_from("<2I", data)
        control = self._find(control_id)
        assert control is not None
        items = dict(control.items)
        if index not in items:
            return errno.EINVAL
        if control.kind == INTEGER_MENU:
            struct.pack_into("<q", data, 8, int(items[index]))
        else:
            struct.pack_into("<32s", data, 8, items[index].encode())
        return 0

    def _one_control(self, data: Argument) -> tuple[Control, Argument]:
        """Follow the pointer to the only control of the call."""
        assert struct.unpack_from("<2I", data) == (0, 1)
        (address,) = _POINTER.unpack_from(data, 24)
        memory = (ctypes.c_char * 20).from_address(address)
        control = self._find(struct.unpack_from("<I", memory)[0])
        assert control is not None
        return control, memory

    def get(self, data: Argument) -> int:
        control, memory = self._one_control(data)
        struct.pack_into("<q" if control.kind == INTEGER64 else "<i", memory, 12, self._values[control.id])
        return 0

    def set(self, data: Argument) -> int:
        control, memory = self._one_control(data)
        (value,) = struct.unpack_from("<q" if control.kind == INTEGER64 else "<i", memory, 12)
        if self._flags(control) & (_INACTIVE | _READ_ONLY):
            return errno.EACCES
        if not control.low <= value <= control.high:
            return errno.ERANGE
        self.values_set.append((control.name, value))
        self._values[control.id] = value // 2 if control.id in self.clips else value
        return 0
