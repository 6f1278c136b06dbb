"""Locks: automatic modes switched off, and what they governed held at one value over every replug.

Control numbers are those of ``linux/v4l2-controls.h``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from camrig.errors import HardwareError
from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.controls import Value, find_control, find_controls, set_control, variable_name
from camrig_drivers.v4l2.node import ControlInfo, Node

Lock = Literal["exposure", "gain", "white_balance", "focus"]

CID_AUTO_WHITE_BALANCE = 0x0098090C
CID_RED_BALANCE = 0x0098090E
CID_BLUE_BALANCE = 0x0098090F
CID_AUTOGAIN = 0x00980912
CID_GAIN = 0x00980913
CID_WHITE_BALANCE_TEMPERATURE = 0x0098091A
CID_EXPOSURE_AUTO = 0x009A0901
CID_EXPOSURE_ABSOLUTE = 0x009A0902
CID_EXPOSURE_AUTO_PRIORITY = 0x009A0903
CID_FOCUS_ABSOLUTE = 0x009A090A
CID_FOCUS_AUTO = 0x009A090C

EXPOSURE_MANUAL = 1
EXPOSURE_SHUTTER_PRIORITY = 2
_EXPOSURE_UNIT_S = 100e-6  # V4L2_CID_EXPOSURE_ABSOLUTE: "values are in 100 us units"


@dataclass(frozen=True, slots=True)
class _Automatic:
    """Switches and what each must be (the first that the menu has), and the controls that they govern."""

    switches: Mapping[int, tuple[int, ...]]
    governed: tuple[int, ...]


_AUTOMATICS: Mapping[Lock, _Automatic] = {
    "exposure": _Automatic(
        {CID_EXPOSURE_AUTO: (EXPOSURE_MANUAL, EXPOSURE_SHUTTER_PRIORITY), CID_EXPOSURE_AUTO_PRIORITY: (0,)},
        (CID_EXPOSURE_ABSOLUTE,),
    ),
    "gain": _Automatic({CID_AUTOGAIN: (0,)}, (CID_GAIN,)),
    "white_balance": _Automatic(
        {CID_AUTO_WHITE_BALANCE: (0,)}, (CID_WHITE_BALANCE_TEMPERATURE, CID_RED_BALANCE, CID_BLUE_BALANCE)
    ),
    "focus": _Automatic({CID_FOCUS_AUTO: (0,)}, (CID_FOCUS_ABSOLUTE,)),
}


class Locks:
    """The locks of one camera; they remember what they hold."""

    def __init__(self, wanted: Sequence[Lock]) -> None:
        self._wanted = tuple(dict.fromkeys(wanted))
        self._held: dict[str, int] = {}

    def switch_off(self, node: Node, label: str) -> None:
        """Switch the automatic modes off; a device without one has nothing to lock. Raises HardwareError, OSError."""
        for lock in self._wanted:
            for control_id, values in _AUTOMATICS[lock].switches.items():
                if (switch := find_control(node, control_id)) is not None:
                    set_control(node, f"{label}: lock of {lock}", switch, _first_offered(node, switch, values))

    def hold(self, node: Node, label: str, others: Mapping[str, Value]) -> Mapping[str, int]:
        """Set what was held before, or hold what is there now; return it. ``others`` are set by their own names."""
        if not self._wanted:
            return self._held
        by_id = {control.id: (name, control) for name, control in find_controls(node).items()}
        governed = [control_id for lock in self._wanted for control_id in _AUTOMATICS[lock].governed]
        for name, control in (by_id[control_id] for control_id in governed if control_id in by_id):
            if name in others or control.flags & (abi.CTRL_FLAG_INACTIVE | abi.CTRL_FLAG_READ_ONLY):
                continue
            if name in self._held:
                set_control(node, f"{label}: control {name}", control, self._held[name])
            else:
                self._held[name] = node.value(control)
        return self._held


def _first_offered(node: Node, switch: ControlInfo, values: tuple[int, ...]) -> int:
    if switch.kind != abi.CTRL_TYPE_MENU:
        return values[0]
    for value in values:
        if switch.minimum <= value <= switch.maximum and node.menu_item(switch, value) is not None:
            return value
    raise HardwareError(f"control {variable_name(switch.name)} cannot be switched off; take it out of `lock`")


def exposure_time_s(node: Node) -> float | None:
    """Return the exposure time that the device holds; None where it chooses its own or does not tell."""
    exposure = find_control(node, CID_EXPOSURE_ABSOLUTE)
    if exposure is None:
        return None
    mode = find_control(node, CID_EXPOSURE_AUTO)
    if mode is not None and node.value(mode) not in (EXPOSURE_MANUAL, EXPOSURE_SHUTTER_PRIORITY):
        return None
    return to_seconds(node.value(exposure))


def to_seconds(exposure: int) -> float:
    """Return the time that a value of V4L2_CID_EXPOSURE_ABSOLUTE stands for."""
    return exposure * _EXPOSURE_UNIT_S


def to_units(exposure_s: float) -> int:
    """Return the largest value of V4L2_CID_EXPOSURE_ABSOLUTE that is no longer than a time."""
    return int(exposure_s / _EXPOSURE_UNIT_S + 1e-6)
