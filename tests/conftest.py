"""A leak fails the test: threads, descriptors and child processes left behind by it. Kernels are never stale."""

from __future__ import annotations

import io
import os
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import settings

import camrig
from camrig.geometry.jit import forget_outdated
from tests.kernels import compile_side_by_side

# No example is judged by the clock: the first may compile a kernel, and the machine is shared. Exploration is for
# people: where a run decides whether a change lands, every run draws the same examples.
settings.register_profile("camrig", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "camrig")

_GRACE_S = 2.0


def pytest_configure(config: pytest.Config) -> None:
    """Compile the kernels before the workers of pytest-xdist start, where they are not compiled or outdated."""
    if hasattr(config, "workerinput"):
        return
    forget_outdated(elsewhere=os.environ.get("NUMBA_CACHE_DIR", ""))
    package = Path(camrig.__file__).parent
    if config.getoption("numprocesses", None) and not any(package.rglob("__pycache__/*.nbi")):
        # Once, before the workers: each would compile all of it, and daemons under test wait for a plan meanwhile.
        compile_side_by_side()


def _threads() -> set[str]:
    return {f"thread {thread.name}" for thread in threading.enumerate() if thread is not threading.main_thread()}


def _descriptors() -> set[str]:
    found = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            found.add(f"descriptor {entry.name} -> {os.readlink(entry)}")
        except OSError:
            continue  # the listing's own descriptor
    return found


def _children() -> set[str]:
    found = set()
    for task in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # the thread ended between listing and reading
            found |= {f"child {pid}" for pid in (task / "children").read_text().split()}
    return found


def _resources() -> set[str]:
    return _threads() | _descriptors() | _children()


@pytest.fixture(autouse=True)
def no_leaks() -> Iterator[None]:
    """Fail a test that leaves a thread, a descriptor or a child process behind."""
    before = _resources()
    yield
    deadline_s = time.monotonic() + _GRACE_S
    while (left := _resources() - before) and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert not left, f"left behind: {sorted(left)}"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of shared test data (pictures, scenes, vectors); its tests skip where it is not given."""
    folder = os.environ.get("CAMRIG_TEST_DATA")
    if not folder:
        pytest.skip("CAMRIG_TEST_DATA is not set: no shared pictures, scenes and vectors")
    return Path(folder)


@pytest.fixture(scope="session")
def picture_fonts() -> None:
    """Have matplotlib open its fonts: it keeps them open, which is no leak of the test that first draws."""
    from matplotlib.figure import Figure

    figure = Figure()
    for number, weight in enumerate(("normal", "bold")):
        figure.text(0.5, 0.3 * number, "words", fontfamily="DejaVu Sans", fontweight=weight)
    for ending in ("png", "svg"):
        figure.savefig(io.BytesIO(), format=ending)
