"""The daemon on fakes, and where every daemon of these tests keeps its socket: in a folder of this run.

So two suites on one host do not meet.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from camrig.config.rig_file import RigConfig
from camrig.config.settings import settings_of
from camrig.runtime.daemon import Daemon
from tests.daemon_on_fakes import Log, load


@pytest.fixture(scope="session", autouse=True)
def session_folder() -> Iterator[Path]:
    """Return what stands for the user's own XDG_RUNTIME_DIR."""
    with TemporaryDirectory(prefix="camrig-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        patch.delenv("RUNTIME_DIRECTORY", raising=False)
        yield Path(folder)


@pytest.fixture
def socket_folder() -> Iterator[Path]:
    """Return a runtime folder that is not there yet; pytest's own are too long for a socket and closed to others."""
    with TemporaryDirectory(prefix="camrig-") as parent:
        Path(parent).chmod(0o755)
        yield Path(parent) / "camrig"


@pytest.fixture
def config(tmp_path: Path) -> RigConfig:
    """Return the rig of two fake heads."""
    return load(tmp_path)


@pytest.fixture
def daemon(config: RigConfig) -> Iterator[Daemon]:
    """Return a started daemon on fakes."""
    found = Daemon(config, settings_of(config), extra_sinks=[Log()])
    found.start()
    yield found
    found.stop()
