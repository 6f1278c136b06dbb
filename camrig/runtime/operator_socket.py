"""Where a rig's daemon is reached: one Unix socket a rig in the runtime folder, claimed by one daemon at a time.

The protocol is JSON lines: a request object a line, an answer object a line, at most ``MAX_LINE_BYTES`` each way in.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from camrig.errors import HardwareError, InputError

MAX_LINE_BYTES = 65536
MODE = 0o660
FOLDER_MODE = 0o750
SYSTEM_FOLDER = Path("/run/camrig")
"""The RuntimeDirectory of camrig.service, where its users look for it."""
_MAX_PATH_BYTES = 107  # sun_path of unix(7), less the closing NUL
_NAME = re.compile(r"\w[\w. -]*")


def runtime_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this user's sockets: systemd's, else the session's, else one in /tmp."""
    if folders := environment.get("RUNTIME_DIRECTORY"):
        return Path(folders.split(":")[0])
    if session := environment.get("XDG_RUNTIME_DIR"):
        return Path(session) / "camrig"
    return Path(f"/tmp/camrig-{os.geteuid()}")  # made by us alone, see _make_private


def is_trusted(folder: Path) -> bool:
    """Tell whether a daemon that this user may trust has made the folder; anyone could make one in /tmp."""
    try:
        return folder == SYSTEM_FOLDER or folder.stat().st_uid in {0, os.geteuid()}
    except OSError:
        return False


def socket_path(folder: Path, rig: str) -> Path:
    """Return the socket of a rig; raises InputError for a name that no socket can have."""
    if not _NAME.fullmatch(rig):
        raise InputError(f"rig '{rig}' cannot name a socket: use letters, digits, '-', '_', '.' and spaces in its name")
    path = folder / f"{rig}.sock"
    if len(os.fsencode(path)) > _MAX_PATH_BYTES:
        raise InputError(f"{path} is too long for a socket ({_MAX_PATH_BYTES} bytes): shorten the rig's name")
    return path


@contextmanager
def claimed(rig: str, folder: Path) -> Iterator[socket.socket]:
    """Hold the rig's name on this host while inside; yields its socket, bound (a stale one replaced) but not listening.

    Raises HardwareError while another daemon runs the rig, InputError where the socket cannot be made. A daemon that
    was killed leaves its files behind but not its lock: the kernel has taken that back.
    """
    path = socket_path(folder, rig)
    try:
        _make_private(folder)
        lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise InputError(f"{folder} cannot hold the operator's socket: {error.strerror}") from error
    with os.fdopen(lock, "r+") as held:
        _lock(held.fileno(), rig)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
            try:
                _bind(listener, path)
                yield listener
            finally:
                with suppress(OSError):
                    path.unlink()


def _make_private(folder: Path) -> None:
    """Make the folder, or see to it that nobody else could have put anything into the one that is there."""
    with suppress(FileExistsError):
        folder.mkdir(mode=FOLDER_MODE)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid not in {0, os.geteuid()} or found.st_mode & stat.S_IWOTH:
        raise PermissionError(errno.EPERM, "it is not a folder of this user alone; remove it")


def _lock(lock: int, rig: str) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        holder = os.pread(lock, 32, 0).decode(errors="replace").strip()
        raise HardwareError(
            f"rig '{rig}' is already run on this host by process {holder}: stop that daemon first"
        ) from error
    os.ftruncate(lock, 0)
    os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)


def _bind(listener: socket.socket, path: Path) -> None:
    try:
        path.unlink(missing_ok=True)  # stale: whoever holds the lock is the only one who may have a socket here
        listener.bind(str(path))
        path.chmod(MODE)  # before listening, so nobody gets in by the mode that bind gave it
    except OSError as error:
        raise InputError(f"{path} cannot be made: {error.strerror}") from error
