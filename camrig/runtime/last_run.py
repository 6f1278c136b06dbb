"""The configuration that a daemon runs, kept in the runtime folder: its file may have been changed since, or be faulty.

Whoever stops the heads of a daemon that died goes by it (``camrig stop``). A daemon that came to rest leaves none.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from camrig.config.rig_file import RigConfig, load_rig
from camrig.errors import CamrigError
from camrig.runtime.operator_socket import SYSTEM_FOLDER, is_trusted, runtime_folder

_log = logging.getLogger(__name__)

MODE = 0o640


def keep(config: RigConfig, folder: Path) -> None:
    """Note that the rig is run by this; an emulated rig, which leaves no head behind, is not noted."""
    if config.world is not None:
        return
    path = _path(folder, Path(config.file))
    fresh = path.with_suffix(".new")
    try:
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, MODE), "w", encoding="utf-8") as file:
            file.write(config.text)
        fresh.replace(path)
    except OSError as error:
        _log.warning("%s cannot be kept: should the daemon die, `camrig stop` goes by %s: %s", path, config.file, error)


def forget(file: Path, folder: Path) -> None:
    """Note that nothing is left to be stopped."""
    with suppress(OSError):
        _path(folder, file).unlink()


def last_run(file: Path, folders: Sequence[Path] = ()) -> RigConfig | None:
    """Return what a daemon last ran as this file, unless it came to rest; None too where that cannot be read."""
    for folder in folders or (runtime_folder(), SYSTEM_FOLDER):
        path = _path(folder, file)
        with suppress(OSError, CamrigError):
            if is_trusted(folder) and path.is_file():
                return replace(load_rig(path), file=str(file))
    return None


def _path(folder: Path, file: Path) -> Path:
    """Return where a rig's file is kept: under its own name, and what tells it from others of that name."""
    place = hashlib.sha256(os.fsencode(file.resolve())).hexdigest()[:16]
    return folder / f"{file.stem}-{place}.running.yaml"
