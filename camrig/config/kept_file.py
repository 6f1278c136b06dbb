"""Writing a file that somebody depends on: whole or not at all, and the version before stays beside it."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from camrig.errors import InputError


def former(path: Path) -> Path:
    """Return where the version before the present one is kept: ``rig.yaml~``."""
    return path.with_name(path.name + "~")


def write(path: Path, text: str) -> None:
    """Replace a file's text; what stood there before goes to ``former(path)``.

    At any moment, a power cut included, the file is whole: the old or the new one. A symbolic link stays one, and the
    file it leads to is replaced, with the permissions it had. Raises InputError where it cannot be written.
    """
    target = path.resolve()
    try:
        if target.exists():
            _put(former(target), target.read_bytes(), like=target)
        _put(target, text.encode(), like=target)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; nothing in it was changed") from error


def _put(path: Path, content: bytes, like: Path) -> None:
    """Write beside it, to the disk, then rename: the only step that is seen, and the file system does it at once."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            if like.exists():
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
