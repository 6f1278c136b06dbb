"""Finds the cameras that are plugged in."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from camrig_drivers.v4l2.node import Node
from camrig_drivers.v4l2.port import IoctlPort, KernelPort

_FOLDERS = ("v4l/by-id", "v4l/by-path")
_KERNEL_PORT = KernelPort()


def discover(port: IoctlPort = _KERNEL_PORT, dev: Path = Path("/dev")) -> list[str]:
    """List cameras, each by the name that survives a replug where it has one; opens each for a moment.

    Nodes that give no pictures (a camera's metadata) are left out; those that cannot be asked are not.
    """
    names = {node: str(node) for node in sorted(dev.glob("video*"))}
    for folder in reversed(_FOLDERS):
        names |= {link.resolve(): str(link) for link in sorted((dev / folder).glob("*"))}
    return [name for node, name in sorted(names.items()) if _may_be_camera(port, str(node))]


def _may_be_camera(port: IoctlPort, path: str) -> bool:
    with suppress(OSError):
        node = Node(port, path)
        try:
            return node.identity().is_camera
        finally:
            node.close()
    return True
