"""A camera's controls by name: found, checked against what the device allows, set in an order that works, read back.

Names are those that ``v4l2-ctl --list-ctrls`` prints: "Exposure Time, Absolute" is ``exposure_time_absolute``.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Mapping

from camrig.errors import HardwareError
from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.node import ControlInfo, Node

Value = bool | int | str

_SWITCHES = (abi.CTRL_TYPE_BOOLEAN, abi.CTRL_TYPE_MENU)
_MENUS = (abi.CTRL_TYPE_MENU, abi.CTRL_TYPE_INTEGER_MENU)
_NUMBERS = (abi.CTRL_TYPE_INTEGER, abi.CTRL_TYPE_INTEGER64)
_REFUSALS = (errno.EINVAL, errno.ERANGE, errno.EACCES, errno.EPERM, errno.EBUSY)
_NO_CONTROL = (errno.EINVAL, errno.ENOTTY)


def variable_name(name: str) -> str:
    """Return a kernel's name in lower-case snake: runs of anything but letters and digits become one underscore."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def find_controls(node: Node) -> dict[str, ControlInfo]:
    """List the controls that can be set by name; of two with one name, the first."""
    found: dict[str, ControlInfo] = {}
    control_id = 0
    while (control := find_control(node, control_id | abi.CTRL_FLAG_NEXT_CTRL)) is not None:
        control_id = control.id
        if control.kind in (*_SWITCHES, *_MENUS, *_NUMBERS) and not control.flags & abi.CTRL_FLAG_DISABLED:
            found.setdefault(variable_name(control.name), control)
    return found


def set_controls(node: Node, label: str, wanted: Mapping[str, Value]) -> None:
    """Set the controls and read each back; raises HardwareError that says what is allowed.

    All names and values are checked before the first is set. Switches and menus go first, in the order given: they
    turn automatic modes off, and a value that an automatic mode governs cannot be set before.
    """
    if not wanted:
        return
    known = find_controls(node)
    if unknown := [name for name in wanted if name not in known]:
        allowed = ", ".join(sorted(known)) or "none"
        raise HardwareError(f"{label} has no control {', '.join(unknown)}; it has: {allowed}")
    numbers = {name: _number(node, f"{label}: control {name}", known[name], wanted[name]) for name in wanted}
    for name in sorted(wanted, key=lambda name: known[name].kind not in _SWITCHES):
        set_control(node, f"{label}: control {name}", known[name], numbers[name])


def find_control(node: Node, control_id: int) -> ControlInfo | None:
    """Describe a control by its number; None where the device has none such, or does not tell."""
    try:
        return node.control(control_id)
    except OSError as error:
        if error.errno in _NO_CONTROL:
            return None
        raise


def set_control(node: Node, where: str, control: ControlInfo, number: int) -> None:
    """Set one control and read it back; raises HardwareError where the device will not have it."""
    flags = node.control(control.id).flags  # a switch set before may have changed them
    if flags & abi.CTRL_FLAG_READ_ONLY:
        raise HardwareError(f"{where} can only be read; take it out of `controls`")
    if flags & abi.CTRL_FLAG_INACTIVE:
        raise HardwareError(f"{where} has no effect while an automatic mode governs it; switch that off in `controls`")
    try:
        node.set_value(control, number)
    except OSError as error:
        if error.errno in _REFUSALS:
            raise HardwareError(f"{where} was refused the value {number}: {error.strerror}") from error
        raise
    if flags & abi.CTRL_FLAG_WRITE_ONLY:
        return
    held = node.value(control)
    if held != number:
        raise HardwareError(f"{where} was set to {number}, but the device holds {held}; ask for that or another value")


def _number(node: Node, where: str, control: ControlInfo, value: Value) -> int:
    """Return what to set for a value of the YAML; raises HardwareError with what is allowed."""
    if control.kind == abi.CTRL_TYPE_BOOLEAN:
        if value in (0, 1):
            return int(value)
        raise HardwareError(f"{where} is {value!r}; allowed: true, false")
    if control.kind in _MENUS:
        return _menu_number(node, where, control, value)
    return _in_range(where, control, value)


def _in_range(where: str, control: ControlInfo, value: Value) -> int:
    low, high, step = control.minimum, control.maximum, max(1, control.step)
    if isinstance(value, int) and not isinstance(value, bool) and value in range(low, high + 1, step):
        return value
    steps = f" in steps of {step}" if step > 1 else ""
    raise HardwareError(f"{where} is {value!r}; allowed: {low} to {high}{steps}")


def menu_items(node: Node, control: ControlInfo) -> dict[int, str]:
    """Return the items of a menu by number, each in lower-case snake."""
    return {
        index: variable_name(item)
        for index in range(control.minimum, control.maximum + 1)
        if (item := node.menu_item(control, index)) is not None
    }


def _menu_number(node: Node, where: str, control: ControlInfo, value: Value) -> int:
    """Find an item by its number, its name, or the first words of its name where only one item begins so."""
    items = menu_items(node, control)
    if isinstance(value, bool):
        found = []
    elif isinstance(value, int):
        found = [value] if value in items else []
    else:
        name = variable_name(value)
        found = [index for index, item in items.items() if item == name]
        found = found or [index for index, item in items.items() if item.startswith(f"{name}_")]
    if len(found) != 1:
        allowed = ", ".join(f"{item} ({index})" for index, item in items.items())
        raise HardwareError(f"{where} is {value!r}; allowed: {allowed}")
    return found[0]
