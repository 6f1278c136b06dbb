"""Finds the cameras that are plugged in, and what each can do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import get_args

from camrig.interfaces import Found
from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.controls import find_controls, menu_items
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.node import ControlInfo, Identity, Node
from camrig_drivers.v4l2.offers import Mode, modes
from camrig_drivers.v4l2.port import IoctlPort, KernelPort
from camrig_drivers.v4l2.trouble import holders, reason

_KERNEL_PORT = KernelPort()
_USABLE_FPS = 15.0
_ENOUGH_PX = 1280 * 720
_KINDS = {
    abi.CTRL_TYPE_BOOLEAN: "switch",
    abi.CTRL_TYPE_MENU: "menu",
    abi.CTRL_TYPE_INTEGER_MENU: "menu",
    abi.CTRL_TYPE_INTEGER: "number",
    abi.CTRL_TYPE_INTEGER64: "number",
}


def discover(port: IoctlPort = _KERNEL_PORT) -> Sequence[Found]:
    """List cameras, each by the name that lasts longest; opens each for a moment.

    Nodes that give no pictures (a camera's metadata) are left out; those that cannot be asked are not.
    """
    links = port.links()
    asked = {path: _ask(port, path) for path in port.nodes()}
    buses = [found.identity.bus_info for found in asked.values() if isinstance(found, _Camera)]
    cameras = []
    for path, found in asked.items():
        names = links.get(path, [])
        if isinstance(found, _Camera):
            bus = f"bus={found.identity.bus_info}"
            alone = buses.count(found.identity.bus_info) == 1
            cameras.append(found.told(path, [*names, *([bus] if alone else []), path]))
        elif found is not None:
            cameras.append(
                Found(
                    (names or [path])[0],
                    path,
                    {"device": (names or [path])[0]},
                    trouble=f"{path} {reason(path, found)}",
                )
            )
    return cameras


class _Camera:
    """What one node told of itself."""

    def __init__(self, node: Node, identity: Identity) -> None:
        self.identity = identity
        self.modes = modes(node)
        self.controls = {name: _described(node, control) for name, control in find_controls(node).items()}

    def told(self, path: str, names: Sequence[str]) -> Found:
        identity = self.identity
        mode = _best(self.modes)
        section: dict[str, object] = {"device": names[0]}
        if mode is not None:
            section["format"] = mode.pixels
            if mode.rates_fps:
                section["fps"] = mode.rates_fps[0]
        users = holders(path)
        facts = {
            "node": path,
            "names": list(names),
            "card": identity.card,
            "bus_info": identity.bus_info,
            "serial": identity.serial,
            "in_use_by": users,
            "modes": [
                {"format": mode.pixels, "size_px": str(mode.sizes), "fps": list(mode.rates_fps)} for mode in self.modes
            ],
            "controls": self.controls,
        }
        size_px = None if mode is None else _size_of(mode)
        trouble = "" if mode else "it offers no format that camrig reads"
        if users:
            trouble = f"it is in use by {', '.join(users)}; stop that first"
        return Found(names[0], str(identity), section, size_px, facts, trouble)


def _ask(port: IoctlPort, path: str) -> _Camera | OSError | None:
    """Ask a node; None where it is no camera, an error where it cannot be asked."""
    try:
        node = Node(port, path)
        try:
            identity = node.identity()
            return _Camera(node, identity) if identity.is_camera else None
        finally:
            node.close()
    except OSError as error:
        return error


def _best(offered: Sequence[Mode]) -> Mode | None:
    """Choose the largest pictures up to 720p that come often enough, uncompressed where that costs nothing."""
    formats = get_args(PixelFormat)
    usable = [mode for mode in offered if mode.pixels in formats]

    def worth(mode: Mode) -> tuple[bool, bool, int, int]:
        width, height = _size_of(mode)
        often = not mode.rates_fps or mode.rates_fps[0] >= _USABLE_FPS
        enough = width * height <= _ENOUGH_PX
        return often, enough, width * height if enough else -width * height, -formats.index(mode.pixels)

    return max(usable, key=worth, default=None)


def _size_of(mode: Mode) -> tuple[int, int]:
    """Return the size to use of a mode: of a range the largest up to 1280x720."""
    sizes = mode.sizes
    if sizes.highest_px is None:
        return sizes.size_px
    wanted = zip((1280, 720), sizes.size_px, sizes.highest_px, sizes.step_px, strict=True)
    width, height = (low + (min(most, high) - low) // max(1, step) * max(1, step) for most, low, high, step in wanted)
    return width, height


def _described(node: Node, control: ControlInfo) -> Mapping[str, object]:
    """Describe a control as JSON: its kind, what it may be, and what it is now."""
    told: dict[str, object] = {"kind": _KINDS[control.kind]}
    if told["kind"] == "number":
        told |= {"minimum": control.minimum, "maximum": control.maximum, "step": max(1, control.step)}
    elif told["kind"] == "menu":
        told["items"] = {name: index for index, name in menu_items(node, control).items()}
    for flag, word in ((abi.CTRL_FLAG_READ_ONLY, "read_only"), (abi.CTRL_FLAG_INACTIVE, "governed")):
        if control.flags & flag:
            told[word] = True
    if not control.flags & abi.CTRL_FLAG_WRITE_ONLY:
        try:
            value = node.value(control)
            told["value"] = bool(value) if told["kind"] == "switch" else value
        except OSError:  # some devices cannot read what an automatic mode governs
            told["value"] = None
    return told
