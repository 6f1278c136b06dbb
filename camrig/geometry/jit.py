"""Machine code from plain functions, by numba: for the few kernels whose bar numpy cannot meet (docs/decisions/0005).

What is compiled is kept beside its source, or in ``NUMBA_CACHE_DIR``: only the first call after an installation waits.
A function that works on numbers and on arrays alike (the lens formulas) is written once: as it stands it serves numpy,
``compiled`` it serves the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Return ``function`` as machine code that releases the GIL and divides as numpy does: by zero is not an error.

    Where nothing can be kept (a read-only installation, no home, no ``NUMBA_CACHE_DIR``) every process compiles anew.
    """
    try:
        return cast("F", numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # numba's word for it: «no locator available for file»
        return cast("F", numba.njit(nogil=True, error_model="numpy")(function))
