"""What an errno of a camera means to the person at the rig."""

from __future__ import annotations

import errno
import grp
import os
from contextlib import suppress
from pathlib import Path

from camrig.errors import HardwareError, LinkLoss, LinkLost

_NO_CAMERA = (errno.ENOTTY, errno.EISDIR)
_DENIED = (errno.EACCES, errno.EPERM)
_GONE = (errno.ENODEV, errno.ENXIO)
_LOSSES = {
    errno.ENOENT: LinkLoss.ABSENT,
    errno.ENODEV: LinkLoss.ABSENT,
    errno.ENXIO: LinkLoss.ABSENT,
    errno.EACCES: LinkLoss.DENIED,
    errno.EPERM: LinkLoss.DENIED,
    errno.EBUSY: LinkLoss.BUSY,
}
_DEFAULT_GROUP = "video"


def explain(label: str, path: str, error: OSError) -> HardwareError:
    """Return the error to raise: LinkLost, since the device may come back, unless it is no camera at all."""
    if error.errno in _NO_CAMERA:
        return HardwareError(f"{label} is no V4L2 camera; `camrig devices` lists those plugged in")
    return LinkLost(f"{label} {reason(path, error)}", _LOSSES.get(error.errno or 0, LinkLoss.FAILED))


def reason(path: str, error: OSError) -> str:
    """Say what is wrong with a device, and what to do about it."""
    if error.errno == errno.ENOENT:
        return "does not exist; check the cable and the name, best one of /dev/v4l/by-id or by-path"
    if error.errno in _DENIED:
        return f"may not be opened by this user; add the user to the group {_group(path)} and log in again"
    if error.errno == errno.EBUSY:
        return f"is in use by {_names(holders(path))}; stop that first"
    if error.errno in _GONE:
        return "was unplugged"
    if error.errno == errno.ENOSPC:
        return "finds no bandwidth left on its USB bus; use another port, format MJPG or a lower fps"
    at = f" at {error.filename}" if str(error.filename).startswith("VIDIOC_") else ""
    return f"failed with {errno.errorcode.get(error.errno or 0, 'an unknown error')} ({error.strerror}){at}"


def _group(path: str) -> str:
    with suppress(OSError, KeyError):
        return grp.getgrgid(Path(path).stat().st_gid).gr_name
    return _DEFAULT_GROUP


def _names(found: list[str]) -> str:
    return ", ".join(found) or "another program"


def holders(path: str) -> list[str]:
    """Name the other processes that hold a device open, as far as this user may see them."""
    found = []
    node = os.path.realpath(path)
    for process in sorted(Path("/proc").glob("[0-9]*")):
        with suppress(OSError):  # it ended, or is another user's
            if int(process.name) != os.getpid() and any(_leads_to(fd, node) for fd in (process / "fd").iterdir()):
                found.append(f"{(process / 'comm').read_text().strip()} (pid {process.name})")
    return found


def _leads_to(fd: Path, node: str) -> bool:
    with suppress(OSError):
        return str(fd.readlink()) == node
    return False
