"""Machine code from plain functions, by numba: for the few kernels whose bar numpy cannot meet (docs/decisions/0005).

What is compiled is kept beside its source, or in ``NUMBA_CACHE_DIR``: only the first call after an installation waits.
A function that works on numbers and on arrays alike (the lens formulas) is written once: as it stands it serves numpy,
``compiled`` it serves the kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

_PACKAGE = Path(__file__).parents[1]
KERNELS = ("geometry", "sensing", "optimise/kernels")
"""The folders of the package that hold compiled functions."""


def forget_outdated(package: Path = _PACKAGE, elsewhere: str = "") -> bool:
    """Throw away machine code that is older than any kernel's source; return whether none of it is left.

    It lies beside the sources, and in the folder ``elsewhere`` where NUMBA_CACHE_DIR names one.
    numba keeps each function by the stamp of its own file: a change in a function of another file that it calls, as an
    update of a working copy makes it, goes unnoticed, and what runs would be half old, half new.
    """
    newest_s = max(source.stat().st_mtime for part in KERNELS for source in (package / part).rglob("*.py"))
    try:
        for kept in _kept(package, elsewhere):
            if kept.stat().st_mtime < newest_s:
                kept.unlink(missing_ok=True)
    except FileNotFoundError:  # another process throws it away too
        return forget_outdated(package, elsewhere)
    except OSError:
        return False
    return True


def _kept(package: Path, elsewhere: str) -> Iterator[Path]:
    for part in KERNELS:
        yield from (package / part).rglob("__pycache__/*.nb?")
    if elsewhere:
        yield from Path(elsewhere).rglob("*.nb?")


_MAY_KEEP = forget_outdated(elsewhere=numba.config.CACHE_DIR)  # type: ignore[attr-defined]


def compiled(function: F) -> F:
    """Return ``function`` as machine code that releases the GIL and divides as numpy does: by zero is not an error.

    Where nothing can be kept (a read-only installation, no home, no ``NUMBA_CACHE_DIR``), or what is outdated cannot be
    thrown away, every process compiles anew.
    """
    try:
        return cast("F", numba.njit(cache=_MAY_KEEP, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # numba's word for it: «no locator available for file»
        return cast("F", numba.njit(nogil=True, error_model="numpy")(function))
