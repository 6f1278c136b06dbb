"""Finds a camera's node by a name that lasts, and again after a replug that gave it another number.

``device`` is a path (best one of /dev/v4l/by-id or by-path), ``serial=…`` (of the USB device) or ``bus=…`` (the
``bus_info`` of VIDIOC_QUERYCAP, which also tells the instances of a virtual driver apart).
"""

from __future__ import annotations

import errno
import logging
from collections.abc import Callable
from contextlib import suppress

from camrig.errors import LinkLoss, LinkLost
from camrig_drivers.v4l2.node import Identity, Node
from camrig_drivers.v4l2.port import IoctlPort
from camrig_drivers.v4l2.trouble import reason

_log = logging.getLogger(__name__)

_SERIAL, _BUS = "serial=", "bus="
_ABSENT = (errno.ENOENT, errno.ENODEV, errno.ENXIO)
_LASTING = ("/v4l/by-id/", "/v4l/by-path/")


class Finder:
    """Opens the node of one camera, and remembers which camera that was."""

    def __init__(self, port: IoctlPort, device: str, label: str) -> None:
        self._port = port
        self._device = device
        self._label = label
        self._known: Identity | None = None

    def open(self) -> tuple[Node, Identity]:
        """Open the node; raises OSError, and LinkLost where it is not plugged in or another camera took its number."""
        for key, part in ((_SERIAL, _serial_of), (_BUS, _bus_of)):
            if self._device.startswith(key):
                return self._remembered(self._by_name(part, self._device.removeprefix(key)))
        try:
            found = _identified(self._port, self._device)
        except OSError as error:
            if self._known is None or error.errno not in _ABSENT:
                raise
            if (moved := self._same_camera()) is None:
                raise
            return self._remembered(moved)
        if self._known is None or _same(found[1], self._known) or any(folder in self._device for folder in _LASTING):
            return self._remembered(found)
        found[0].close()
        if (moved := self._same_camera()) is not None:
            return self._remembered(moved)
        raise LinkLost(
            f"{self._label} is now another camera ({found[1]}), and {self._known} is not plugged in; "
            "name it by /dev/v4l/by-id or by-path",
            LinkLoss.ABSENT,
        )

    def _by_name(self, part: Callable[[Identity], str], wanted: str) -> tuple[Node, Identity]:
        seen, refused = [], None
        for path in self._port.nodes():
            try:
                node, identity = _identified(self._port, path)
            except PermissionError as error:
                refused = f"{self._label} is not among those that may be asked: {path} {reason(path, error)}"
                continue
            except OSError:
                continue
            if identity.is_camera and part(identity) == wanted:
                return node, identity
            node.close()
            if identity.is_camera and part(identity):
                seen.append(part(identity))
        if refused is not None:
            raise LinkLost(refused, LinkLoss.DENIED)
        there = ", ".join(dict.fromkeys(seen)) or "none"
        raise LinkLost(f"{self._label} is not plugged in; those that are: {there}", LinkLoss.ABSENT)

    def _same_camera(self) -> tuple[Node, Identity] | None:
        """Find the camera that was opened before under whatever number it has now."""
        for path in self._port.nodes():
            with suppress(OSError):
                node, identity = _identified(self._port, path)
                if self._known is not None and _same(identity, self._known):
                    _log.info("%s is now %s", self._label, path)
                    return node, identity
                node.close()
        return None

    def _remembered(self, found: tuple[Node, Identity]) -> tuple[Node, Identity]:
        self._known = found[1]
        return found


def _identified(port: IoctlPort, path: str) -> tuple[Node, Identity]:
    node = Node(port, path)
    try:
        return node, node.identity()
    except BaseException:
        node.close()
        raise


def _same(one: Identity, other: Identity) -> bool:
    """Tell whether two are one camera: by its serial number wherever it is plugged in, else by where that is."""
    if (one.card, one.is_camera) != (other.card, other.is_camera):
        return False
    if one.serial or other.serial:
        return one.serial == other.serial
    return one.bus_info == other.bus_info


def _serial_of(identity: Identity) -> str:
    return identity.serial


def _bus_of(identity: Identity) -> str:
    return identity.bus_info
