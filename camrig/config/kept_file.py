"""Writing a file that somebody depends on: whole or not at all, and the version before stays beside it."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from camrig.errors import InputError

_ANYBODY_WRITES = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH


def former(path: Path) -> Path:
    """Return where the version before the present one is kept: ``rig.yaml~``."""
    return path.with_name(path.name + "~")


def write(path: Path, text: str) -> None:
    """Replace a file's text; what stood there before goes to ``former(path)``.

    At any moment, a power cut included, the file is whole: the old or the new one. A symbolic link stays one, and the
    file it leads to is replaced, with the owner and the permissions it had. Raises InputError where it cannot be
    written, as one that is read-only cannot.
    """
    check_writable(path)
    target = path.resolve()
    try:
        if target.exists():
            _put(former(target), target.read_bytes(), like=target)
        _put(target, text.encode(), like=target)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; nothing in it was changed") from error


def replace(path: Path, content: bytes) -> None:
    """Write a file as ``write`` does, and keep no former version: for what can be made again."""
    check_writable(path)
    target = path.resolve()
    try:
        _put(target, content, like=target)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; nothing in it was changed") from error


def check_writable(path: Path) -> None:
    """Raise InputError where a file could not be written: for asking before a long job.

    One that nobody may write is left alone even by root, who could.
    """
    target = path.resolve()
    if target.is_dir():
        raise InputError(f"{path} cannot be written: it is a folder")
    if not target.parent.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {target.parent}")
    if target.exists() and not (target.stat().st_mode & _ANYBODY_WRITES and os.access(target, os.W_OK)):
        raise InputError(f"{path} cannot be written: it is read-only")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path} cannot be written: its folder {target.parent} is read-only")


def _put(path: Path, content: bytes, like: Path) -> None:
    """Write beside it, to the disk, then rename: the only step that is seen, and the file system does it at once."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            if like.exists():
                with suppress(PermissionError):  # who is not root may give a file to nobody
                    os.fchown(file.fileno(), like.stat().st_uid, like.stat().st_gid)
                shutil.copymode(like, name)
            else:
                os.fchmod(file.fileno(), 0o666 & ~_umask())
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _umask() -> int:
    """Return what new files of this process are not allowed; it can be read by setting it only."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
